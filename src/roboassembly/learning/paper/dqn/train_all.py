"""Training of the experts of many chairs, lots of them in processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from functools import partial
from pathlib import Path
from typing import Any

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.dqn.group_table import point_counts
from roboassembly.learning.paper.dqn.network import padded_points
from roboassembly.learning.paper.dqn.results import ExpertResult, read
from roboassembly.learning.paper.dqn.train import ExpertRun, ExpertTraining
from roboassembly.parallel.processes import map_ordered, one_thread_each, worker_pool


def train(
    refs: Sequence[FurnitureRef],
    folder: Path,
    training: ExpertTraining,
    encoder_file: Path,
    notes: dict[str, Any],
    *,
    jobs: int,
    side_by_side: int,
    keep_every: float = 50.0,
) -> Iterator[ExpertResult]:
    """Train an expert for each chair that has none yet; yields all results as they come, those at hand first.

    Args:
        refs: the chairs.
        folder: gets a file for each.
        training: settings.
        encoder_file: checkpoint of the auto-encoder.
        notes: origin of the chairs, kept in the files.
        jobs: number of processes.
        side_by_side: number of chairs trained in one call in each process.
        keep_every: time between writes of the chairs in training [s].
    """
    folder.mkdir(parents=True, exist_ok=True)
    there = [r for r in refs if dataset_file(folder, r.name).is_file()]
    yield from (read(dataset_file(folder, r.name)) for r in there)
    left = [r for r in refs if r not in there]
    work = partial(
        _train_lot, folder=folder, training=training, encoder_file=encoder_file, notes=notes, side_by_side=side_by_side,
        keep_every=keep_every,
    )  # fmt: skip
    # Versions of a chair start from what its own expert has learned.
    for some in ([r for r in left if r.source is None], [r for r in left if r.source is not None]):
        yield from _train_all(some, folder, work, jobs, side_by_side)


def _train_all(
    refs: list[FurnitureRef], folder: Path, work: Callable[[list[FurnitureRef]], None], jobs: int, side_by_side: int
) -> Iterator[ExpertResult]:
    by_size: dict[int, list[FurnitureRef]] = {}
    for r, size in zip(refs, map_ordered(_padded_size, refs, jobs, chunk=8), strict=True):
        by_size.setdefault(size, []).append(r)
    # Large chairs take longest: begun last, they would keep one process busy alone.
    lots = [lot for size in sorted(by_size, reverse=True) for lot in _lots(by_size[size], jobs, side_by_side)]
    if jobs == 1:
        for lot in lots:
            work(lot)
            yield from (read(dataset_file(folder, r.name)) for r in lot)
        return
    left = list(refs)
    with worker_pool(jobs) as pool:
        with one_thread_each():
            running = {pool.submit(work, lot) for lot in lots}
        while left:
            done, running = wait(running, timeout=2.0)
            for future in done:
                future.result()
            ready = [r for r in left if dataset_file(folder, r.name).is_file()]
            yield from (read(dataset_file(folder, r.name)) for r in ready)
            left = [r for r in left if r not in ready]


def _padded_size(ref: FurnitureRef) -> int:
    return padded_points(int(point_counts(ref.furniture(with_grasps=False)).sum()))


def _lots(refs: list[FurnitureRef], jobs: int, side_by_side: int) -> list[list[FurnitureRef]]:
    """Divide chairs of one size into as many lots as keep all processes busy."""
    count = min(len(refs), max(jobs, -(-len(refs) // (4 * side_by_side))))
    return [refs[i::count] for i in range(count)]


def _train_lot(
    refs: list[FurnitureRef],
    *,
    folder: Path,
    training: ExpertTraining,
    encoder_file: Path,
    notes: dict[str, Any],
    side_by_side: int,
    keep_every: float,
) -> None:
    encoder = checkpoint.load(encoder_file, autoencoder.KIND).params
    ExpertRun(refs, folder, training, side_by_side, encoder, notes).run(keep_every)
