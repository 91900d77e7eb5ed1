"""The independent audit passes what is right and catches what is not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from roboassembly.audit.object_centric import ViolationKind, audit_plan
from roboassembly.datasets import catalogue
from roboassembly.errors import MissingExtraError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Provenance
from roboassembly.generate import CHAIRS, generate
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.search import solve
from roboassembly.task.plans.plan import Plan, PlanStep

pytest.importorskip("fcl")


@cache
def good_plan() -> Plan:
    furniture = annotate("stool-0", generate("stool", 0), Provenance("generated"))
    result = solve(furniture, 0)
    assert result.plan.success
    return result.plan


def with_step(plan: Plan, index: int, change: Callable[[PlanStep], PlanStep]) -> Plan:
    steps = list(plan.steps)
    steps[index] = change(steps[index])
    return replace(plan, steps=tuple(steps))


def shifted(pose: SE3, *offset: float) -> SE3:
    return SE3(pose.rotation, pose.translation + np.array(offset))


def test_a_good_plan_passes() -> None:
    plan = good_plan()
    report = audit_plan(plan)
    assert report.passed, report.summary()
    assert report.steps == len(plan.steps)
    length = sum(
        float(np.linalg.norm(b.translation - a.translation))
        for step in plan.steps
        for a, b in zip(step.path[:-1], step.path[1:], strict=True)
    )
    assert report.states >= length / 0.002
    assert "nothing wrong" in report.summary()


def test_a_path_shifted_into_a_part_is_caught() -> None:
    """The whole of every path by 3 mm: clearances are some tenths of a millimetre."""
    plan = good_plan()
    index = len(plan.steps) - 1
    step = plan.steps[index]
    # Past the mating pose, along the last leg of the path, so that the shift drives the joint home and beyond.
    into = step.path[-1].translation - step.path[-2].translation
    into = 0.003 * into / np.linalg.norm(into)

    bad = with_step(plan, index, lambda s: replace(s, path=tuple(shifted(pose, *into) for pose in s.path)))
    report = audit_plan(bad)
    assert report.counts[ViolationKind.PATH_PENETRATION] > 0
    first = next(v for v in report.first if v.kind is ViolationKind.PATH_PENETRATION)
    assert first.step == index
    assert first.parts[0] in step.moving
    assert first.parts[1] in step.still
    assert 0.0 < first.depth < 0.05
    assert report.counts[ViolationKind.DISCONTINUITY] > 0


def test_a_path_shifted_at_its_last_waypoint_only_is_caught() -> None:
    plan = good_plan()
    last = plan.steps[-1].path[-1]
    into = last.translation - plan.steps[-1].path[-2].translation
    into = 0.003 * into / np.linalg.norm(into)
    bad = with_step(plan, -1, lambda s: replace(s, path=(*s.path[:-1], shifted(last, *into))))
    report = audit_plan(bad)
    assert report.counts[ViolationKind.PATH_PENETRATION] > 0
    assert report.counts[ViolationKind.NOT_RIGID] > 0
    assert ViolationKind.DISCONTINUITY not in report.counts


def test_a_waypoint_under_the_ground_is_caught() -> None:
    plan = good_plan()

    def sink(step: PlanStep) -> PlanStep:
        # The first waypoint lies on the ground; a detour leads the group 2 cm into it.
        return replace(step, path=(step.path[0], shifted(step.path[0], 0.0, 0.0, -0.02), *step.path[1:]))

    report = audit_plan(with_step(plan, 1, sink))
    assert set(report.counts) == {ViolationKind.PATH_GROUND}
    assert report.first[0].step == 1
    assert max(v.depth for v in report.first) > 0.005


def test_a_teleported_part_is_caught() -> None:
    """Far from everything else: nothing penetrates, but the part is not where it was left."""
    plan = good_plan()
    step = plan.steps[1]
    part = next(p for p in step.still if p not in step.waiting)

    def teleport(step: PlanStep) -> PlanStep:
        return replace(step, still={**step.still, part: shifted(step.still[part], 50.0, 0.0, 0.0)})

    report = audit_plan(with_step(plan, 1, teleport))
    assert set(report.counts) == {ViolationKind.DISCONTINUITY}
    assert {v.parts for v in report.first} == {(part,)}
    assert report.first[0].depth == pytest.approx(50.0)


def test_parts_in_each_other_at_rest_are_caught() -> None:
    plan = good_plan()
    report = audit_plan(replace(plan, initial=(plan.initial[1], *plan.initial[1:])))
    assert report.counts[ViolationKind.REST_PENETRATION] > 0
    assert report.first[0].step == -1


def test_a_final_arrangement_that_is_not_the_furniture_is_caught() -> None:
    plan = good_plan()
    last = plan.steps[-1]
    after = (*last.after[:-1], shifted(last.after[-1], 0.0, 0.0, 0.5))
    report = audit_plan(with_step(plan, -1, lambda s: replace(s, after=after)))
    assert report.counts[ViolationKind.NOT_ASSEMBLED] == 1


def test_a_pose_that_is_not_a_rotation_is_caught() -> None:
    plan = good_plan()
    stretched = SE3(1.0001 * plan.initial[0].rotation, plan.initial[0].translation)
    report = audit_plan(replace(plan, initial=(stretched, *plan.initial[1:])))
    assert report.counts[ViolationKind.NOT_A_ROTATION] == 1


def test_a_step_that_forgets_a_part_is_caught() -> None:
    plan = good_plan()
    kept = dict(list(plan.steps[0].still.items())[1:])
    report = audit_plan(with_step(plan, 0, lambda s: replace(s, still=kept)))
    assert report.counts[ViolationKind.MISSING_PART] == 1


def test_audit_imports_no_planner() -> None:
    code = (
        "import sys, roboassembly.audit.object_centric; "
        "print([m for m in sys.modules if m.startswith('roboassembly.planning') or m == 'ompl'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_without_fcl_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fcl", None)
    with pytest.raises(MissingExtraError, match=r"'\.\[bench\]'"):
        audit_plan(good_plan())


@pytest.mark.slow
@pytest.mark.parametrize("family", CHAIRS)
def test_200_chairs(family: str) -> None:
    """Twelve chairs of every family: assembled, and clean by the independent checker's word."""
    for seed in range(100, 112):
        result = solve(catalogue.make(family, seed), seed)
        assert result.plan.success, (family, seed, result.reason)
        report = audit_plan(result.plan)
        assert report.passed, (family, seed, report.summary())
