"""Layers on numbers worked out by hand."""

from __future__ import annotations

import numpy as np

from roboassembly.learning import layers


def test_layers_by_hand() -> None:
    x = np.array([[-1.0, 3.0]])
    # Mean 1, deviation 2.
    assert np.allclose(layers.norm(layers.init_norm(2), x), [[-1.0, 1.0]], atol=1e-5)
    assert np.allclose(layers.gelu(np.array([0.0, 1.0, -1.0])), [0.0, 0.8412, -0.1588], atol=1e-3)
    assert np.allclose(layers.softplus(np.array([0.0, 800.0, -800.0])), [np.log(2.0), 800.0, 0.0])
    assert np.allclose(layers.softmax(np.array([[0.0, np.log(3.0)]]), axis=1), [[0.25, 0.75]])
