"""Import of MuJoCo without GLFW, its library for windows, which takes a quarter of the time."""

from __future__ import annotations

import os

_CHOICE = "MUJOCO_GL"


def import_mujoco() -> None:
    """Import MuJoCo for physics in a process of this package's own.

    `mujoco.Renderer` does not work there afterwards, which this package does not use: its pictures are drawn with a
    context of its own (`rendering.gl`).
    """
    chosen = os.environ.get(_CHOICE)
    os.environ[_CHOICE] = "disable"
    try:
        import mujoco  # noqa: F401  # pyright: ignore[reportUnusedImport]
    finally:
        if chosen is None:
            del os.environ[_CHOICE]
        else:
            os.environ[_CHOICE] = chosen
