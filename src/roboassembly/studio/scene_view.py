"""Scene of one client: the frames of the session so far, overlays on the parts, and the path of the moving group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from viser import ClientHandle, LineSegmentsHandle

from roboassembly.rendering.camera import FIELD_OF_VIEW, box_corners, fit_camera, view_axes
from roboassembly.rendering.colors import MOVING, WAITING, Color, distinct_colors, part_colors, to_bytes
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.overlays import ChosenPoints, Overlays
from roboassembly.studio.picking import PickedItem, Picker, VisibleItems
from roboassembly.viewer.playback import make_animator
from roboassembly.viewer.timeline import Frame
from roboassembly.viewer.viser_scene import ViserScene, set_up_scene

FRAMES_PER_SECOND = 24.0
BY_ROLE, BY_SHAPE, BY_GROUP = COLORS = ("role", "equal parts", "groups")
"""Meanings of the colours."""
_NARROW = 700
"""Width of a window [pixels] up to which the panel lies below the scene, not beside it."""
_BESIDE_PANEL = 0.72
"""Share of the window's width that a panel beside the scene leaves. The browser reports its size without the panel."""
_ABOVE_PANEL = 0.15
"""Distance by which the camera looks lower if the panel lies below the scene, over its distance from the target."""


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
    """

    def __init__(self, client: ClientHandle, session: AssemblySession) -> None:
        self._client, self._session = client, session
        self.options = ViewOptions()
        self.index = 0
        """Index of the frame that is shown."""
        self.is_playing = False
        animator = make_animator(session.plan(), FRAMES_PER_SECOND)
        self._frames = [animator.opening()]
        self._step_ends: list[int] = []
        """Index of the last frame of each step."""
        self._has_upright = False
        """Whether the frames include the motion that sets the finished piece upright."""
        self._chosen: ChosenPoints = (None, None)
        self._path: tuple[int, LineSegmentsHandle] | None = None
        """Step whose path is drawn, and the lines."""
        objects, poses = animator.objects, self._frames[0].poses
        framed = [(o.mesh, p) for o, p in zip(objects, poses, strict=True) if o.framed and p is not None]
        points = np.concatenate([box_corners(mesh, pose) for mesh, pose in framed])
        set_up_scene(client.scene, points)
        self._scene = ViserScene(client.scene)
        self._scene.add(objects, poses, self._colors(self._frames[0]))
        names = [item.name for item in objects[: len(session.furniture.parts)]]
        self.overlays = Overlays(client.scene, session.furniture, names)
        self._meshes = [item.mesh for item in objects]
        self._picker = Picker()
        self._visible = VisibleItems(poses, self.overlays.centers, self.overlays.radii)
        self._aim_camera(points)

    @property
    def last(self) -> int:
        """Index of the last frame, which shows the current state."""
        return len(self._frames) - 1

    def clear(self) -> None:
        """Remove everything from the scene."""
        self._remove_path()
        self.overlays.clear()
        self._scene.clear()

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
        self.show(self.index)

    def choose(self, chosen: ChosenPoints) -> None:
        """Highlight the chosen points."""
        self._chosen = chosen
        self.show(self.index)

    def show(self, index: int) -> None:
        """Show a frame; overlays are shown on the last frame only, which is the current state."""
        self.index = min(max(index, 0), self.last)
        frame = self._frames[self.index]
        self._scene.show(frame.poses, self._colors(frame))
        show_points = self.options.points and self.index == self.last
        self.overlays.show(self._session.free_points() & show_points, self._chosen)
        self._visible = VisibleItems(frame.poses, self.overlays.centers, self.overlays.radii)
        self._draw_path(frame.step if self.options.path else None)

    def item_under(self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> PickedItem | None:
        """Return the part or connection point that a ray of the camera meets first; None if it meets none."""
        return self._picker.first(self._visible, self._meshes, origin, direction)

    def _aim_camera(self, points: Float[np.ndarray, "n 3"]) -> None:
        camera = self._client.camera
        wide = camera.image_width > _NARROW
        fitted = fit_camera(points, max(0.3, float(camera.aspect) * (_BESIDE_PANEL if wide else 1.0)))
        up = view_axes(fitted.azimuth, fitted.elevation)[1]
        shift = np.zeros(3) if wide else -_ABOVE_PANEL * fitted.distance * up
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.fov = FIELD_OF_VIEW
        camera.position = fitted.position + shift
        camera.look_at = fitted.target + shift  # after the position, which would move it too

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
            handle = self._client.scene.add_line_segments(
                "/path", lines, to_bytes(MOVING), thickness=2.0, thickness_units="screen"
            )
            self._path = step, handle

    def _remove_path(self) -> None:
        if self._path is not None:
            self._path[1].remove()
            self._path = None
