"""The thread that draws the pictures of the studio's time line."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from roboassembly.rendering.colors import Role
from roboassembly.studio.step_pictures import PictureDrawer, PictureJob
from roboassembly.viewer.timeline import Frame, Phase
from shapes import brick, pose

SECONDS = 30.0
"""Time that only a hang exceeds [s]."""


def job(done: Callable[[str], None]) -> PictureJob:
    return PictureJob([brick(0.1, 0.2, 0.3)], 1, Frame((pose(),), (Role.MOVING,), 0, Phase.MOVING, ""), done)


def test_pictures_come_in_turn() -> None:
    drawer, order, finished = PictureDrawer(), list[int](), threading.Event()
    for number in range(3):
        drawer.add(job(lambda _, number=number: order.append(number)))
    drawer.add(job(lambda _: finished.set()))
    assert finished.wait(SECONDS)
    assert order == [0, 1, 2]
    drawer.close()


def test_a_client_that_still_works_does_not_keep_a_drawer_from_closing() -> None:
    drawer, drawn, go_on, late = PictureDrawer(), threading.Event(), threading.Event(), list[str]()

    def wait(_: str) -> None:
        drawn.set()
        go_on.wait(SECONDS)

    drawer.add(job(wait))
    assert drawn.wait(SECONDS)
    closing = threading.Thread(target=drawer.close, daemon=True)
    closing.start()
    time.sleep(0.2)  # until it waits for the thread that draws
    drawer.add(job(late.append))
    assert late == [""]
    go_on.set()
    closing.join(SECONDS)
    assert not closing.is_alive()
