"""An assembly by two robots as a record: plan.json tells all of it, and the pictures show it."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from roboassembly.geometry.poses import SE3, pose_from_seven
from roboassembly.rendering.colors import Role
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.visual import visual_links, visual_poses
from roboassembly.task.full.posts import LOWEST
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.viewer.film import key_frames
from roboassembly.viewer.playback import make_timeline
from roboassembly.viewer.timeline import Timeline


@pytest.fixture(scope="module")
def timeline(two_merges: FullPlan) -> Timeline:
    return make_timeline(two_merges, 20.0, 20.0)


def test_plan_file_gives_all_poses(two_merges: FullPlan) -> None:
    text = plan_file.encode(two_merges)
    assert text == plan_file.encode(two_merges)
    told = json.loads(text)
    assert (told["format"], told["version"], told["setting"]) == ("roboassembly.plan", 3, "full")
    assert told["density"] == two_merges.initial.cell.density
    where = [pose_from_seven(p) for p in told["initial"]]
    robots = [np.array(q) for q in told["robots"]]
    for step in told["steps"]:
        for segment in step["segments"]:
            path = [np.array(q) for q in segment["path"]]
            assert np.allclose(path[0], robots[segment["robot"]])
            start, end = world_from_tips(path[0]), world_from_tips(path[-1])
            for held in segment["payload"]:
                in_hand = pose_from_seven(held["pose"])
                assert np.allclose((start * in_hand).homogeneous, where[held["part"]].homogeneous, atol=1e-5)
                where[held["part"]] = end * in_hand
            robots[segment["robot"]] = path[-1]
            assert set(segment["posts"]) <= set(range(len(told["posts"])))
        for got, wanted in zip(where, step["after"], strict=True):
            assert np.allclose(got.homogeneous, pose_from_seven(wanted).homogeneous, atol=1e-5)
    assert len(told["steps"]) == len(two_merges.steps)


def test_parts_between_steps_hang_above_a_post(two_merges: FullPlan) -> None:
    parts = two_merges.furniture.parts
    for step in two_merges.steps:
        for standing in step.segments[-1].after.placed:
            points = np.concatenate(
                [
                    parts[p].mesh.vertices @ pose.rotation.T + pose.translation
                    for p, pose in zip(standing.group.parts, standing.group.part_poses(), strict=True)
                ]
            )
            assert points[:, 2].min() == pytest.approx(LOWEST, abs=1e-6)
            above = points[np.linalg.norm(points[:, :2] - standing.post.top[:2], axis=1) < 0.3]
            assert len(above)


def test_frames_show_the_plan(two_merges: FullPlan, timeline: Timeline) -> None:
    n, own = len(two_merges.furniture.parts), len(visual_links())
    assert len(timeline.objects) == n + 2 * own + len(two_merges.posts)
    first, last = timeline.frames[0], timeline.frames[-1]
    for frame, state in ((first, two_merges.initial.cell_state), (last, two_merges.steps[-1].segments[-1].after)):
        assert all(len(things) == len(timeline.objects) for things in (frame.poses, frame.roles))
        where = {p: q for g in state.groups() for p, q in zip(g.parts, g.part_poses(), strict=True)}
        for p in range(n):
            assert _same(frame.poses[p], where[p])
        for robot in (0, 1):
            for i, pose in enumerate(visual_poses(state.robots[robot].at, state.robots[robot].opening)):
                assert _same(frame.poses[n + robot * own + i], pose)
        up = {id(s) for s in state.posts}
        assert [pose is not None for pose in frame.poses[n + 2 * own :]] == [id(s) in up for s in two_merges.posts]
    assert first.caption == "stool-0: 9 parts, two robots"
    assert "R_a: mate" in " ".join(f.caption for f in timeline.frames)


@pytest.mark.parametrize(("fps", "seconds"), [(24.0, None), (30.0, 4.0), (10.0, 3.3)])
def test_steps_take_their_time_and_mates_are_slow(two_merges: FullPlan, fps: float, seconds: float | None) -> None:
    frames = make_timeline(two_merges, fps, seconds).frames
    for step in range(len(two_merges.steps)):
        own = [frame for frame in frames if frame.step == step]
        assert len(own) == round((seconds or 5.0) * fps)
        shown = {
            name: sum(f.caption.endswith(f"| {name}") for f in own) for name in {f.caption.split("| ")[1] for f in own}
        }
        assert set(shown) == {segment.name for segment in two_merges.steps[step].segments}
        assert shown["R_a: mate"] >= 0.1 * len(own)
        assert shown["R_a: mate"] >= 2 * shown["R_a: lift"]


def test_nothing_jumps_from_frame_to_frame(timeline: Timeline) -> None:
    """How fast segments are shown depends on how long they are; what jumps goes farther than just before and after."""
    framed = [i for i, thing in enumerate(timeline.objects) if thing.framed]
    places = np.array([[_there(frame.poses[i]).translation for i in framed] for frame in timeline.frames])
    moved = np.linalg.norm(np.diff(places, axis=0), axis=2)
    still = np.zeros_like(moved[:1])
    beside = np.maximum(np.concatenate([still, moved[:-1]]), np.concatenate([moved[1:], still]))
    # Fingers open and close from one segment to the next.
    assert (moved - 2.0 * beside).max() < 0.02


def test_only_one_robot_moves_at_a_time(two_merges: FullPlan, timeline: Timeline) -> None:
    n, own = len(two_merges.furniture.parts), len(visual_links())
    for a, b in pairwise(timeline.frames):
        if a.step is None or b.step is None or a.caption != b.caption:
            continue
        still = [
            all(a.poses[n + robot * own + i] is b.poses[n + robot * own + i] for i in range(own)) for robot in (0, 1)
        ]
        assert any(still)


def test_pictures_are_of_mates(two_merges: FullPlan, timeline: Timeline) -> None:
    shown = [timeline.frames[i] for i in key_frames(timeline)]
    assert len(shown) == len(two_merges.steps) + 2
    for frame, step in zip(shown[1:-1], two_merges.steps, strict=True):
        assert frame.caption.endswith("R_a: mate")
        u, v = step.action[:2]
        assert frame.roles[u] is Role.MOVING
        assert frame.roles[v] is Role.WAITING


def _same(a: SE3 | None, b: SE3) -> bool:
    return a is not None and np.allclose(a.homogeneous, b.homogeneous, atol=1e-9)


def _there(pose: SE3 | None) -> SE3:
    assert pose is not None
    return pose
