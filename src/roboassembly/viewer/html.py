"""One self-contained page that plays a plan: a time slider, a scene to turn with mouse or fingers, no server."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from string import Template

import numpy as np
import rich
from viser import ViserServer

from roboassembly.poses import SE3, pose_to_seven
from roboassembly.viewer.colors import FLOOR_LINES, Color, part_colors, to_bytes
from roboassembly.viewer.files import replaced
from roboassembly.viewer.framing import FIELD_OF_VIEW, fit
from roboassembly.viewer.page import BODY, HEAD
from roboassembly.viewer.playing import AnyPlan, timeline_of
from roboassembly.viewer.shading import shade
from roboassembly.viewer.timeline import Timeline

FRAMES_PER_SECOND = 30.0
SLOWER = 1.6
"""Than a film: who has a slider looks more closely."""
EXPOSURE = 0.76
ASPECTS = (0.45, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0)
"""Width over height of the windows that a first view is computed for; a window takes the next narrower one."""


def write_html(plan: AnyPlan, path: Path, *, seconds_per_step: float | None = None) -> None:
    """Write a page that plays the plan in any browser, from a file, without a network.

    Args:
        plan: What to show; one that failed is shown as far as it got.
        path: The file; one that is there is replaced, once the new one is whole.
        seconds_per_step: About how long each step lasts; as long as suits the setting if not given.
    """
    timeline = timeline_of(plan, FRAMES_PER_SECOND, seconds_per_step, slower=SLOWER)
    page = _dressed(_recorded(timeline), timeline)
    with replaced(Path(path)) as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def _recorded(timeline: Timeline) -> str:
    """The page as viser makes it."""
    first = timeline.frames[0]
    colors = part_colors(first.roles)
    with _server() as server:
        scene = server.scene
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        scene.configure_default_lights(enabled=True, cast_shadow=True)
        _add_floor(server, timeline)
        view = fit(timeline.box_corners.reshape(-1, 3), 1.0)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.initial_camera.look_at = view.target
        server.initial_camera.position = view.position
        handles = []
        for index, thing in enumerate(timeline.things):
            shaded = shade(thing.mesh)
            seven = _rounded(first.poses[index] or SE3.Identity())
            handles.append(
                scene.add_mesh_simple(
                    f"/{thing.name}",
                    shaded.vertices.astype(np.float32),
                    shaded.faces.astype(np.uint32),
                    color=_lit(colors[index]),
                    side="front" if thing.mesh.is_solid else "double",
                    position=seven[:3],
                    wxyz=seven[3:],
                    visible=first.poses[index] is not None,
                )
            )
        recording = server.get_scene_serializer()
        shown = list(first.poses)
        for frame in timeline.frames:
            colors = part_colors(frame.roles)
            for index, handle in enumerate(handles):
                handle.color = _lit(colors[index])  # recorded only where it changes
                pose = frame.poses[index]
                if pose is not shown[index]:
                    if (pose is None) != (shown[index] is None):
                        handle.visible = pose is not None
                    if pose is not None:
                        seven = _rounded(pose)
                        handle.position, handle.wxyz = seven[:3], seven[3:]
                    shown[index] = pose
            recording.insert_sleep(1.0 / timeline.frames_per_second)
        return recording.as_html()


def _lit(color: Color) -> tuple[int, int, int]:
    """The colour, darker: viser's own lights are strong, and what faces up would come out white."""
    r, g, b = (EXPOSURE * c for c in color)
    return to_bytes((r, g, b))


def _rounded(pose: SE3) -> np.ndarray:
    """`x, y, z, qw, qx, qy, qz` as 32-bit floats hold them: the recording then packs into half the size."""
    return np.asarray(pose_to_seven(pose), dtype=np.float32).astype(float)


def _add_floor(server: ViserServer, timeline: Timeline) -> None:
    corners = timeline.box_corners.reshape(-1, 3)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    reach = float((high - low).max())
    middle = np.round(low + high) / 2.0
    server.scene.add_grid(
        "/floor",
        infinite_grid=True,
        cell_size=0.25,
        cell_color=(228, 231, 235),
        section_size=1.0,
        section_color=to_bytes(FLOOR_LINES),
        shadow_opacity=0.3,
        fade_distance=8.0 * reach + 4.0,
        position=(float(middle[0]), float(middle[1]), 0.0),
    )


@contextmanager
def _server() -> Iterator[ViserServer]:
    """A viser server that nobody is told of and that is gone afterwards.

    viser records only through a server. This one listens on a free port of this machine's own address, and stops.
    It announces itself through rich's console, from two threads, whatever `verbose` says; so that console is kept
    quiet meanwhile.
    """
    console = rich.get_console()
    was_quiet, console.quiet = console.quiet, True
    try:
        server = ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = was_quiet


def _dressed(page: str, timeline: Timeline) -> str:
    """Add to viser's page a title, captions, a first view for this window's shape, and a slider for thumbs."""
    name = html.escape(timeline.name)
    points = timeline.box_corners.reshape(-1, 3)
    views = [[aspect, *map(float, fit(points, aspect).position)] for aspect in ASPECTS]
    captions = [[round(time, 4), caption] for time, caption in timeline.captions]
    head, body = (
        Template(text).substitute(
            name=name,
            captions=_script_json(captions),
            views=_script_json([[round(x, 4) for x in view] for view in views]),
            target=_script_json([round(float(x), 4) for x in fit(points, 1.0).target]),
        )
        for text in (HEAD, BODY)
    )
    page = page.replace("<title>Viser</title>", f"<title>{name}</title>", 1)
    page = page.replace('content="Viser client"', f'content="How to assemble {name}"', 1)
    at = page.index("<meta charset")
    page = page[:at] + head + page[at:]
    at = page.rindex("</body>")
    return page[:at] + body + page[at:]


def _script_json(value: object) -> str:
    """JSON that cannot end the script element that it stands in."""
    return json.dumps(value).replace("<", "\\u003c")
