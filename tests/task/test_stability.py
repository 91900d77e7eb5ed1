"""Stability of a plan's states: physics against the support polygon, hand-made cases, and the record."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.settings import set_upright
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric.stability import (
    StandCheck,
    plan_stability,
    polygon_verdict,
    release_group,
    support_of,
    with_stability,
)
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan import Plan
from roboassembly.task.plans.plan_record import read_plan
from roboassembly.task.plans.stability import GroupRole, GroupStability, PlanStability
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import group_in_place


@pytest.fixture(scope="module")
def plan(table: Furniture) -> Plan:
    found = set_upright(solve(table, 0).plan)
    assert found.success
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("family", "seed"), [("stool", 0), ("shelf_open", 1), ("ladder", 0)])
def test_polygon_and_physics_agree_wherever_the_polygon_decides(chair, family: str, seed: int) -> None:
    compare_verdicts(chair(family, seed), 20)


def test_polygon_and_physics_agree_on_a_small_chair(chair) -> None:
    compare_verdicts(chair("cantilever", 0), 2)


def compare_verdicts(piece: Furniture, sets: int) -> None:
    rng = np.random.default_rng(0)
    seen = {True: 0, False: 0, None: 0}
    for _ in range(sets):
        count = int(rng.integers(1, len(piece.parts) + 1))
        group = group_in_place(piece, rng.choice(len(piece.parts), count, replace=False).tolist())
        support = support_of(piece, group)
        for up in UP_AXES:
            verdict = polygon_verdict(support, up)
            seen[verdict] += 1
            if verdict is not None:
                standing = group.moved_to(SE3(align_axis(up, np.array([0.0, 0.0, 1.0])), np.zeros(3)))
                assert release_group(piece, standing).stable is verdict, (group.parts, up)
    assert seen[True]
    assert seen[False]


def test_a_table_stands_on_four_legs_or_its_top_and_not_on_two(table: Furniture) -> None:
    check = StandCheck(table)
    assert check.stands(range(5), 0)
    assert check.stands(range(5), 1)  # upside down
    assert check.stands((0, 1), 1)  # a leg on the top that lies upside down
    assert not check.stands((0, 1, 2), 0)  # on two legs in a row
    assert not check.stands((0, 1), 0)


def test_a_released_group_reports_how_far_it_moves(table: Furniture) -> None:
    falling = release_group(table, group_in_place(table, (0, 1, 2)))
    assert falling.tilt > np.deg2rad(30.0)
    still = release_group(table, group_in_place(table, range(5)))
    assert still.tilt < np.deg2rad(0.1)
    assert still.shift < 0.01


def test_every_group_of_every_state_is_judged(plan: Plan) -> None:
    stability = plan_stability(plan)
    parts = set(range(5))
    resting = [g for g in stability.groups if g.role is GroupRole.RESTING]
    for step in range(-1, 4):
        groups = [set(g.parts) for g in resting if g.step == step]
        assert set().union(*groups) == parts
        assert sum(map(len, groups)) == 5  # each part once
        assert len(groups) == 4 - step
    for index, step in enumerate(plan.steps):
        own = {g.role: set(g.parts) for g in stability.groups if g.step == index and g.role is not GroupRole.RESTING}
        assert own == {GroupRole.WAITING: {*step.waiting}, GroupRole.JOINED: {*step.waiting, *step.moving}}


def test_what_to_hold_comes_step_by_step() -> None:
    rows = [(-1, True), (0, True), (1, False), (3, False), (3, True)]
    groups = tuple(GroupStability(step, GroupRole.WAITING, (0,), stable, 0.0, 0.0) for step, stable in rows)
    stability = PlanStability(groups)
    assert not stability.stable
    assert stability.steps_held == (1, 3)
    assert stability.group_to_hold(0) is None
    assert stability.group_to_hold(3) is groups[3]


def test_a_stable_search_needs_fewer_hands_and_says_which(chair) -> None:
    small = chair("cantilever", 0)
    plain = plan_stability(solve(small, 0).plan)
    found = solve(small, 0, stable=True)
    assert found.plan.success
    assert found.plan.stability == plan_stability(found.plan)
    assert plain.steps_held == (0,)
    assert found.plan.stability is not None
    assert found.plan.stability.stable


def test_a_plan_reads_back_as_it_was_written(plan: Plan, table: Furniture) -> None:
    content = plan_file.encode(plan)
    back = read_plan(content, "plan.json", table)
    for read, made in zip(back.steps, plan.steps, strict=True):
        assert (read.action, read.waiting, sorted(read.moving)) == (made.action, made.waiting, sorted(made.moving))
        for mine, its in ((read.path, made.path), (read.settling, made.settling), (read.after, made.after)):
            assert np.allclose([p.homogeneous for p in mine], [p.homogeneous for p in its], rtol=0.0, atol=1e-12)
    assert back.upright is not None


def test_stability_is_in_the_file_only_if_it_was_asked_for(plan: Plan) -> None:
    assert b"stability" not in plan_file.encode(plan)
    written = msgspec.json.decode(plan_file.encode(with_stability(plan)))["stability"]
    first = [written[0][key] for key in ("step", "role", "parts", "stable")]
    assert first == [-1, "resting", [0], True]


def test_broken_records_get_one_line(plan: Plan, table: Furniture, stand: Furniture) -> None:
    content = msgspec.json.decode(plan_file.encode(plan))

    def broken(change) -> str:
        copy = msgspec.json.decode(msgspec.json.encode(content))
        change(copy)
        with pytest.raises(InputError) as error:
            read_plan(msgspec.json.encode(copy), "plan.json", table)
        assert "\n" not in str(error.value)
        return str(error.value)

    assert "step 1, moving: part 7; expected 0 to 4" in broken(lambda c: c["steps"][1]["moving"][0].update(part=7))
    assert "after: 4 poses; expected 5" in broken(lambda c: c["steps"][0]["after"].pop())
    assert "expected each part of 0..4 once" in broken(lambda c: c["steps"][0]["still"].pop())
    assert "seven finite numbers" in broken(lambda c: c["steps"][2]["path"].append([1.0]))
    assert "parts of `still`" in broken(lambda c: c["steps"][0].update(waiting=[9]))
    with pytest.raises(InputError, match="whose parts differ"):
        read_plan(plan_file.encode(plan), "plan.json", stand)
    full = msgspec.json.decode(plan_file.encode(plan))
    full["setting"] = "full"
    for step in full["steps"]:
        step["action"] = [*step["action"][:4], 0, 0]
    with pytest.raises(InputError, match="posts hold every group"):
        read_plan(msgspec.json.encode(full), "plan.json", table)


def test_stability_does_not_depend_on_what_was_asked_before(table: Furniture) -> None:
    first, second = StandCheck(table), StandCheck(table)
    sets = [(0, 1), (0, 1, 2), (1,), (0, 1, 2, 3)]
    forward = [first.stands(parts, up) for parts in sets for up in range(6)]
    backward = [second.stands(parts, up) for parts in reversed(sets) for up in reversed(range(6))]
    assert forward == backward[::-1]
