from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.colors import Role, part_colors
from roboassembly.viewer.recording import RecordedScene
from roboassembly.viewer.server import quiet_server
from roboassembly.viewer.timeline import Frame, Phase, SceneObject, Timeline
from roboassembly.viewer.viser_scene import ViserScene

ROTATION = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
EYE = np.eye(3)


def at(x: float, rotation: np.ndarray = EYE) -> SE3:
    return SE3(rotation, np.array([x, 0.0, 0.0]))


BOXES = tuple(
    SceneObject(f"box{k}", Mesh.from_trimesh(trimesh.creation.box((0.2, 0.4, 0.6))), framed=k < 2) for k in range(3)
)
START = at(1.0)
MOTIONS = (
    (at(0.0), START, None),
    (at(0.5), START, at(2.0)),
    (at(0.5, ROTATION), at(1.0 + 1e-9), None),  # a step that viser drops
    (at(0.7, ROTATION), at(1.2), at(2.0)),
    (at(0.7, ROTATION), at(1.2), at(3.0)),
)


def timeline() -> Timeline:
    roles = (Role.IDLE, Role.WAITING, Role.MOVING)
    frames = [Frame(poses, roles[k % 2 :] + roles[: k % 2], None, Phase.MOVING, "") for k, poses in enumerate(MOTIONS)]
    return Timeline("boxes", BOXES, tuple(frames), 10.0)


def recorded(shown: type[ViserScene]) -> bytes:
    with quiet_server("127.0.0.1", 0) as server:
        scene = shown(server.scene)
        scene.add(BOXES, MOTIONS[0], part_colors([Role.IDLE] * 3))
        recording = server.get_scene_serializer()
        if isinstance(scene, RecordedScene):
            scene.record(recording)
        for frame in timeline().frames:
            scene.show(frame.poses, part_colors(frame.roles))
            recording.insert_sleep(0.1)
        return recording.serialize()


def test_the_recording_is_what_viser_itself_would_record():
    assert recorded(RecordedScene) == recorded(ViserScene)


def test_the_extent_spans_every_framed_box_at_every_pose():
    film = timeline()
    everywhere = film.box_corners.reshape(-1, 3)
    assert len(film.extent) < len(everywhere)
    assert {tuple(p) for p in film.extent.round(12)} == {tuple(p) for p in everywhere.round(12)}
    # By hand: box 0 spans 0.2 m along x at 0, box 1 stands at 1.2 m; box 2 at 3 m is not framed.
    assert film.extent[:, 0].min() == pytest.approx(-0.1)
    assert film.extent[:, 0].max() == pytest.approx(1.3)
