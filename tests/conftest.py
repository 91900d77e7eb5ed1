"""Furniture that many tests share."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

import shapes
from roboassembly.cli import main
from roboassembly.datasets import catalogue
from roboassembly.datasets import sets as datasets
from roboassembly.furniture.model import Furniture
from roboassembly.rendering import gl
from roboassembly.settings import set_upright
from roboassembly.solvers.disassembly import Disassembly, partition_of
from roboassembly.solvers.options import grasping
from roboassembly.solvers.search import solve
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.insertion import with_insertions
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan


def pytest_configure(config: pytest.Config) -> None:
    """Keep what JAX compiles from run to run, shared by the processes of one; give each process one thread of BLAS.

    Threads of BLAS wait for each other busily where other processes run on the same cores.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # Else imageio runs Python between fork and exec when a test reads a film, which can hang in a process with threads.
    os.environ.setdefault("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")
    if (kept := getattr(config, "cache", None)) is not None:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(kept.mkdir("jax"))
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests neither find nor leave anything in the user's cache folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _furniture_made_once(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[None]:
    """Built-in furniture is made once a session: it never changes, and annotation takes long.

    Processes of one session share through files what tests use by name: the first seeds of each family.
    """
    own = tmp_path_factory.getbasetemp()
    shared = (own.parent if hasattr(request.config, "workerinput") else own) / "furniture"
    shared.mkdir(exist_ok=True)
    making = catalogue.make

    @cache
    def made(family: str, seed: int, version: int, *, with_grasps: bool, fasteners: bool) -> Furniture:
        path = shared / f"{family} {seed} {version} {with_grasps} {fasteners}"
        if path.exists():
            return pickle.loads(path.read_bytes())
        furniture = making(family, seed, version, with_grasps=with_grasps, fasteners=fasteners)
        if seed < 30:
            unfinished = own / f"{path.name}.unfinished"
            unfinished.write_bytes(pickle.dumps(furniture))
            unfinished.rename(path)
        return furniture

    def make(
        family: str, seed: int = 0, version: int = 0, *, with_grasps: bool = True, fasteners: bool = False
    ) -> Furniture:
        return made(family, seed, version, with_grasps=with_grasps, fasteners=fasteners)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalogue, "make", make)
        yield


@pytest.fixture(scope="session")
def chair():
    """`chair(family, seed)`: built-in furniture, made once a session."""
    return lambda family, seed: catalogue.make(family, seed)


@pytest.fixture
def as_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`as_built(split=[(family, seed), ...], ...)`: chairs-24 of these chairs alone, as if it had been built.

    A name before the splits is another set's.
    """

    def write(name: str = "chairs-24", /, **splits: list[tuple[str, int]]) -> list[str]:
        monkeypatch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path / "cache"))
        entries = []
        for split, chairs in splits.items():
            for family, seed in chairs:
                made = catalogue.make(family, seed)
                unseen = family in datasets.RECIPES[name].unseen_families
                hash_ = datasets.furniture_hash(made)
                entries.append(
                    datasets.Entry(family, seed, 0, split, None, unseen, len(made.parts), 0.0, False, 0, hash_)
                )
        path = datasets.manifest_path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.json.encode(datasets.Manifest(name, datasets.VERSION, 0, tuple(entries))))
        return [e.name for e in entries]

    return write


@pytest.fixture(scope="session")
def two_merges(chair) -> FullPlan:
    """The first two merges of a stool."""
    task = FullTask(chair("stool", 0))
    disassembly = Disassembly(task.furniture, lambda: False)
    initial = state = task.initial_state(np.random.default_rng(0))
    steps = []
    for _ in range(2):
        told = next(task.rules.pairs.slot_assignments(state.groups))
        order = disassembly.order(partition_of(told), set(), straight=True, exhaustive=False)
        assert order
        outcomes = (task.step(state, action, 1) for action in grasping(task, state, told, *order[0]))
        outcome = next(o for o in outcomes if o.step is not None)
        state = outcome.state
        steps.append(outcome.step)
    return FullPlan(task.furniture, initial, tuple(steps), False, 0)


@pytest.fixture(scope="session")
def drawing() -> None:
    """Skips where there is no off-screen OpenGL."""
    try:
        gl.context_module()
    except gl.RenderingUnavailableError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def table() -> Furniture:
    return shapes.table()


@pytest.fixture(scope="session")
def stand() -> Furniture:
    return shapes.stand()


@pytest.fixture(scope="session")
def armchair() -> Furniture:
    return shapes.armchair()


@pytest.fixture(scope="session")
def fastened() -> Furniture:
    return shapes.fastened()


@pytest.fixture(scope="session")
def fastened_plan(fastened: Furniture) -> Plan:
    return with_insertions(set_upright(solve(fastened, 0).plan))


@pytest.fixture(scope="session")
def captive_slat() -> Furniture:
    return shapes.captive_slat()


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs a command line: exit status, stdout and stderr."""

    def go(*arguments: str | Path) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return int(stop.value.code or 0), out, err

    return go
