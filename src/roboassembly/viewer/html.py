"""Self-contained HTML page that plays a plan: a time slider and a 3D scene, without a server."""

from __future__ import annotations

import html
import json
from functools import cache
from pathlib import Path
from string import Template

from roboassembly.atomic_file import atomic_write
from roboassembly.rendering.camera import FIELD_OF_VIEW, fit_camera
from roboassembly.rendering.colors import part_colors
from roboassembly.viewer.html_template import BODY, HEAD
from roboassembly.viewer.playback import AnyPlan, make_timeline
from roboassembly.viewer.recording import RecordedScene
from roboassembly.viewer.server import quiet_server
from roboassembly.viewer.timeline import Timeline
from roboassembly.viewer.viser_scene import set_up_scene

FRAMES_PER_SECOND = 30.0
SLOWDOWN = 1.6
"""Duration of a step over its duration in a film."""
ASPECTS = (0.45, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0)
"""Widths over heights for which a first camera is computed; a window uses the nearest one that is not wider."""


def write_html(plan: AnyPlan, path: Path, *, seconds_per_step: float | None = None) -> None:
    """Write a page that plays the plan in any browser, from a file, without a network.

    Args:
        plan: plan to show. A failed plan is shown as far as it got.
        path: file to write. An existing file is replaced once the new one is complete.
        seconds_per_step: approximate duration of a step [s]; the default of the plan's setting if None.

    Raises:
        InputError: `seconds_per_step` is not a positive finite number.
    """
    timeline = make_timeline(plan, FRAMES_PER_SECOND, seconds_per_step, slowdown=SLOWDOWN)
    page = _with_captions(_record(timeline), timeline)
    with atomic_write(Path(path)) as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def _record(timeline: Timeline) -> str:
    """Return the page that viser writes for the timeline."""
    first = timeline.frames[0]
    points = timeline.extent
    with quiet_server("127.0.0.1", 0) as server:
        set_up_scene(server.scene, points)
        camera = fit_camera(points, 1.0)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.initial_camera.look_at = camera.target
        server.initial_camera.position = camera.position
        colors = cache(part_colors)
        scene = RecordedScene(server.scene)
        scene.add(timeline.objects, first.poses, colors(first.roles))
        recording = server.get_scene_serializer()
        scene.record(recording)
        with server.atomic():  # wakes nobody up for a message
            for frame in timeline.frames:
                scene.show(frame.poses, colors(frame.roles))
                recording.insert_sleep(1.0 / timeline.frames_per_second)
        return recording.as_html()


def _with_captions(page: str, timeline: Timeline) -> str:
    """Add a title, captions, a first camera for the shape of the window, and a larger slider to viser's page."""
    name = html.escape(timeline.name)
    points = timeline.extent
    cameras = [[aspect, *map(float, fit_camera(points, aspect).position)] for aspect in ASPECTS]
    captions = [[round(time, 4), caption] for time, caption in timeline.captions]
    head, body = (
        Template(text).substitute(
            name=name,
            captions=_script_json(captions),
            cameras=_script_json([[round(x, 4) for x in camera] for camera in cameras]),
            target=_script_json([round(float(x), 4) for x in fit_camera(points, 1.0).target]),
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
    """Return JSON that cannot close the script element around it."""
    return json.dumps(value).replace("<", "\\u003c")
