"""Part clouds for the auto-encoder: from the chairs of the training set and from further generated pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs.observation import part_clouds
from roboassembly.generate import CHAIRS
from roboassembly.learning.generated import extra_names
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.parallel.processes import map_ordered


def collect_clouds(refs: Sequence[FurnitureRef], *, jobs: int, extra: int = 300) -> Float32[np.ndarray, "c n 3"]:
    """Return the clouds of the parts of some furniture, and of further generated pieces [m].

    Args:
        refs: the furniture.
        jobs: number of processes.
        extra: number of generated pieces that no data set holds, chairs of the families that occur among `refs` and
            simple frames; none if `refs` has no generated furniture.
    """
    families = {ref.entry.family for ref in refs if ref.entry is not None}
    names = extra_names(extra, [f for f in CHAIRS if f not in families]) if families else []
    pieces = [*refs, *names]
    return np.concatenate(list(map_ordered(_clouds, pieces, jobs, chunk=8)))


def _clouds(piece: FurnitureRef | str) -> Float32[np.ndarray, "p n 3"]:
    if isinstance(piece, str):
        family, _, number = piece.partition(":")
        furniture = catalogue.make(family, int(number), with_grasps=False)
    else:
        furniture = piece.furniture(with_grasps=False)
    return part_clouds(furniture, CLOUD_POINTS)
