"""Data sets: built from certified chairs, resumable, reproducible; the probers and the baseline."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import shapes
from roboassembly.datasets import catalogue
from roboassembly.datasets import sets as datasets
from roboassembly.datasets.sets import Recipe, furniture_refs, load_manifest, make_entry, manifest_path
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture import storage
from roboassembly.generate import CHAIRS
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.solvers import dataset_builder
from roboassembly.solvers.joint_rrt import solve_jointly
from roboassembly.solvers.random_order import assemble_in_random_order
from roboassembly.task.object_centric.task import ObjectCentricTask

TINY = Recipe("tiny", "for tests", 4, 2, 1, 1, ("upholstered",))


def into(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """The tiny set is known, and its place is in a folder."""
    patch.setenv("ROBOASSEMBLY_CACHE", str(folder))
    patch.setitem(datasets.RECIPES, "tiny", TINY)
    patch.setattr(dataset_builder, "CHAIRS", {name: CHAIRS[name] for name in ("cantilever", "shell", "upholstered")})


def quickly(patch: pytest.MonkeyPatch) -> None:
    """Chairs are examined in a thread, each by few episodes."""
    patch.setattr(dataset_builder, "worker_pool", lambda _: ThreadPoolExecutor(1))
    patch.setattr(dataset_builder, "PROBES", 2)
    patch.setattr(dataset_builder, "PATIENT_PROBES", 1)


@pytest.fixture(scope="module", params=[True, pytest.param(False, marks=pytest.mark.slow)], ids=["quick", "whole"])
def quick(request: pytest.FixtureRequest) -> bool:
    return request.param


@pytest.fixture(scope="module")
def built(quick: bool, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, int]]]:
    """A folder with the tiny set, and the progress that building it told."""
    folder = tmp_path_factory.mktemp("built")
    with pytest.MonkeyPatch.context() as patch:
        into(patch, folder)
        if quick:
            quickly(patch)
        with pytest.raises(InputError, match="not built yet; run: roboassembly dataset build tiny"):
            load_manifest("tiny")
        return folder, list(dataset_builder.build_dataset(TINY, 0, jobs=1))


@pytest.fixture
def tiny(
    quick: bool, built: tuple[Path, list[tuple[int, int]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Recipe:
    """The set, built, in a copy of its own."""
    shutil.copytree(built[0], tmp_path / "cache")
    into(monkeypatch, tmp_path / "cache")
    if quick:
        quickly(monkeypatch)
    return TINY


def test_build_resumes_and_reproduces(tiny: Recipe, built: tuple[Path, list[tuple[int, int]]]) -> None:
    assert built[1][0] == (0, 7)
    assert built[1][-1] == (7, 7)
    manifest = load_manifest("tiny")
    splits = [e.split for e in manifest.entries]
    assert (splits.count("easy"), splits.count("hard"), splits.count("test")) == (2, 2, 3)
    assert {e.family for e in manifest.entries if e.split != "test"} == {"cantilever", "shell"}
    assert [e.family for e in manifest.entries if e.unseen] == ["upholstered"]
    assert len({e.hash for e in manifest.entries}) == 7
    easy, hard = ([e.difficulty for e in manifest.entries if e.split == s] for s in ("easy", "hard"))
    assert max(easy) <= min(hard)

    # Killed while writing a line: all whole lines count, the broken one is done again.
    journal = manifest_path("tiny").with_suffix(f".{datasets.VERSION}.0.jsonl")
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:5]) + lines[5][:20] + b"\n")
    before = manifest_path("tiny").read_bytes()
    assert next(iter(dataset_builder.build_dataset(tiny, 0, jobs=1))) == (5, 7)
    list(dataset_builder.build_dataset(tiny, 0, jobs=1))
    assert manifest_path("tiny").read_bytes() == before


@pytest.mark.usefixtures("tiny")
def test_entries_are_checked_against_their_hash() -> None:
    entry = load_manifest("tiny").entries[0]
    assert make_entry(entry).name == f"{entry.family}-{entry.seed}"
    path = manifest_path("tiny")
    path.write_text(path.read_text().replace(entry.hash, "0" * 16))
    with pytest.raises(InputError, match="no longer what its data set was built from"):
        make_entry(load_manifest("tiny").entries[0])
    path.write_text(json.dumps({"name": "tiny"}))
    with pytest.raises(InputError, match="build the set again"):
        load_manifest("tiny")


def test_picks(tmp_path: Path) -> None:
    storage.save(catalogue.make("stool"), tmp_path / "many" / "a")
    storage.save(catalogue.make("throne"), tmp_path / "many" / "b")
    assert [p.furniture().name for p in furniture_refs(f"folder:{tmp_path / 'many'}")] == ["stool-0", "throne-0"]
    assert [p.name for p in furniture_refs(f"folder:{tmp_path / 'many' / 'b'}")] == ["b"]
    with pytest.raises(InputError, match="holds no furniture folders"):
        furniture_refs(f"folder:{tmp_path}")
    with pytest.raises(UnknownNameError, match="did you mean chairs-412"):
        furniture_refs("chair-412:test")
    with pytest.raises(
        UnknownNameError, match="known: all, easy, hard, test, test-by-version, train, train-by-version"
    ):
        furniture_refs("chairs-412:validation")


def test_sets_have_no_piece_in_common() -> None:
    """No seed of one set is within reach of another's, replacements included."""
    reach = sorted(
        (first, first + 5_000)
        for recipe in datasets.RECIPES.values()
        for first in (recipe.first_seed, recipe.first_seed + 50_000)
    )
    assert all(before[1] < after[0] for before, after in pairwise(reach))


@pytest.mark.slow
def test_versions_stay_on_one_side_of_the_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two versions each of four chairs: divided by source chair, and beside that version by version."""
    into(monkeypatch, tmp_path)
    recipe = Recipe("tiny", "for tests", 3, 1, 0, 1, versions=2)
    monkeypatch.setitem(datasets.RECIPES, "tiny", recipe)
    monkeypatch.setattr(dataset_builder, "CHAIRS", {name: CHAIRS[name] for name in ("shell", "throne")})
    list(dataset_builder.build_dataset(recipe, 0, jobs=1))
    entries = load_manifest("tiny").entries
    assert len(entries) == len({e.hash for e in entries}) == 8
    sources = {split: {(e.family, e.seed) for e in entries if (e.split == "test") == split} for split in (True, False)}
    assert len(sources[True]) == 1
    assert len(sources[False]) == 3
    assert not sources[True] & sources[False]
    # The easier one of three sources, with both versions.
    assert [len(furniture_refs(f"tiny:{split}")) for split in ("easy", "hard", "test")] == [2, 4, 2]
    assert len({(e.family, e.seed, e.split, e.difficulty) for e in entries}) == 4
    assert [len(furniture_refs(f"tiny:{split}-by-version")) for split in ("train", "test")] == [6, 2]
    relative = next(e for e in entries if e.version == 1)
    assert make_entry(relative).name == f"{relative.family}-{relative.seed}.1"
    assert catalogue.find(relative.name).parts[0].mesh.content_hash == make_entry(relative).parts[0].mesh.content_hash


def test_a_version_that_search_does_not_solve_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    into(monkeypatch, tmp_path)
    recipe = Recipe("tiny", "for tests", 1, 1, 0, 1, versions=2)
    monkeypatch.setitem(datasets.RECIPES, "tiny", recipe)
    monkeypatch.setattr(dataset_builder, "CHAIRS", {"shell": CHAIRS["shell"]})
    unsolved = {(1, 1), (2, 0), (50_002, 2)}

    def examine(family: str, seed: int, version: int) -> dataset_builder.Candidate:
        solved = (seed, version) not in unsolved
        return dataset_builder.Candidate(family, seed, version, 5, solved, 0.0, False, 10, f"{seed}.{version}")

    monkeypatch.setattr(dataset_builder, "examine", examine)
    monkeypatch.setattr(dataset_builder, "worker_pool", lambda _: ThreadPoolExecutor(1))
    list(dataset_builder.build_dataset(recipe, 0, jobs=1))
    assert {(e.seed, e.version) for e in load_manifest("tiny").entries} == {(1, 0), (1, 2), (50_002, 0), (50_002, 1)}


def test_sets_without_versions_cannot_be_divided_by_version(tiny: Recipe) -> None:
    with pytest.raises(InputError, match="has no versions of its pieces to divide"):
        furniture_refs(f"{tiny.name}:test-by-version")


@pytest.mark.slow
def test_patient_play_gets_stuck_only_in_true_dead_ends() -> None:
    """Two slats between two posts: whoever joins the posts by one slat has shut out the other."""
    task = ObjectCentricTask(catalogue.make("ladder"))
    hasty = [assemble_in_random_order(task, s, best_w=True, patient=False, budget=Budget(states=0)) for s in range(3)]
    patient = [assemble_in_random_order(task, s, best_w=True, patient=True, budget=Budget(states=0)) for s in range(3)]
    assert not any(p.completed for p in patient)
    assert all(a.merges <= len(task.furniture.parts) - 2 for a in patient)
    assert sum(a.merges for a in patient) >= sum(a.merges for a in hasty)


def test_all_parts_at_once_finds_an_easy_assembly() -> None:
    """Two boxes in the open, a metre from where they belong."""
    from roboassembly.planning.joint import JointWorld, joint_rrt_connect

    mesh = shapes.brick(0.1, 0.1, 0.1)
    start = [SE3(np.eye(3), np.array([x, 0.0, 0.2])) for x in (0.0, 0.5)]
    goal = [SE3(np.eye(3), np.array([x, 1.0, 0.2])) for x in (0.5, 0.39)]
    bodies = tuple(Body(str(i), (Shape(mesh, SE3.Identity()),), p, moves=True) for i, p in enumerate(start))
    world = JointWorld(Scene(bodies))
    bounds = np.array([[-0.5, -0.5, 0.0], [1.0, 1.5, 1.0]])
    status, path, _ = joint_rrt_connect(world, start, goal, bounds, Budget(50_000), 0)
    assert status is PlanningStatus.SOLVED
    assert all(np.allclose(p.homogeneous, q.homogeneous) for p, q in zip(path[0], start, strict=True))
    assert all(np.allclose(p.homogeneous, q.homogeneous, atol=1e-6) for p, q in zip(path[-1], goal, strict=True))
    again = joint_rrt_connect(JointWorld(Scene(bodies)), start, goal, bounds, Budget(50_000), 0)[1]
    assert len(again) == len(path)
    assert all(
        np.allclose(p.homogeneous, q.homogeneous)
        for a, b in zip(path, again, strict=True)
        for p, q in zip(a, b, strict=True)
    )
    overlapping = [start[0], start[0]]
    assert joint_rrt_connect(world, start, overlapping, bounds, Budget(100), 0)[0] is PlanningStatus.GOAL_IN_COLLISION


def test_the_baseline_counts_to_its_budget() -> None:
    result = solve_jointly(catalogue.make("cantilever"), 0, Budget(states=3_000))
    assert result.status is PlanningStatus.BUDGET_EXHAUSTED
    # The last edge is tested to its end.
    assert 3_000 <= result.planning_steps <= 3_300
