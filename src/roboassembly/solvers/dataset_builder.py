"""Builds data sets: generates chairs, certifies them by search, measures their difficulty and splits them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle, islice
from pathlib import Path

import msgspec
import numpy as np

from roboassembly.atomic_file import atomic_write
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
from roboassembly.errors import FurnitureError
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
_SEEDS, _REPLACEMENTS = 100_000, 50_000
"""Distance between the seeds of two draws of a set, and from a piece's seed to that of its replacement."""
_CERTIFY = SearchLimits(states=50_000, attempts=100)


Piece = tuple[str, int, int]
"""Family, seed and version of a chair."""


class Candidate(msgspec.Struct, frozen=True):
    """A chair examined for a set, as stored in the journal."""

    family: str
    seed: int
    version: int
    parts: int
    certified: bool
    difficulty: float
    """See `Entry`; 0 for versions, which have that of their source."""
    dead_end: bool
    planning_steps: int
    hash: str

    @property
    def piece(self) -> Piece:
        """Family, seed and version."""
        return self.family, self.seed, self.version


def examine(family: str, seed: int, version: int = 0) -> Candidate:
    """Generate one chair, certify it by search, and measure its difficulty if it is a source."""
    try:
        furniture = catalogue.make(family, seed, version, with_grasps=False)
    except FurnitureError:
        return Candidate(family, seed, version, 0, False, 0.0, False, 0, "")
    task = ObjectCentricTask(furniture)
    result = solve(furniture, 0, task=task, limits=_CERTIFY)
    stuck, dead_end = 0.0, False
    if result.plan.success and version == 0:
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
        version,
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
    journal = path.with_suffix(f".{VERSION}.{seed}.jsonl")
    known: dict[Piece, Candidate] = {c.piece: c for c in _read_journal(journal)}
    seen = [f for f in CHAIRS if f not in recipe.unseen_families]
    first = recipe.first_seed + seed * _SEEDS
    sources = [
        *_draw(seen, recipe.train + recipe.test_seen, first),
        *_draw(list(recipe.unseen_families), recipe.test_unseen, first),
    ]
    selected: list[Piece] = [(*source, version) for source in sources for version in range(recipe.versions)]
    with journal.open("ab") as log, worker_pool(jobs) as pool:
        todo = [w for w in selected if w not in known]
        done = len(selected) - len(todo)
        yield done, len(selected)
        while todo:
            families, seeds, versions = [p[0] for p in todo], [p[1] for p in todo], [p[2] for p in todo]
            for candidate in pool.map(examine, families, seeds, versions, chunksize=1):
                log.write(msgspec.json.encode(candidate) + b"\n")
                log.flush()
                known[candidate.piece] = candidate
                done += candidate.certified
                yield min(done, len(selected)), len(selected)
            selected = _replaced(selected, known, recipe.versions)
            todo = [w for w in selected if w not in known]
    entries = _split(recipe, [known[w] for w in selected], np.random.default_rng(seed))
    manifest = Manifest(recipe.name, VERSION, seed, tuple(entries))
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n")


def _draw(families: list[str], count: int, first: int) -> list[tuple[str, int]]:
    """Return `(family, seed)` pairs, the families in turn. Seed 0 is the catalogue model and is left out."""
    return [(f, first + i // len(families)) for i, f in enumerate(islice(cycle(families), count))]


def _replaced(selected: Sequence[Piece], known: Mapping[Piece, Candidate], versions: int) -> list[Piece]:
    """Return the pieces with a replacement for each that the search does not solve.

    The next chair of its family replaces a source, all versions included, and the next version a version.
    """
    sources = [selected[i] for i in range(0, len(selected), versions)]
    used = set(sources)
    out: list[Piece] = []
    for index, source in enumerate(sources):
        family, seed, _ = source
        if not known[source].certified:
            seed += 0 if seed % _SEEDS >= _REPLACEMENTS else _REPLACEMENTS
            while (family, seed, 0) in used or ((family, seed, 0) in known and not known[family, seed, 0].certified):
                seed += 1
            used.add((family, seed, 0))
            out += [(family, seed, version) for version in range(versions)]
            continue
        pieces = list(selected[index * versions : (index + 1) * versions])
        for place, piece in enumerate(pieces):
            while piece in known and not known[piece].certified:
                piece = (family, seed, max(p[2] for p in pieces) + 1)
                pieces[place] = piece
        out += pieces
    return out


def _split(recipe: Recipe, chairs: Sequence[Candidate], rng: np.random.Generator) -> Iterator[Entry]:
    """Yield the entries. The first `train` sources are for training; the easier half of them is `easy`.

    Sources are ranked by difficulty, then by number of parts; versions go where their source goes. Sources with
    versions are put in random order first, so that the division is random.
    """
    sources: list[Sequence[Candidate]] = [
        chairs[i : i + recipe.versions] for i in range(0, len(chairs), recipe.versions)
    ]
    by_version: dict[Piece, bool] = {}
    if recipe.versions > 1:
        sources = [sources[int(i)] for i in rng.permutation(len(sources))]
        train_count = recipe.train * recipe.versions
        for place, i in enumerate(rng.permutation(len(chairs))):
            by_version[chairs[int(i)].piece] = place < train_count
    ranked = sorted(sources[: recipe.train], key=lambda s: (s[0].difficulty, s[0].parts, *s[0].piece))
    easy = len(ranked) // 2
    for index, source in enumerate([*ranked, *sources[recipe.train :]]):
        split = EASY if index < easy else HARD if index < recipe.train else TEST
        for c in source:
            yield _entry(recipe, c, source[0], split, by_version)


def _entry(recipe: Recipe, c: Candidate, source: Candidate, split: str, by_version: Mapping[Piece, bool]) -> Entry:
    return Entry(
        *c.piece,
        split,
        by_version.get(c.piece),
        c.family in recipe.unseen_families,
        c.parts,
        source.difficulty,
        source.dead_end,
        c.planning_steps,
        c.hash,
    )


def _read_journal(path: Path) -> Iterator[Candidate]:
    if not path.is_file():
        return
    for line in path.read_bytes().splitlines():
        try:
            yield msgspec.json.decode(line, type=Candidate)
        except msgspec.DecodeError:
            # A build was killed while it wrote its last line.
            continue
