"""Layers of all networks, as pure functions of a dictionary of arrays.

They run on NumPy and on JAX arrays (`__array_namespace__` selects which). A trained policy therefore needs only NumPy
to act, and starts at once, while JAX differentiates and compiles the same lines for training.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

Params = dict[str, Any]
"""Arrays by name, nested."""
Array = Any
"""A NumPy or a JAX array."""


def init_linear(rng: np.random.Generator, inputs: int, outputs: int) -> Params:
    """Return an affine map with weights of variance 1 / inputs (LeCun's normal) and no bias."""
    weights = rng.normal(0.0, inputs**-0.5, (inputs, outputs)).astype(np.float32)
    return {"w": weights, "b": np.zeros(outputs, np.float32)}


def linear(p: Params, x: Array) -> Array:
    """Apply an affine map to the last axis."""
    return x @ p["w"] + p["b"]


def init_mlp(rng: np.random.Generator, *sizes: int) -> Params:
    """Return affine maps from each size to the next."""
    return {str(i): init_linear(rng, a, b) for i, (a, b) in enumerate(pairwise(sizes))}


def mlp(p: Params, x: Array) -> Array:
    """Apply affine maps with GELU between them."""
    for i in range(len(p)):
        x = linear(p[str(i)], gelu(x) if i else x)
    return x


def gelu(x: Array) -> Array:
    """Return the Gaussian error linear unit in its tanh form (Hendrycks and Gimpel 2016)."""
    xp = x.__array_namespace__()
    return 0.5 * x * (1.0 + xp.tanh(0.7978845608 * (x + 0.044715 * x * x * x)))


def sigmoid(x: Array) -> Array:
    """Return the logistic function, without overflow."""
    return 0.5 * (1.0 + x.__array_namespace__().tanh(0.5 * x))


def softplus(x: Array) -> Array:
    """Return log(1 + exp(x)), without overflow."""
    xp = x.__array_namespace__()
    return xp.maximum(x, 0.0) + xp.log1p(xp.exp(-xp.abs(x)))


def softmax(x: Array, axis: int) -> Array:
    """Return exponentials that sum to 1 along an axis."""
    xp = x.__array_namespace__()
    e = xp.exp(x - xp.max(x, axis=axis, keepdims=True))
    return e / xp.sum(e, axis=axis, keepdims=True)


def init_norm(size: int) -> Params:
    """Return a layer normalisation with scale 1 and offset 0."""
    return {"w": np.ones(size, np.float32), "b": np.zeros(size, np.float32)}


def norm(p: Params, x: Array) -> Array:
    """Apply layer normalisation (Ba et al. 2016)."""
    xp = x.__array_namespace__()
    x = x - xp.mean(x, axis=-1, keepdims=True)
    return x / xp.sqrt(xp.mean(x * x, axis=-1, keepdims=True) + 1e-6) * p["w"] + p["b"]


def init_block(rng: np.random.Generator, size: int, edge: int, heads: int) -> Params:
    """Return a transformer block whose attention uses features of pairs of tokens (edges)."""
    return {
        "norm1": init_norm(size),
        "qkv": init_linear(rng, size, 3 * size),
        "bias": init_linear(rng, edge, heads),
        "edge": {"w": init_linear(rng, edge, size)["w"]},
        "out": init_linear(rng, size, size),
        "norm2": init_norm(size),
        "mlp": init_mlp(rng, size, 2 * size, size),
    }


def block(p: Params, x: Array, edges: Array, present: Array) -> Array:
    """Apply a pre-norm transformer block; edges bias the attention and add values (Graphormer, Ying et al. 2021).

    Args:
        p: weights from `init_block`.
        x: (b, n, d) tokens.
        edges: (b, n, n, e) features from row to column.
        present: (b, n) false for padding.
    """
    xp = x.__array_namespace__()
    b, n, d = x.shape
    heads = p["bias"]["w"].shape[1]
    qkv = xp.reshape(linear(p["qkv"], norm(p["norm1"], x)), (b, n, 3, heads, d // heads))
    q, k, v = qkv[:, :, 0], qkv[:, :, 1], qkv[:, :, 2]
    logits = xp.einsum("bihc,bjhc->bhij", q, k) * (d // heads) ** -0.5
    logits = logits + xp.moveaxis(linear(p["bias"], edges), 3, 1)
    attention = softmax(xp.where(present[:, None, None, :], logits, -1e9), axis=3)
    seen = xp.einsum("bhij,bjhc->bihc", attention, v)
    between = xp.einsum("bhij,bije->bihe", attention, edges)
    weights = xp.reshape(p["edge"]["w"], (-1, heads, d // heads))
    seen = seen + xp.einsum("bihe,ehc->bihc", between, weights)
    x = x + linear(p["out"], xp.reshape(seen, (b, n, d)))
    return x + mlp(p["mlp"], norm(p["norm2"], x))
