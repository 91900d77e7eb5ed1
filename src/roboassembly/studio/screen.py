"""What one visitor sees: the frames of the session so far, marks on the parts, and the way of what moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from viser import ClientHandle, LineSegmentsHandle

from roboassembly.rendering.camera import FIELD_OF_VIEW, box_corners, fit_camera, view_axes
from roboassembly.rendering.colors import MOVING, WAITING, Color, distinct_colors, part_colors, to_bytes
from roboassembly.robots.body import tip_positions
from roboassembly.studio.marks import Chosen, Marks
from roboassembly.studio.picking import Picked, Picker, Shown
from roboassembly.studio.session import Session
from roboassembly.task.plans.full_plan import FullStep
from roboassembly.task.plans.plan import PlanStep
from roboassembly.viewer.playback import make_animator
from roboassembly.viewer.timeline import Frame
from roboassembly.viewer.viser_scene import ViserScene, set_up_scene

FRAMES_PER_SECOND = 24.0
ROLES, KINDS, GROUPS = COLORS = ("what it does", "equal parts", "groups")
"""What colours tell."""
_NARROW, _BESIDE_PANEL, _ABOVE_PANEL = 700, 0.72, 0.15
"""Pixels from which on the panel lies beside the scene, and the share of the width that the scene then keeps (what the
browser tells is before the panel is there); on narrower screens it lies below, and the camera looks so much lower, in
shares of its distance."""


@dataclass(frozen=True)
class Look:
    """What is to be seen besides parts."""

    color: str = ROLES
    points: bool = True
    frames: bool = False
    grasps: bool = False
    way: bool = True


class Screen:
    """The scene of one client.

    Args:
        client: the browser.
        session: what it shows.
    """

    def __init__(self, client: ClientHandle, session: Session) -> None:
        self._client, self._session = client, session
        self.look = Look()
        self.at = 0
        """Number of the frame that is shown."""
        self.playing = False
        director = make_animator(session.plan(), FRAMES_PER_SECOND)
        self._frames = [director.opening()]
        self._ends: list[int] = []
        """Number of the frame in which each step ends."""
        self._stands = False
        """Whether the frames go on to where the finished piece stands on its feet."""
        self._chosen: Chosen = (None, None)
        self._way: tuple[int, LineSegmentsHandle] | None = None
        """Of a step."""
        things, poses = director.objects, self._frames[0].poses
        framed = [(t.mesh, p) for t, p in zip(things, poses, strict=True) if t.framed and p is not None]
        points = np.concatenate([box_corners(mesh, pose) for mesh, pose in framed])
        set_up_scene(client.scene, points)
        self._tableau = ViserScene(client.scene)
        self._tableau.add(things, poses, self._colors(self._frames[0]))
        parts = len(session.furniture.parts)
        names = [thing.name for thing in things[:parts]]
        self._marks = Marks(client.scene, session.furniture, names)
        self._meshes = [thing.mesh for thing in things]
        self._picker = Picker()
        self._seen = Shown(poses, self._marks.centers, self._marks.radii)
        self._aim(points)

    @property
    def last(self) -> int:
        """Number of the last frame: how things stand."""
        return len(self._frames) - 1

    def clear(self) -> None:
        """Take all away."""
        self._drop_way()
        self._marks.clear()
        self._tableau.clear()

    def extend(self) -> None:
        """Frames of the session's steps that have none yet, played from where they begin."""
        plan = self._session.plan()
        director = make_animator(plan, FRAMES_PER_SECOND)
        begin = self.last
        for step in range(len(self._ends), len(plan.steps)):
            self._frames += director.step(step)
            self._ends.append(self.last)
        if plan.upright is not None and not self._stands:
            self._frames += director.upright()
            self._stands = True
        new = slice(len(self._tableau.meshes), None)
        frame = self._frames[-1]
        self._tableau.add(director.objects[new], frame.poses[new], part_colors(frame.roles[new]))
        self._meshes = [thing.mesh for thing in director.objects]
        self.playing = True
        self.show(begin)

    def shorten(self) -> None:
        """Forget the frames of steps that were taken back, and of the motion after the last of all."""
        del self._ends[self._session.merges :]
        self._stands = False
        del self._frames[(self._ends[-1] if self._ends else 0) + 1 :]
        self.playing = False
        self.show(self.last)

    def refresh(self) -> None:
        """Marks as the session and the look are now."""
        session = self._session
        grasps = [part.grasps for part in session.held.parts] if self.look.grasps else []
        self._marks.lay(session.points(), session.free(), self.look.frames, grasps)
        self.show(self.at)

    def choose(self, chosen: Chosen) -> None:
        """Show what is chosen to be joined."""
        self._chosen = chosen
        self.show(self.at)

    def show(self, index: int) -> None:
        """Show a frame; marks only on the last, which is how things stand."""
        self.at = min(max(index, 0), self.last)
        frame = self._frames[self.at]
        self._tableau.show(frame.poses, self._colors(frame))
        self._marks.show(self._session.free() & (self.look.points and self.at == self.last), self._chosen)
        self._seen = Shown(frame.poses, self._marks.centers, self._marks.radii)
        self._draw_way(frame.step if self.look.way else None)

    def under(self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Picked | None:
        """The part or connection point that a ray of the camera meets first; None if it meets none."""
        return self._picker.first(self._seen, self._meshes, origin, direction)

    def _aim(self, points: np.ndarray) -> None:
        camera = self._client.camera
        wide = camera.image_width > _NARROW
        view = fit_camera(points, max(0.3, float(camera.aspect) * (_BESIDE_PANEL if wide else 1.0)))
        lower = np.zeros(3) if wide else -_ABOVE_PANEL * view.distance * view_axes(view.azimuth, view.elevation)[1]
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.fov = FIELD_OF_VIEW
        camera.position = view.position + lower
        camera.look_at = view.target + lower  # last: a new position would carry it along

    def _colors(self, frame: Frame) -> list[Color]:
        session, colors = self._session, part_colors(frame.roles)
        if self.look.color != ROLES:
            groups = session.joined.group_of
            kinds = session.furniture.class_of if self.look.color == KINDS else [groups[p] for p in range(len(groups))]
            return [*distinct_colors(kinds), *colors[len(kinds) :]]
        if self.at == self.last:
            for end, color in zip(self._chosen, (MOVING, WAITING), strict=True):
                if end is not None:
                    colors[end[0]] = color
        return colors

    def _draw_way(self, step: int | None) -> None:
        if self._way is not None and self._way[0] == step:
            return
        self._drop_way()
        if step is None:
            return
        points = _way_of(self._session.plan().steps[step])
        if len(points) > 1:
            lines = np.stack([points[:-1], points[1:]], axis=1)
            handle = self._client.scene.add_line_segments(
                "/way", lines, to_bytes(MOVING), thickness=2.0, thickness_units="screen"
            )
            self._way = step, handle

    def _drop_way(self) -> None:
        if self._way is not None:
            self._way[1].remove()
            self._way = None


def _way_of(step: PlanStep | FullStep) -> Float32[np.ndarray, "n 3"]:
    """World way-points of the moving group's centre of mass, or of R_a's finger tips."""
    if isinstance(step, PlanStep):
        return np.array([pose.translation for pose in step.path], np.float32)
    return np.concatenate(
        [tip_positions(np.array(segment.path)) for segment in step.segments if segment.robot == 0]
    ).astype(np.float32)
