"""Clouds of parts for the auto-encoder: of the chairs to train on, and of generated ones besides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs.observation import surface_points
from roboassembly.generate import CHAIRS
from roboassembly.learning.generated import extra_names
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.parallel.processes import map_ordered


def gather_clouds(picks: Sequence[FurnitureRef], *, jobs: int, extra: int = 300) -> Float32[np.ndarray, "c n 3"]:
    """Clouds of the parts of some furniture, and of generated pieces besides, metres.

    Args:
        picks: the furniture.
        jobs: pieces at a time.
        extra: generated pieces, in no data set, of the families that occur among `picks` and some to practise on.
    """
    families = {p.entry.family for p in picks if p.entry is not None}
    names = extra_names(extra, [f for f in CHAIRS if f not in families]) if families else []
    work = [*picks, *names]
    return np.concatenate(list(map_ordered(_clouds, work, jobs, chunk=8)))


def _clouds(piece: FurnitureRef | str) -> Float32[np.ndarray, "p n 3"]:
    if isinstance(piece, str):
        family, _, number = piece.partition(":")
        furniture = catalogue.make(family, int(number), with_grasps=False)
    else:
        furniture = piece.furniture(with_grasps=False)
    return np.array([surface_points(p.mesh, CLOUD_POINTS) for p in furniture.parts], np.float32)
