"""Recording of moving meshes as viser's messages. No browser is connected, so they go into the recording only."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from viser import SceneApi
from viser._messages import SetOrientationMessage, SetPositionMessage
from viser.infra import StateSerializer

from roboassembly.viewer.viser_scene import ViserScene

_RELATIVE, _ABSOLUTE = 1e-5, 1e-8
"""Tolerances within which viser leaves a coordinate as it is: those of `numpy.allclose`."""


class RecordedScene(ViserScene):
    """Scene whose motions go into a recording, with the messages that viser would write for them.

    viser queues each message for all browsers and wakes up the thread that sends them, which takes several times as
    long as the recording.
    """

    def __init__(self, scene: SceneApi) -> None:
        super().__init__(scene)
        self._recording: StateSerializer | None = None
        self._places: list[tuple[tuple[float, ...], tuple[float, ...]]] = []

    def record(self, recording: StateSerializer) -> None:
        """Write all later motions into a recording; the objects have been added before."""
        self._recording = recording
        self._places = [(tuple(map(float, mesh.position)), tuple(map(float, mesh.wxyz))) for mesh in self.meshes]

    def _move(self, index: int, seven: Float[np.ndarray, "7"]) -> None:
        numbers, name = tuple(seven.tolist()), self.meshes[index].name
        (position, wxyz), goal = self._places[index], (numbers[:3], numbers[3:])
        if not _close(goal[0], position):
            position = goal[0]
            self._insert(SetPositionMessage(name, position))
        if not _close(goal[1], wxyz):
            wxyz = goal[1]
            self._insert(SetOrientationMessage(name, wxyz))
        self._places[index] = position, wxyz

    def _insert(self, message: SetPositionMessage | SetOrientationMessage) -> None:
        assert self._recording is not None
        message.owner = self._scene._owner_id
        self._recording._insert_message(message)


def _close(new: Sequence[float], old: Sequence[float]) -> bool:
    return all(abs(a - b) <= _ABSOLUTE + _RELATIVE * abs(b) for a, b in zip(new, old, strict=True))
