"""OpenGL context without a window, from EGL, OSMesa, GLFW or CGL."""

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


_OLDEST = 330
"""Oldest version of OpenGL that the shaders of pictures run on, as moderngl writes it."""

_tried: list[str] = []
"""Module that the process which started this one has tried; empty in a process of its own."""


class RenderingUnavailableError(RoboAssemblyError):
    """Off-screen rendering is not available on this machine."""


@functools.cache
def context_module() -> str:
    """Return the name of the MuJoCo module whose `GLContext` works here.

    `MUJOCO_GL` chooses the module if it is set; otherwise the first one that works is taken. MuJoCo reads `MUJOCO_GL`
    when it is first imported, and PyOpenGL loads one platform per process, so a wrong choice cannot be corrected.
    Each candidate is therefore tried in a separate process.

    Raises:
        RenderingUnavailableError: no module works, or `MUJOCO_GL` switches rendering off.
    """
    if _tried:
        return _tried[0]
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if requested in _SWITCHED_OFF:
        raise RenderingUnavailableError(f"MUJOCO_GL={requested} switches off-screen rendering off; unset it to render")
    if sys.platform == "darwin":
        candidates = ["mujoco.glfw"] if requested == "glfw" else ["mujoco.cgl"]
    elif not sys.platform.startswith("linux"):
        candidates = ["mujoco.glfw"]
    elif requested in ("egl", "osmesa"):
        candidates = [f"mujoco.{requested}"]
    elif requested in ("glfw", "glx"):
        candidates = ["mujoco.glfw"]
    elif requested in _ANY:
        has_display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        candidates = ["mujoco.egl", "mujoco.osmesa", *(["mujoco.glfw"] if has_display else [])]
    else:
        raise RenderingUnavailableError(f"MUJOCO_GL={requested} is unknown; set it to egl, osmesa or glfw, or unset it")
    for candidate in candidates:
        if can_render(candidate):
            return candidate
    tried = ", ".join(c.removeprefix("mujoco.") for c in candidates)
    if requested not in _ANY:
        raise RenderingUnavailableError(
            f"MUJOCO_GL={requested} does not work on this machine; unset it to use one that does"
        )
    raise RenderingUnavailableError(
        f"off-screen OpenGL is not available (tried {tried}); on Debian or Ubuntu: apt install libegl1 libgl1-mesa-dri"
    )


def skip_trial(module: str) -> None:
    """Make `context_module` return a module without a trial, in a process that one which has tried it has started."""
    _tried[:] = [module]


def can_render(module: str) -> bool:
    """Whether a fresh process can render with a module of MuJoCo that has a `GLContext`."""
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
    """Import and return the `mujoco` module.

    Raises:
        RenderingUnavailableError: the import fails, as it does with an unsuitable `MUJOCO_GL`.
    """
    context_module()
    try:
        return importlib.import_module("mujoco")
    except (ImportError, RuntimeError, OSError) as error:
        raise RenderingUnavailableError(f"MuJoCo cannot be imported for rendering: {_one_line(error)}") from error


class OffscreenContext:
    """OpenGL context without a window. It is current at first; leaving the `with` block frees it.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
    """

    def __init__(self, width: int, height: int) -> None:
        import_mujoco()
        name = context_module()
        try:
            self._context = importlib.import_module(name).GLContext(width, height)
            self._context.make_current()
        except (ImportError, RuntimeError, OSError, AttributeError) as error:
            # The probe worked in a fresh process: other code in this one has loaded another OpenGL platform.
            raise RenderingUnavailableError(f"OpenGL cannot be used in this process: {_one_line(error)}") from error

    def make_current(self) -> None:
        """Make this the current context of the thread; another one may have been created since."""
        self._context.make_current()

    def __enter__(self) -> OffscreenContext:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.free()


class PictureContext:
    """OpenGL context without a window for the shaders of pictures; leaving the `with` block frees it.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen, or not with OpenGL 3.3.
    """

    def __init__(self, width: int, height: int) -> None:
        self._window: OffscreenContext | None = None
        moderngl = importlib.import_module("moderngl")
        try:
            if sys.platform.startswith("linux"):
                self._window = OffscreenContext(width, height)
                moderngl.init_context(_Loader())
                self._gl = moderngl.get_context()
            else:
                # MuJoCo's contexts have no shaders of OpenGL 3.3 there.
                self._gl = moderngl.create_context(standalone=True)
        except RenderingUnavailableError:
            raise
        except (moderngl.Error, OSError, RuntimeError) as error:
            raise RenderingUnavailableError(f"OpenGL cannot be used in this process: {_one_line(error)}") from error
        if self._gl.version_code < _OLDEST:
            found = f"{self._gl.version_code / 100:.1f}"
            self.free()
            raise RenderingUnavailableError(f"pictures need OpenGL 3.3; this machine has {found}")

    def activate(self) -> Any:
        """Make this the current context of the thread and return its `moderngl.Context`."""
        if self._window is None:
            self._gl.__enter__()
        else:
            self._window.make_current()
        return self._gl

    @property
    def is_software(self) -> bool:
        """Whether the processor renders, not a graphics card."""
        renderer = str(self._gl.info["GL_RENDERER"]).lower()
        return any(name in renderer for name in ("llvmpipe", "softpipe", "swrast", "software"))

    def free(self) -> None:
        """Free the context and all that was made in it."""
        if self._window is None:
            self._gl.release()
        else:
            self._window.__exit__(None, None, None)

    def __enter__(self) -> PictureContext:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.free()


class _Loader:
    """Finds functions of OpenGL for moderngl in the library that MuJoCo's context has loaded."""

    def load_opengl_function(self, name: str) -> int:
        platform = importlib.import_module("OpenGL.platform").PLATFORM
        return int(platform.getExtensionProcedure(name.encode()) or 0)

    load = load_opengl_function


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
