"""The path of one action through the code: few files, and calls that never lead back to an importing module."""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import roboassembly
import shapes
from roboassembly.furniture.model import Furniture
from roboassembly.solvers.options import grasping
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict

TASK = Path(roboassembly.__file__).parent / "task"


def watched(step: Callable[..., Any], *arguments: Any) -> tuple[Any, set[tuple[Path, Path]]]:
    """The outcome of a step, and caller and callee of every call from one file of the task room to another."""
    found: set[tuple[str, str]] = set()
    room = f"{TASK}{os.sep}"

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and (callee := frame.f_code.co_filename).startswith(room) and frame.f_back is not None:
            caller = frame.f_back.f_code.co_filename
            if caller != callee and caller.startswith(room):
                found.add((caller, callee))

    sys.setprofile(note)
    try:
        outcome = step(*arguments)
    finally:
        sys.setprofile(None)
    return outcome, {(Path(caller), Path(callee)) for caller, callee in found}


@cache
def imported_by(path: Path) -> set[Path]:
    """Files of the task room that a file imports, directly or not."""
    left, seen = [path], set[Path]()
    while left:
        for node in ast.walk(ast.parse(left.pop().read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("roboassembly.task"):
                module = TASK.parents[1].joinpath(*node.module.split(".")).with_suffix(".py")
                if module.is_file() and module not in seen:
                    seen.add(module)
                    left.append(module)
    return seen


def check(calls: set[tuple[Path, Path]], most: int) -> None:
    files = {path for call in calls for path in call}
    assert len(files) <= most, sorted(str(path.relative_to(TASK)) for path in files)
    for caller, callee in calls:
        assert callee in imported_by(caller), f"{caller.name} calls back into {callee.name}"
        assert caller not in imported_by(callee)


@pytest.fixture(scope="module")
def stool(chair) -> Furniture:
    return chair("stool", 0)


def test_an_object_centric_step_passes_few_files(stool: Furniture) -> None:
    task = ObjectCentricTask(stool)
    state = task.initial_state(np.random.default_rng(0))
    c = stool.connections[0]
    merged = False
    for w in range(6):
        outcome, calls = watched(task.step, state, (c.part_a, c.part_b, c.point_a, c.point_b, w), 3)
        check(calls, 6)
        merged |= outcome.verdict is ObjectCentricVerdict.MERGED
    assert merged


def test_a_full_step_passes_few_files() -> None:
    task = FullTask(shapes.stand())
    state = task.initial_state(np.random.default_rng(0))
    c = task.furniture.connections[0]
    for action in grasping(task, state, state.groups, frozenset({c.part_a}), frozenset({c.part_b})):
        outcome, calls = watched(task.step, state, action, 3)
        check(calls, 12)
        if outcome.verdict is FullVerdict.MERGED:
            return
    pytest.fail("no action merges")
