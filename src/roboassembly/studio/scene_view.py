"""Scene of one client: the frames of the session so far, overlays on the parts, and the path of the moving group."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from viser import ClientHandle, LabelHandle, LineSegmentsHandle

from roboassembly.furniture.model import GraspRegion
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import transform_points
from roboassembly.rendering.camera import box_corners
from roboassembly.rendering.colors import MOVING, WAITING, Color, distinct_colors, part_colors, to_bytes, wood_colors
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.camera_aim import CameraAim
from roboassembly.studio.overlays import ChosenPoints, Overlays, PointId
from roboassembly.studio.picking import PickedItem, Picker, VisibleItems
from roboassembly.studio.turntable import SECONDS_PER_TURN, Turntable
from roboassembly.viewer.playback import make_animator
from roboassembly.viewer.timeline import Frame
from roboassembly.viewer.viser_scene import ViserScene, set_up_scene

FRAMES_PER_SECOND = 24.0
_FINGERS = 2.2
"""Factor on the size of connection points on a telephone."""
_SLOW_INTERVAL = 1.5
"""Time between two frames of the turntable in a browser that draws slowly [s]."""
_SLANTED, _STEEP = np.radians(-34.0).item(), np.radians(-52.0).item()
"""Elevations of the camera above parts on the floor [rad]: beside the panel, and above it."""
BY_ROLE, BY_SHAPE, BY_GROUP = COLORS = ("role", "equal parts", "groups")
"""Meanings of the colours."""
_LONGEST_TURNING = 20.0 * SECONDS_PER_TURN
"""Time after which the turntable stops by itself [s]; a page that nobody looks at needs no frames."""


@dataclass(frozen=True)
class ViewOptions:
    """Switches of what the scene shows besides the parts."""

    color: str = BY_ROLE
    points: bool = True
    frames: bool = False
    grasps: bool = False
    path: bool = True


class SceneView:
    """Scene of one client.

    Args:
        client: browser that shows the scene.
        session: session to show.
        aim: camera of the browser.
    """

    def __init__(self, client: ClientHandle, session: AssemblySession, aim: CameraAim) -> None:
        self._client, self._session, self._aim = client, session, aim
        self.options = ViewOptions()
        self.index = 0
        """Index of the frame that is shown."""
        self.is_playing = False
        self.is_turning = False
        self._turntable: Turntable | None = None
        """Finished piece of the opening view; None once the session is shown."""
        self._turned = 0.0
        """Time for which the turntable has turned [s]."""
        self._due = 0.0
        """The same at its next frame [s]."""
        self.is_slow = False
        """Whether the browser draws slowly; the turntable then shows few frames."""
        animator = make_animator(session.plan(), FRAMES_PER_SECOND)
        self._frames = [animator.opening()]
        self._step_ends: list[int] = []
        """Index of the last frame of each step."""
        self._has_upright = False
        """Whether the frames include the motion that sets the finished piece upright."""
        self._chosen: ChosenPoints = (None, None)
        self._path: tuple[int, LineSegmentsHandle] | None = None
        """Step whose path is drawn, and the lines."""
        self._paths = 0
        """Number of paths drawn so far."""
        objects, poses = animator.objects, self._frames[0].poses
        framed = [(o.mesh, p) for o, p in zip(objects, poses, strict=True) if o.framed and p is not None]
        self._extent = np.concatenate([box_corners(mesh, pose) for mesh, pose in framed])
        set_up_scene(client.scene, self._extent)
        self._scene = ViserScene(client.scene)
        self._scene.add(objects, poses, self._colors(self._frames[0]))
        names = [item.name for item in objects[: len(session.furniture.parts)]]
        self.overlays = Overlays(client.scene, session.furniture, names, _FINGERS if aim.is_narrow else 1.0)
        self._meshes = [item.mesh for item in objects]
        self._picker = Picker()
        self.visible = VisibleItems(poses, self.overlays.centers, self.overlays.radii)
        """Visible items of the scene, for picking."""
        self._failure: LabelHandle | None = None
        self._aim_at_parts()

    @property
    def is_opening(self) -> bool:
        """Whether the finished piece is shown, not the state of the session."""
        return self._turntable is not None

    @property
    def is_moving(self) -> bool:
        """Whether the next frame is due without any request."""
        return self.is_playing or self.is_turning

    @property
    def step(self) -> int:
        """Number of the step whose frames are shown; 0 before the first one."""
        return min(bisect.bisect_left(self._step_ends, self.index) + 1, len(self._step_ends)) if self.index else 0

    @property
    def frames_of_steps(self) -> list[list[Frame]]:
        """Frames before the first step, and those of each step."""
        ends = [0, *self._step_ends]
        return [self._frames[:1], *(self._frames[a + 1 : b + 1] for a, b in itertools.pairwise(ends))]

    def end_of_step(self, number: int) -> int:
        """Return the index of the last frame of a step: the first frame for 0, the last of all beyond the last step."""
        ends = [0, *self._step_ends]
        return ends[number] if number < len(ends) - 1 else self.last

    @property
    def meshes(self) -> list[Mesh]:
        """Meshes in the order of `Frame.poses`."""
        return self._meshes

    @property
    def last(self) -> int:
        """Index of the last frame, which shows the current state."""
        return len(self._frames) - 1

    def clear(self) -> None:
        """Remove everything from the scene."""
        self._remove_path()
        self.clear_failure()
        self.overlays.clear()
        self._scene.clear()

    def open_finished(self) -> None:
        """Show the finished piece, turning."""
        self._turntable = Turntable(self._session.furniture)
        self.is_turning, self._turned, self._due = True, 0.0, 0.0
        self._aim.at(self._turntable.extent)
        self._show_turntable()

    def leave_opening(self) -> None:
        """Show the state of the session in place of the finished piece."""
        if self._turntable is not None:
            self._turntable, self.is_turning = None, False
            self._aim_at_parts()
            self.show(self.index)

    def _aim_at_parts(self) -> None:
        # From higher up, parts that lie on the floor fill more of a tall picture.
        self._aim.at(self._extent, _STEEP if self._aim.is_narrow else _SLANTED)

    def turn(self, seconds: float) -> None:
        """Turn the finished piece on.

        Args:
            seconds: time since the last frame [s].
        """
        self._turned += seconds
        self.is_turning = self._turned < _LONGEST_TURNING
        if self._turned >= self._due:
            self._due = self._turned + (_SLOW_INTERVAL if self.is_slow else 0.0)
            self._show_turntable()

    def _show_turntable(self) -> None:
        table = self._turntable
        if table is None:
            return
        poses = table.poses(2.0 * np.pi * self._turned / SECONDS_PER_TURN)
        self._scene.show(poses, wood_colors(len(poses)))
        self.overlays.show(np.zeros(self.overlays.centers.shape[:2], bool), (None, None))
        self.visible = VisibleItems(poses, self.overlays.centers, self.overlays.radii)
        self._draw_path(None)

    def append_new_steps(self) -> None:
        """Append the frames of the session's new steps, and play them."""
        plan = self._session.plan()
        animator = make_animator(plan, FRAMES_PER_SECOND)
        begin = self.last
        for step in range(len(self._step_ends), len(plan.steps)):
            self._frames += animator.step(step)
            self._step_ends.append(self.last)
        if plan.upright is not None and not self._has_upright:
            self._frames += animator.upright()
            self._has_upright = True
        new = slice(len(self._scene.meshes), None)
        frame = self._frames[-1]
        self._scene.add(animator.objects[new], frame.poses[new], part_colors(frame.roles[new]))
        self._meshes = [item.mesh for item in animator.objects]
        self.is_playing = True
        self.show(begin)

    def drop_undone_steps(self) -> None:
        """Remove the frames of undone steps, and of the motion that set the piece upright."""
        del self._step_ends[self._session.merges :]
        self._has_upright = False
        del self._frames[(self._step_ends[-1] if self._step_ends else 0) + 1 :]
        self.is_playing = False
        self.show(self.last)

    def refresh(self) -> None:
        """Redraw the overlays for the current session and view options."""
        session = self._session
        grasps = [part.grasps for part in session.furniture_with_grasps.parts] if self.options.grasps else []
        self.overlays.draw(session.points(), session.free_points(), self.options.frames, grasps)
        self._redraw()

    def choose(
        self,
        chosen: ChosenPoints,
        up: tuple[int, Float[np.ndarray, "3"]] | None = None,
        grasps: Sequence[tuple[int, GraspRegion, int]] = (),
    ) -> None:
        """Highlight the chosen points, and show the rest of the action.

        Args:
            chosen: chosen points.
            up: part that waits, and the direction in its frame that points up meanwhile; None to show none.
            grasps: part, grasp region and index of the approach of each hand.
        """
        self._chosen = chosen
        self.overlays.clear_choices()
        if up is not None and not self.is_opening:
            self.overlays.show_up_axis(*up)
        for grasp in () if self.is_opening else grasps:
            self.overlays.show_grasp(*grasp)
        self._redraw()

    def _redraw(self) -> None:
        if self.is_opening:
            self._show_turntable()
        else:
            self.show(self.index)

    def mark_failure(self, point: PointId, text: str) -> None:
        """Write the reason of a failure at the connection point of the part that waits."""
        part, number = point
        pose = self._frames[-1].poses[part]
        self.clear_failure()
        if pose is not None:
            place = transform_points(pose, self.overlays.centers[part][number][None])[0]
            self._failure = self._client.scene.add_label(
                "/failure", f"✗ {text}", position=place, anchor="bottom-center", font_screen_scale=1.3
            )

    def clear_failure(self) -> None:
        """Remove the reason of a failure from the scene."""
        if self._failure is not None:
            self._failure.remove()
            self._failure = None

    def show(self, index: int) -> None:
        """Show a frame; overlays are shown on the last frame only, which is the current state."""
        self.index = min(max(index, 0), self.last)
        frame = self._frames[self.index]
        self._scene.show(frame.poses, self._colors(frame))
        show_points = self.options.points and self.index == self.last
        self.overlays.show(self._session.free_points() & show_points, self._chosen)
        self.visible = VisibleItems(frame.poses, self.overlays.centers, self.overlays.radii)
        self._draw_path(frame.step if self.options.path else None)

    def item_under(self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> PickedItem | None:
        """Return the part or connection point that a ray of the camera meets first; None if it meets none."""
        return self._picker.first(self.visible, self._meshes, origin, direction)

    def _colors(self, frame: Frame) -> list[Color]:
        session, colors = self._session, part_colors(frame.roles)
        if self.options.color != BY_ROLE:
            groups, by_shape = session.task_state.group_of, self.options.color == BY_SHAPE
            labels = session.furniture.class_of if by_shape else [groups[p] for p in range(len(groups))]
            return [*distinct_colors(labels), *colors[len(labels) :]]
        if self.index == self.last:
            for chosen, color in zip(self._chosen, (MOVING, WAITING), strict=True):
                if chosen is not None:
                    colors[chosen[0]] = color
        return colors

    def _draw_path(self, step: int | None) -> None:
        if self._path is not None and self._path[0] == step:
            return
        self._remove_path()
        if step is None:
            return
        points = make_animator(self._session.plan(), FRAMES_PER_SECOND).path_points(step)
        if len(points) > 1:
            lines = np.stack([points[:-1], points[1:]], axis=1)
            # A page that is told to remove lines and to add others of the same name can keep the first ones.
            self._paths += 1
            handle = self._client.scene.add_line_segments(
                f"/path/{self._paths}", lines, to_bytes(MOVING), thickness=2.0, thickness_units="screen"
            )
            self._path = step, handle

    def _remove_path(self) -> None:
        if self._path is not None:
            self._path[1].remove()
            self._path = None
