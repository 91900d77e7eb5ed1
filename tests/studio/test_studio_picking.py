"""Clicks choose what is under the pointer: rays are sent as a browser sends them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from viser import _messages

import shapes
from roboassembly.studio.client_session import ClientSession
from roboassembly.studio.panel import NONE, PICKS
from roboassembly.studio.picking import PickedItem, Picker, VisibleItems
from seeing import Sight, sight
from studio_client import Browser, begin_steps, merges, note_clients, served, until

pytestmark = pytest.mark.filterwarnings("ignore:Queued a")
EYES = np.array([[1.9, -2.1, 1.3], [-1.5, -1.2, 2.0], [0.3, 2.4, 0.5]])
"""Metres: where three cameras stand."""


CHOSEN = 12.0 / 7.0
"""Size of a chosen ball beside others."""


@pytest.fixture
def opened(monkeypatch) -> Iterator[tuple[Browser, ClientSession, Sight]]:
    clients = note_clients(monkeypatch)
    with served() as server:
        browser = Browser(server)
        until(lambda: len(clients) == 1)
        begin_steps(browser, clients[0])
        yield browser, clients[0], what_is_seen(clients[0])
        browser.connection.close()


@pytest.fixture
def answers(opened, monkeypatch) -> list[PickedItem | None]:
    """What each click on the scene met, in the order of the clicks."""
    found: list[PickedItem | None] = []
    editor = opened[1].editor
    item_under = editor.item_under

    def noted(event):
        found.append(item_under(event))
        return found[-1]

    monkeypatch.setattr(editor, "item_under", noted)
    return found


def what_is_seen(client: ClientSession) -> Sight:
    assert client.editor is not None
    session, overlays = client.editor.session, client.editor.view.overlays
    # A ball for each free point, and no other ball.
    free = session.free_points()[: len(session.furniture.parts)]
    np.testing.assert_array_equal(overlays.radii > 0.0, free)
    return sight(session.furniture, session.task_state.part_poses, overlays.centers, overlays.radii)


def click(
    browser: Browser, client: ClientSession, answers: list[PickedItem | None], eye: np.ndarray, target: np.ndarray
) -> tuple[str, str]:
    """Part and point in the panel after a click that chooses the moving part."""
    panel = client.panel
    panel.next.value = PICKS[0]
    panel.u.value = panel.k.value = NONE
    before = len(answers)
    browser.click(eye, target - eye)
    until(lambda: len(answers) > before)
    # The item is found; the thread of the session now chooses it.
    done = threading.Event()
    time.sleep(0.01)
    client.submit(done.set)
    assert done.wait(10)
    return panel.u.value, panel.k.value


@pytest.mark.slow
def test_each_visible_point_and_part_is_chosen_and_the_floor_is_not(opened, answers):
    browser, client, seen = opened
    assert client.session is not None
    names = [f"{i}: {part.name}" for i, part in enumerate(client.session.furniture.parts)]
    tried = {"points": 0, "parts": 0, "floor": 0}
    rng = np.random.default_rng(0)
    # The ball of the point chosen last is drawn larger, and may hide others until the next frame.
    larger = replace(seen, radii=CHOSEN * seen.radii)
    for eye in EYES:
        for ball in sorted({*seen.visible(eye)} & {*larger.visible(eye)}):
            part, point = seen.owners[ball]
            assert click(browser, client, answers, eye, seen.centers[ball]) == (names[part], str(point))
            tried["points"] += 1
        for part in range(len(names)):
            middle = seen.triangles[part].mean(axis=(0, 1))
            if seen.first(eye, (middle - eye) / np.linalg.norm(middle - eye)) == (part, None):
                assert click(browser, client, answers, eye, middle) == (names[part], NONE)
                tried["parts"] += 1
        for spot in rng.uniform(-0.8, 0.8, (8, 3)) * [1.0, 1.0, 0.0]:
            if seen.first(eye, (spot - eye) / np.linalg.norm(spot - eye)) is None:
                assert click(browser, client, answers, eye, spot) == (NONE, NONE)
                tried["floor"] += 1
    assert tried["points"] >= 30, tried
    assert tried["parts"] >= 15, tried
    assert tried["floor"] >= 12, tried


def test_first_click_picks_the_moving_part_second_the_waiting_one(opened):
    browser, client, seen = opened
    eye, panel = EYES[1], client.panel
    balls = seen.visible(eye)
    one = balls[0]
    other = next(b for b in balls if seen.owners[b][0] != seen.owners[one][0])
    for ball, point in ((one, panel.k), (other, panel.l)):
        browser.click(eye, seen.centers[ball] - eye)
        until(lambda point=point: point.value != NONE)
    ends = [
        (int(part.value.split(":")[0]), int(point.value)) for part, point in ((panel.u, panel.k), (panel.v, panel.l))
    ]
    assert ends == [seen.owners[one], seen.owners[other]]


def test_click_target_sent_by_viser_is_ignored(opened):
    """It says ball 0 of some part, or none, for clicks on the floor."""
    browser, client, _ = opened
    for node in client.handle.scene._handle_from_node_name:
        for index in (None, 0, 3):
            browser.send(_messages.SceneNodeClickMessage(
                node, index, (0.0, 0.0, 5.0), (0.0, 0.0, -1.0), (0.5, 0.5), None, str(client.handle.client_id)
            ))  # fmt: skip
    browser.click((5.0, 5.0, 5.0), (0.0, 0.0, -1.0))
    browser.set(client.panel.frames, True)
    until(lambda: client.editor.view.options.frames)
    assert (client.panel.u.value, client.panel.v.value) == (NONE, NONE)


def test_hidden_points_in_reach_are_not_chosen(opened, answers):
    browser, client, seen = opened
    browser.set(client.panel.points, False)
    until(lambda: not client.editor.view.options.points)
    ball = seen.visible(EYES[0])[0]
    bare = Sight(seen.triangles, np.zeros((0, 3)), np.zeros(0), [])
    for eye in EYES:
        behind = bare.first(eye, (seen.centers[ball] - eye) / np.linalg.norm(seen.centers[ball] - eye))
        chosen = click(browser, client, answers, eye, seen.centers[ball])
        assert chosen[1] == NONE
        assert chosen[0].split(":")[0] == (NONE if behind is None else str(behind[0]))


def test_clicks_while_something_runs_and_on_joined_parts(opened):
    """Points that are not free any more when a click's turn comes are not chosen."""
    browser, client, seen = opened
    panel = client.panel
    assert client.session is not None
    browser.press(panel.runs["search"])
    for ball in seen.visible(EYES[0]):
        browser.click(EYES[0], seen.centers[ball] - EYES[0])
    until(lambda: merges(client) == len(client.session.furniture.parts) - 1)
    until(lambda: panel.message.content.startswith("✓"))
    browser.set(panel.frames, True)
    until(lambda: client.editor.view.options.frames)
    assert (panel.u.value, panel.v.value) == (NONE, NONE)


def test_parts_in_front_hide_parts_behind():
    box, picker = shapes.brick(0.2, 0.2, 0.2), Picker()
    here = [shapes.pose(0, 0, 0), shapes.pose(0, 0, 1)]
    balls, none = np.zeros((1, 1, 3)), np.zeros((1, 1))
    down = np.array([0.01, 0.02, 5.0]), np.array([0.0, 0.0, -2.0])
    # The second mesh is no part, a robot for instance.
    assert picker.first(VisibleItems(here, balls, none), [box, box], *down) is None
    assert picker.first(VisibleItems([here[0], None], balls, none), [box, box], *down) == (0, None)
    assert picker.first(VisibleItems([None, None], balls, none), [box, box], *down) is None
    high = np.array([[[0.0, 0.0, 2.0]]])
    assert picker.first(VisibleItems(here, high, none + 0.1), [box, box], *down) == (0, 0)
    assert picker.first(VisibleItems(here, high, none + 0.01), [box, box], *down) is None
    # Behind the camera there is nothing.
    assert picker.first(VisibleItems(here, high, none + 0.1), [box, box], down[0], -down[1]) is None
