"""An OpenGL context without a window, on whatever this machine has for it."""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from types import TracebackType
from typing import Any

from roboassembly.errors import RoboAssemblyError

PROBE_SECONDS = 60.0
_SWITCHED_OFF = ("disable", "disabled", "off", "false", "0")
_ANY = ("", "enable", "enabled", "on", "true", "1")
_CHECK = """
import sys, importlib, mujoco
context = importlib.import_module(sys.argv[1]).GLContext(64, 64)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100.value)
sys.stdout.write("renders")
sys.stdout.flush()
import os
os._exit(0)
"""


class RenderingUnavailableError(RoboAssemblyError):
    """This machine cannot draw off screen."""


@functools.cache
def context_module() -> str:
    """Name of MuJoCo's module whose `GLContext` works here: what `MUJOCO_GL` says, else the first that does.

    MuJoCo settles this when it is first imported, from `MUJOCO_GL` alone, and PyOpenGL can load one platform per
    process; a wrong choice cannot be taken back. So each candidate is tried in a process of its own.

    Raises:
        RenderingUnavailableError: none works, or `MUJOCO_GL` rules it out.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in _SWITCHED_OFF:
        raise RenderingUnavailableError(f"MUJOCO_GL={wanted} switches off-screen rendering off; unset it to draw")
    if sys.platform == "darwin":
        candidates = ["mujoco.glfw"] if wanted == "glfw" else ["mujoco.cgl"]
    elif not sys.platform.startswith("linux"):
        candidates = ["mujoco.glfw"]
    elif wanted in ("egl", "osmesa"):
        candidates = [f"mujoco.{wanted}"]
    elif wanted in ("glfw", "glx"):
        candidates = ["mujoco.glfw"]
    elif wanted in _ANY:
        has_display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        candidates = ["mujoco.egl", "mujoco.osmesa", *(["mujoco.glfw"] if has_display else [])]
    else:
        raise RenderingUnavailableError(f"MUJOCO_GL={wanted} is not known; egl, osmesa or glfw would do, or unset it")
    for candidate in candidates:
        if _renders(candidate):
            return candidate
    tried = ", ".join(c.removeprefix("mujoco.") for c in candidates)
    if wanted not in _ANY:
        raise RenderingUnavailableError(f"MUJOCO_GL={wanted} does not work here; unset it, then what does is found")
    raise RenderingUnavailableError(
        f"no off-screen OpenGL here (tried {tried}); on Debian or Ubuntu: apt install libegl1 libgl1-mesa-dri"
    )


def _renders(module: str) -> bool:
    environment = dict(os.environ)
    environment["MUJOCO_GL"] = module.removeprefix("mujoco.")
    try:
        result = subprocess.run(
            [sys.executable, "-c", _CHECK, module],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return result.returncode == 0 and b"renders" in result.stdout


def import_mujoco() -> Any:
    """The `mujoco` module.

    Raises:
        RenderingUnavailableError: it refuses to be imported, which it does where `MUJOCO_GL` is wrong.
    """
    context_module()
    try:
        return importlib.import_module("mujoco")
    except (ImportError, RuntimeError, OSError) as error:
        raise RenderingUnavailableError(f"MuJoCo cannot be loaded for drawing: {_one_line(error)}") from error


class Context:
    """An OpenGL context, current at first; leave the `with` block to free it.

    Raises:
        RenderingUnavailableError: there is no way to draw off screen.
    """

    def __init__(self, width: int, height: int) -> None:
        import_mujoco()
        name = context_module()
        try:
            self._context = importlib.import_module(name).GLContext(width, height)
            self._context.make_current()
        except (ImportError, RuntimeError, OSError, AttributeError) as error:
            # The probe worked in a fresh process, so something else in this one has taken another OpenGL platform.
            raise RenderingUnavailableError(f"OpenGL cannot be used in this process: {_one_line(error)}") from error

    def make_current(self) -> None:
        """Direct what is drawn next in this thread to this context: another one may have been made since."""
        self._context.make_current()

    @property
    def is_software(self) -> bool:
        """Whether a processor draws, not a graphics card."""
        gl = importlib.import_module("OpenGL.GL")
        renderer = (gl.glGetString(gl.GL_RENDERER) or b"").decode(errors="replace").lower()
        return any(name in renderer for name in ("llvmpipe", "softpipe", "swrast", "software"))

    def __enter__(self) -> Context:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.free()


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
