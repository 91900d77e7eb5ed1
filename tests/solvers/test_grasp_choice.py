"""Tests of the choice of grasps: an order of merges exists afterwards, and the planner finds a plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, islice
from typing import Any

import numpy as np
import pytest

from hands import FclHand, check_region
from roboassembly.datasets import catalogue
from roboassembly.furniture.annotate import add_candidate_grasps, parts_held_alike
from roboassembly.furniture.model import GRASP_REGIONS, Furniture, GraspRegion
from roboassembly.solvers.disassembly import Disassembly, Split
from roboassembly.solvers.full_search import solve_full
from roboassembly.solvers.grasp_choice import choose_grasps, hands_order
from roboassembly.solvers.guide import Suggestion
from roboassembly.solvers.hand_joints import HandJoints
from roboassembly.solvers.options import fitting
from roboassembly.task.full.grips import grip_fits_group, grip_of
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rules.groups import group_in_place

CANDIDATES = 12


@pytest.fixture(scope="module")
def stool() -> Furniture:
    return catalogue.make("three_legged", 24)


@pytest.fixture(scope="module")
def badly_held(stool: Furniture) -> Furniture:
    """The stool with regions where a closed hand touches another part as soon as the furniture is finished."""
    wide, whole = add_candidate_grasps(stool, 40), group_in_place(stool, range(len(stool.parts)))

    def in_the_way(part: int, index: int) -> bool:
        grips = [grip_of(wide, whole, part, 4 * index + direction) for direction in range(4)]
        return not any(grip_fits_group(wide, whole, grip) for grip in grips if grip is not None)

    parts = list(stool.parts)
    for equal in parts_held_alike(stool):
        found = wide.parts[equal[0]].grasps
        bad = tuple(region for k, region in enumerate(found) if all(in_the_way(part, k) for part in equal))
        for part in equal:
            parts[part] = replace(parts[part], grasps=(bad or found)[:GRASP_REGIONS])
    return replace(stool, parts=tuple(parts))


def numbers(regions: tuple[GraspRegion, ...]) -> list[bytes]:
    return [np.concatenate([r.position, r.closing, *r.approaches, [r.width]]).tobytes() for r in regions]


def test_candidates_are_unlike_each_other_and_hold(stool: Furniture) -> None:
    wide = add_candidate_grasps(stool, CANDIDATES)
    for before, part in zip(stool.parts, wide.parts, strict=True):
        assert part.grasps[: len(before.grasps)] == before.grasps
        assert len(part.grasps) == CANDIDATES
    seat = wide.parts[int(np.argmax([part.mesh.volume for part in wide.parts]))]
    checker = FclHand(seat.mesh)
    for index, region in enumerate(seat.grasps):
        check_region(seat.mesh, region, checker)
        for other in seat.grasps[:index]:
            assert (
                np.linalg.norm(region.position - other.position) > 0.015 or abs(region.closing @ other.closing) < 0.95
            )


def test_grasps_that_do_are_kept(stool: Furniture) -> None:
    choice = choose_grasps(stool)
    assert choice.order_exists
    assert choice.furniture is stool


def test_the_order_joins_all_parts_as_the_task_allows(stool: Furniture) -> None:
    order = hands_order(stool)
    assert order is not None
    joined = {frozenset([part]) for part in range(len(stool.parts))}
    grippers = HandJoints(FullTask(stool))
    for leaving, staying in order:
        assert grippers.join(leaving, staying) or grippers.join(staying, leaving)
        joined = (joined - {leaving, staying}) | {leaving | staying}
    assert joined == {frozenset(range(len(stool.parts)))}


def test_grasps_are_chosen_anew_where_no_order_exists(badly_held: Furniture) -> None:
    assert hands_order(badly_held) is None
    choice = choose_grasps(badly_held)
    assert choice.order_exists
    for equal in parts_held_alike(choice.furniture):
        regions = [numbers(choice.furniture.parts[part].grasps) for part in equal]
        assert all(own == regions[0] for own in regions)
        assert 0 < len(regions[0]) <= GRASP_REGIONS
    assert solve_full(choice.furniture, 0).plan.success


def test_a_limited_number_of_orders_is_tested(badly_held: Furniture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without tests of splits, every order looks possible until its own splits are tested."""
    monkeypatch.setattr("roboassembly.solvers.hand_joints._MOST_TESTS", 0)
    monkeypatch.setattr("roboassembly.solvers.grasp_choice._MOST_ORDERS", 1)
    found: list[bool] = []
    order = Disassembly.order

    def counted(*args: Any, **more: Any) -> list[Split] | None:
        found.append(more["exhaustive"])
        return order(*args, **more)

    monkeypatch.setattr(Disassembly, "order", counted)
    assert hands_order(badly_held) is None
    assert found == [False, True]


@pytest.mark.slow
def test_the_choice_is_reproducible(badly_held: Furniture) -> None:
    first, again = ([numbers(part.grasps) for part in choose_grasps(badly_held).furniture.parts] for _ in range(2))
    assert first == again


@pytest.mark.parametrize("tests", [0, 400])
def test_the_search_tries_no_merge_where_no_order_exists(
    badly_held: Furniture, tests: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether hands are tested for all splits that are looked at, or for those of orders only."""
    monkeypatch.setattr("roboassembly.solvers.hand_joints._MOST_TESTS", tests)

    def suggest(task: FullTask, state: FullState) -> list[Suggestion]:
        joints = [((c.part_a, c.point_a), (c.part_b, c.point_b)) for c in badly_held.connections]
        return [Suggestion(action, 1.0) for action in islice(fitting(task, state.groups, joints), 5)]

    task = FullTask(badly_held)
    assert suggest(task, task.initial_state(np.random.default_rng(0)))
    for guide in (None, suggest):
        result = solve_full(badly_held, 0, guide=guide)
        assert not result.plan.success
        assert result.attempts == 0
        assert result.reason == "no order of merges exists in which two hands can join the parts"


def test_joints_of_orders_are_tested_where_others_no_longer_are(
    badly_held: Furniture, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = frozenset(range(len(badly_held.parts)))
    splits = [(frozenset(some), whole - set(some)) for n in (1, 2) for some in combinations(sorted(whole), n)]
    exact = HandJoints(FullTask(badly_held))
    impossible = [split for split in splits if not exact.can_join(*split)]
    monkeypatch.setattr("roboassembly.solvers.hand_joints._MOST_TESTS", 0)
    joints = HandJoints(FullTask(badly_held))
    assert all(joints.may_join(*split) for split in splits if badly_held.joints_between(*split))
    assert joints.tests == 0
    first = impossible[0]
    assert not joints.can_join(*first)
    tests = joints.tests
    assert tests > 0
    # Now it is known, whichever is named first.
    assert not joints.may_join(*first)
    assert not joints.may_join(*first[::-1])
    assert joints.tests == tests


def test_no_choice_without_any_grasp(stool: Furniture) -> None:
    bare = replace(stool, parts=(replace(stool.parts[0], grasps=()), *stool.parts[1:]))
    choice = choose_grasps(bare)
    assert choice.furniture is bare
    assert not choice.order_exists
