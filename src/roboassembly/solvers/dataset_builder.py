"""Builds data sets: generates chairs, certifies them by search, measures their difficulty and splits them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import msgspec

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import (
    EASY,
    HARD,
    TEST,
    VERSION,
    Entry,
    Manifest,
    Recipe,
    furniture_hash,
    manifest_path,
)
from roboassembly.generate import CHAIRS
from roboassembly.parallel.processes import worker_pool
from roboassembly.planning.problem import Budget
from roboassembly.solvers.random_order import assemble_in_random_order
from roboassembly.solvers.search import SearchLimits, solve
from roboassembly.task.object_centric.task import ObjectCentricTask

PROBES = 5
"""Number of random-order episodes that measure the difficulty."""
PATIENT_PROBES = 3
"""Number of random-order episodes that look for a dead end."""
_PROBE_BUDGET = Budget(states=0)
"""Budget for retreats only: a sampling planner seldom solves what they do not, and 412 chairs must be measured."""
_CERTIFY = SearchLimits(states=50_000, attempts=100)


class Candidate(msgspec.Struct, frozen=True):
    """A chair examined for a set, as stored in the journal."""

    family: str
    seed: int
    parts: int
    certified: bool
    difficulty: float
    dead_end: bool
    planning_steps: int
    hash: str


def examine(family: str, seed: int) -> Candidate:
    """Generate one chair, certify it by search, and measure its difficulty."""
    furniture = catalogue.make(family, seed, with_grasps=False)
    task = ObjectCentricTask(furniture)
    result = solve(furniture, 0, task=task, limits=_CERTIFY)
    stuck, dead_end = 0.0, False
    if result.plan.success:
        episodes = [
            assemble_in_random_order(task, p, best_w=True, patient=False, budget=_PROBE_BUDGET) for p in range(PROBES)
        ]
        stuck = sum(not p.completed for p in episodes) / PROBES
        dead_end = any(
            not assemble_in_random_order(task, p, best_w=True, patient=True, budget=_PROBE_BUDGET).completed
            for p in range(PATIENT_PROBES)
        )
    return Candidate(
        family,
        seed,
        len(furniture.parts),
        result.plan.success,
        stuck,
        dead_end,
        result.planning_steps,
        furniture_hash(furniture),
    )


def build_dataset(recipe: Recipe, seed: int, jobs: int) -> Iterator[tuple[int, int]]:
    """Build a set and write its manifest; yields the number of examined chairs and the total.

    A journal beside the manifest stores the results, so that an interrupted build continues.
    """
    path = manifest_path(recipe.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    journal = path.with_suffix(f".{seed}.jsonl")
    known = {(c.family, c.seed): c for c in _read_journal(journal)}
    seen = [f for f in CHAIRS if f not in recipe.unseen_families]
    selected = [
        *_draw(seen, recipe.train + recipe.test_seen, seed),
        *_draw(list(recipe.unseen_families), recipe.test_unseen, seed),
    ]
    chosen: list[Candidate] = []
    with journal.open("ab") as log, worker_pool(jobs) as pool:
        todo = [w for w in selected if w not in known]
        done = len(selected) - len(todo)
        yield done, len(selected)
        while todo:
            families, seeds = [name for name, _ in todo], [number for _, number in todo]
            for candidate in pool.map(examine, families, seeds, chunksize=1):
                log.write(msgspec.json.encode(candidate) + b"\n")
                log.flush()
                known[candidate.family, candidate.seed] = candidate
                done += candidate.certified
                yield min(done, len(selected)), len(selected)
            # The next chair of the family replaces a chair that the search does not solve.
            selected = [w if known[w].certified else _next(w, known) for w in selected]
            todo = [w for w in selected if w not in known]
    chosen = [known[w] for w in selected]
    manifest = Manifest(recipe.name, VERSION, seed, tuple(_split(recipe, chosen)))
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_bytes(msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n")
    scratch.replace(path)


def _draw(families: list[str], count: int, seed: int) -> list[tuple[str, int]]:
    """Return `(family, seed)` pairs, the families in turn. Seed 0 is the catalogue model and is left out."""
    return [(f, seed * 100_000 + 1 + i // len(families)) for i, f in enumerate(islice(cycle(families), count))]


def _next(chair: tuple[str, int], known: dict[tuple[str, int], Candidate]) -> tuple[str, int]:
    family, seed = chair
    seed += 50_000
    while (family, seed) in known and not known[family, seed].certified:
        seed += 1
    return family, seed


def _split(recipe: Recipe, chairs: list[Candidate]) -> Iterator[Entry]:
    """Yield the entries. The first `train` chairs are for training; the easier half of them is `easy`.

    Chairs are ranked by difficulty, then by number of parts.
    """
    train, test = chairs[: recipe.train], chairs[recipe.train :]
    ranked = sorted(train, key=lambda c: (c.difficulty, c.parts, c.family, c.seed))
    for index, c in enumerate(ranked):
        yield _entry(recipe, c, EASY if index < len(ranked) // 2 else HARD)
    for c in test:
        yield _entry(recipe, c, TEST)


def _entry(recipe: Recipe, c: Candidate, split: str) -> Entry:
    unseen = c.family in recipe.unseen_families
    return Entry(c.family, c.seed, split, unseen, c.parts, c.difficulty, c.dead_end, c.planning_steps, c.hash)


def _read_journal(path: Path) -> Iterator[Candidate]:
    if not path.is_file():
        return
    for line in path.read_bytes().splitlines():
        try:
            yield msgspec.json.decode(line, type=Candidate)
        except msgspec.DecodeError:
            # A build was killed while it wrote its last line.
            continue
