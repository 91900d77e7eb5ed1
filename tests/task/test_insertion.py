"""Insertions of fasteners: when they go in, on which way, and what happens if none is free."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from roboassembly.audit.object_centric import ViolationKind, audit_plan
from roboassembly.datasets import catalogue
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.manual.make import make_manual
from roboassembly.manual.part_list import part_kinds
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric.insertion import OUTSIDE, with_insertions
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan import Plan
from roboassembly.task.plans.plan_record import read_plan
from roboassembly.viewer.playback import make_timeline


def test_hidden_dowels_go_in_before_and_screws_after_the_parts_are_joined(fastened_plan: Plan) -> None:
    plan, fasteners = fastened_plan, fastened_plan.furniture.fasteners
    assert plan.not_inserted == ()
    joined_in: dict[frozenset[int], int] = {}
    groups = {p: frozenset((p,)) for p in range(3)}
    for index, step in enumerate(plan.steps):
        merged = frozenset((*step.moving, *step.waiting))
        groups |= dict.fromkeys(merged, merged)
        for fastener in fasteners:
            if frozenset(fastener.joins) <= merged:
                joined_in.setdefault(frozenset(fastener.joins), index)
    for insertion in plan.insertions:
        fastener = fasteners[insertion.fastener]
        joined = joined_in[frozenset(fastener.joins)]
        assert (insertion.after < joined) if fastener.kind == "dowel" else (insertion.after == joined), fastener.name


def test_ways_are_straight_along_the_axis_and_screws_turn(fastened_plan: Plan) -> None:
    for insertion in fastened_plan.insertions:
        path = insertion.path
        axis = path[-1].rotation[:, 2]
        offsets = np.array([pose.translation - path[-1].translation for pose in path])
        along = offsets @ axis
        assert offsets == pytest.approx(along[:, None] * axis, abs=1e-9)
        # All of it is OUTSIDE or more beyond the outermost corner of the parts that it joins.
        length = float(np.ptp(fastened_plan.furniture.fasteners[insertion.fastener].mesh.vertices[:, 2]))
        assert abs(along[0]) >= OUTSIDE + length - 1e-9
        assert (np.diff(np.abs(along)) <= 1e-9).all()
        turned = sum(
            float(np.arccos(np.clip(0.5 * (np.trace(a.rotation.T @ b.rotation) - 1.0), -1.0, 1.0)))
            for a, b in pairwise(path)
        )
        screw = fastened_plan.furniture.fasteners[insertion.fastener].kind == "screw"
        assert turned == pytest.approx(6 * 2.0 * np.pi if screw else 0.0, abs=1e-6)


def test_the_audit_finds_nothing_and_finds_what_is_put_wrong(fastened_plan: Plan) -> None:
    assert audit_plan(fastened_plan, resolution=0.004, angular_resolution=0.2).passed
    first = fastened_plan.insertions[0]
    aside = SE3(np.eye(3), np.array([0.0, 0.0, 0.003]))
    wrong = replace(first, path=tuple(aside * pose for pose in first.path))
    report = audit_plan(replace(fastened_plan, insertions=(wrong, *fastened_plan.insertions[1:])), 0.004, 0.2)
    assert ViolationKind.PATH_PENETRATION in report.counts
    assert ViolationKind.DISCONTINUITY in report.counts
    lost = replace(fastened_plan, insertions=fastened_plan.insertions[1:])
    assert ViolationKind.MISSING_PART in audit_plan(lost, 0.004, 0.2).counts


def test_the_same_plan_gives_the_same_insertions(fastened: Furniture, fastened_plan: Plan) -> None:
    bare = replace(fastened_plan, insertions=(), not_inserted=())
    assert plan_file.encode(with_insertions(bare)) == plan_file.encode(with_insertions(bare))


def test_a_fastener_without_a_way_in_is_named(fastened: Furniture) -> None:
    # A dowel in the middle of the board, where there is no hole.
    dowel = fastened.fasteners[0]
    inside = SE3(dowel.place.rotation, np.array([0.0, 0.0, 0.11]))
    stuck = replace(fastened, fasteners=(replace(dowel, place=inside, joins=(0,)),))
    plan = with_insertions(solve(stuck, 0).plan)
    assert plan.insertions == ()
    ((index, reason),) = plan.not_inserted
    assert (index, reason) == (0, "no straight way in is free along its axis")


def test_furniture_without_fasteners_is_left_alone(table: Furniture) -> None:
    plan = solve(table, 0).plan
    assert with_insertions(plan) is plan
    assert b"insert" not in plan_file.encode(plan)


def test_insertions_are_in_the_file_and_read_back(fastened: Furniture, fastened_plan: Plan) -> None:
    content = plan_file.encode(fastened_plan)
    back = read_plan(content, "plan.json", fastened)
    assert [(i.fastener, i.after, i.part, len(i.path)) for i in back.insertions] == [
        (i.fastener, i.after, i.part, len(i.path)) for i in fastened_plan.insertions
    ]
    broken = msgspec.json.decode(content)
    broken["insertions"][0]["fastener"] = "nail"
    with pytest.raises(InputError, match="fastener 'nail' is not in the furniture"):
        read_plan(msgspec.json.encode(broken), "plan.json", fastened)


@pytest.mark.parametrize(
    ("family", "count"), [pytest.param("stool", 12, marks=pytest.mark.slow), ("panel", 4), ("pedestal", 1)]
)
def test_all_fasteners_of_generated_furniture_go_in(family: str, count: int) -> None:
    """Heads lie on round legs, not under their surface; no leg stands in front of a screw into a seat."""
    furniture = catalogue.make(family, 2, with_grasps=False, fasteners=True)
    plan = with_insertions(solve(furniture, 0).plan)
    assert len(furniture.fasteners) == count
    assert (len(plan.insertions), plan.not_inserted) == (count, ())
    assert audit_plan(plan, resolution=0.004, angular_resolution=0.2).passed


def test_the_task_knows_nothing_of_fasteners(fastened: Furniture) -> None:
    bare = replace(fastened, fasteners=())
    assert plan_file.encode(solve(fastened, 3).plan) == plan_file.encode(solve(bare, 3).plan)


def test_films_show_fasteners_once_they_go_in(fastened_plan: Plan) -> None:
    timeline = make_timeline(fastened_plan, 10.0)
    count = len(fastened_plan.furniture.parts)
    assert len(timeline.objects) == count + 4
    assert timeline.frames[0].poses[count:] == (None,) * 4
    last = timeline.frames[-1].poses
    for k, insertion in enumerate(fastened_plan.insertions):
        host, own = last[insertion.part], last[count + k]
        assert host is not None
        assert own is not None
        assert np.allclose((host * insertion.part_from_fastener).homogeneous, own.homogeneous)
    shown = [sum(pose is not None for pose in frame.poses[count:]) for frame in timeline.frames]
    assert all(a <= b for a, b in pairwise(shown))
    assert any("go in" in caption or "goes in" in caption for _, caption in timeline.captions)


def test_manuals_count_fasteners_and_show_where_they_go_in(fastened: Furniture, fastened_plan: Plan) -> None:
    kinds = part_kinds(fastened)
    assert [(kind.letter, len(kind.members)) for kind in kinds] == [("A", 1), ("B", 2), ("C", 2), ("D", 2)]
    assert kinds[2].size == (54, 10, 10)
    manual = make_manual(fastened, [step.action for step in fastened_plan.steps], 0)
    assert [step.number for step in manual.steps] == list(range(1, len(manual.steps) + 1))
    done = sum(step.count * len(step.fasteners) for step in manual.steps)
    assert done + len(manual.not_inserted) == 4
    assert all(bool(step.movers) != bool(step.fasteners) for step in manual.steps)
