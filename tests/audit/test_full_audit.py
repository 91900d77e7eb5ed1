"""The independent audit of full plans passes what is right and catches what is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from roboassembly.audit.full import RobotAuditReport, RobotViolationKind, audit_full_plan
from roboassembly.geometry.poses import SE3
from roboassembly.task.full.cell_state import Segment
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.posts import Post
from roboassembly.task.plans.full_plan import FullPlan

pytest.importorskip("fcl")

COARSE = 0.1
FOLDED = np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.0, 0.0])
LOW = np.array([0.81, 1.75, -0.05, -1.51, 1.08, 2.44, -1.4])
"""Reaches the ground beside the platform."""


def with_segment(plan: FullPlan, index: int, change: Callable[[Segment], Segment]) -> FullPlan:
    segments = list(plan.steps[0].segments)
    segments[index] = change(segments[index])
    step = replace(plan.steps[0], segments=tuple(segments))
    return replace(plan, steps=(step,))


def by_way_of(q: np.ndarray) -> Callable[[Segment], Segment]:
    return lambda segment: replace(segment, path=(segment.path[0], q, segment.path[-1]))


def kinds(report: RobotAuditReport) -> set[RobotViolationKind]:
    assert not report.passed
    assert sum(report.counts.values()) >= len(report.first) > 0
    assert all(kind.value in report.summary() for kind in report.counts)
    return set(report.counts)


def test_a_right_plan_passes(two_merges: FullPlan) -> None:
    report = audit_full_plan(two_merges, COARSE)
    assert report.passed, report.summary()
    assert report.segments == sum(len(step.segments) for step in two_merges.steps)
    finer = audit_full_plan(replace(two_merges, steps=two_merges.steps[:1]), 0.5 * COARSE)
    half = audit_full_plan(replace(two_merges, steps=two_merges.steps[:1]), COARSE)
    assert 1.8 * half.states < finer.states < 2.1 * half.states


def test_driving_through_a_post(two_merges: FullPlan) -> None:
    standing = two_merges.steps[0].segments[0].before.placed[-1]
    q = np.array([*standing.post.top[:2], 0.0, *two_merges.initial.cell_state.robots[0].at[3:]])
    report = audit_full_plan(with_segment(two_merges, 0, by_way_of(q)), COARSE)
    assert RobotViolationKind.PENETRATION in kinds(report)
    assert any("platform in" in v.what and "post" in v.what for v in report.first)


def test_driving_through_the_other_robot(two_merges: FullPlan) -> None:
    segment = two_merges.steps[0].segments[0]
    report = audit_full_plan(
        with_segment(two_merges, 0, by_way_of(segment.before.robots[1 - segment.robot].at)), COARSE
    )
    assert any("the other's platform" in v.what for v in report.first)


def test_an_arm_through_itself_through_the_ground_and_past_its_limit(two_merges: FullPlan) -> None:
    start = two_merges.initial.cell_state.robots[two_merges.steps[0].segments[0].robot].at
    for arm, kind in (
        (FOLDED, RobotViolationKind.OWN_PENETRATION),
        (LOW, RobotViolationKind.GROUND),
        (np.array([*start[3:9], 3.0]), RobotViolationKind.JOINT_LIMIT),
    ):
        bad = with_segment(two_merges, 0, by_way_of(np.array([*start[:3], *arm])))
        assert kind in kinds(audit_full_plan(bad, COARSE))


def test_mating_hand_through_another_part_is_caught(two_merges: FullPlan) -> None:
    """Without the way that avoids it, the mating hand comes out of v's group sideways."""
    segments = two_merges.steps[0].segments
    mate = next(segment for segment in segments if segment.stage is Stage.MATE)

    def shifted(segment: Segment) -> Segment:
        off = np.zeros(10)
        off[:2] = 0.03
        return replace(
            segment, path=(*segment.path[:-1], segment.path[-1] + off, segment.path[-1] - off, segment.path[-1])
        )

    step = replace(two_merges.steps[0], segments=(shifted(mate),))
    report = audit_full_plan(replace(two_merges, steps=(step,)), 0.002)
    assert RobotViolationKind.PENETRATION in kinds(report)
    assert any(v.segment == "R_a: mate" and "what the other holds" in v.what for v in report.first)


def test_a_post_and_a_part_in_a_standing_part(two_merges: FullPlan) -> None:
    state = two_merges.initial.cell_state
    one, two = state.placed[0], state.placed[1]
    shift = SE3(np.eye(3), two.post.top - one.post.top)
    moved = replace(one, group=one.group.moved_to(shift * one.group.world_from_furniture))
    initial = replace(two_merges.initial, cell_state=replace(state, placed=(moved, *state.placed[1:])))
    report = audit_full_plan(replace(two_merges, initial=initial, steps=()), COARSE)
    assert kinds(report) == {RobotViolationKind.PENETRATION}
    assert all("both standing" in v.what for v in report.first)
    assert audit_full_plan(replace(two_merges, steps=()), COARSE).passed


def test_both_posts_of_a_pair_are_obstacles(two_merges: FullPlan) -> None:
    state = two_merges.initial.cell_state
    one, two = state.placed[0], state.placed[1]
    # The second post reaches 50 mm into what stands on another one.
    inside = replace(one, post=Post(one.post.top, Post(two.post.top + np.array([0.0, 0.0, 0.05]))))
    initial = replace(two_merges.initial, cell_state=replace(state, placed=(inside, *state.placed[1:])))
    report = audit_full_plan(replace(two_merges, initial=initial, steps=()), COARSE)
    assert kinds(report) == {RobotViolationKind.PENETRATION}
    assert any("post 0" in v.what and "part" in v.what for v in report.first)
    # A platform drives through the second post, 3 m from where the first one is.
    aside = np.array([3.0, 0.0, 0.0])

    def paired(segment: Segment) -> Segment:
        standing = segment.before.placed[-1]
        pair = replace(standing, post=Post(standing.post.top, Post(standing.post.top + aside)))
        before = replace(segment.before, placed=(*segment.before.placed[:-1], pair))
        way = np.array([*(standing.post.top + aside)[:2], *segment.path[0][2:]])
        return replace(segment, before=before, path=(way,))

    bad = with_segment(two_merges, 0, paired)
    assert any("platform in post" in v.what for v in audit_full_plan(bad, COARSE).first)


def test_jumps(two_merges: FullPlan) -> None:
    report = audit_full_plan(
        with_segment(two_merges, 1, lambda segment: replace(segment, path=(segment.path[0] + 1e-3, *segment.path[1:]))),
        COARSE,
    )
    assert kinds(report) == {RobotViolationKind.JUMP}
    state = two_merges.steps[0].segments[2].before
    standing = state.placed[0]
    away = standing.group.world_from_furniture.copy()
    away.translation = away.translation + np.array([0.0, 0.0, 0.001])
    moved = replace(standing, group=standing.group.moved_to(away))
    report = audit_full_plan(
        with_segment(
            two_merges, 2, lambda segment: replace(segment, before=replace(state, placed=(moved, *state.placed[1:])))
        ),
        COARSE,
    )
    assert RobotViolationKind.JUMP in kinds(report)
    assert any(v.what.startswith("part ") for v in report.first)


def test_incomplete_plan_is_caught(two_merges: FullPlan) -> None:
    report = audit_full_plan(replace(two_merges, success=True), 1.0)
    assert report.counts == {RobotViolationKind.NOT_ASSEMBLED: 1}
