"""One self-contained page that plays a plan: a time slider, a scene to turn with mouse or fingers, no server."""

from __future__ import annotations

import html
import json
from pathlib import Path
from string import Template

from roboassembly.rendering.camera import FIELD_OF_VIEW, fit
from roboassembly.rendering.colors import part_colors
from roboassembly.viewer.files import replaced
from roboassembly.viewer.page import BODY, HEAD
from roboassembly.viewer.playing import AnyPlan, timeline_of
from roboassembly.viewer.server import quiet_server
from roboassembly.viewer.tableau import Tableau, set_the_scene
from roboassembly.viewer.timeline import Timeline

FRAMES_PER_SECOND = 30.0
SLOWER = 1.6
"""Than a film: who has a slider looks more closely."""
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
    points = timeline.box_corners.reshape(-1, 3)
    with quiet_server("127.0.0.1", 0) as server:
        set_the_scene(server.scene, points)
        view = fit(points, 1.0)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.initial_camera.look_at = view.target
        server.initial_camera.position = view.position
        tableau = Tableau(server.scene)
        tableau.add(timeline.things, first.poses, part_colors(first.roles))
        recording = server.get_scene_serializer()
        for frame in timeline.frames:
            tableau.show(frame.poses, part_colors(frame.roles))
            recording.insert_sleep(1.0 / timeline.frames_per_second)
        return recording.as_html()


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
