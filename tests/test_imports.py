"""What the package and its commands load: the time of a start is that of imports, for the most part."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = (
    "coal",
    "gymnasium",
    "jax",
    "matplotlib",
    "mujoco",
    "numpy",
    "ompl",
    "pinocchio",
    "ray",
    "scipy",
    "trimesh",
    "viser",
)


@pytest.mark.parametrize(
    "code",
    [
        "import roboassembly",
        "import roboassembly.cli",
        "from roboassembly import cli; cli.parse(['assemble', 'stool'])",
    ],
)
def test_the_package_and_its_command_line_load_no_large_library(code: str) -> None:
    show = f"{code}\nimport sys\nprint(*sorted({set(HEAVY)!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", show], check=True, capture_output=True, text=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize(
    "order", ["gymnasium, roboassembly", "roboassembly, gymnasium", "roboassembly, gymnasium.envs"]
)
def test_environments_are_registered_in_any_order_of_imports(order: str) -> None:
    code = f"import {order}\nprint(*sorted(name for name in gymnasium.registry if name.startswith('RoboAssembly/')))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == [f"RoboAssembly/{name}-v0" for name in ("Control", "Full", "ObjectCentric")]


@pytest.mark.parametrize("chosen", [None, "egl", "off"])
def test_physics_leaves_the_choice_of_pictures_alone(chosen: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    if chosen is not None:
        monkeypatch.setenv("MUJOCO_GL", chosen)
    code = (
        "import os, sys\nfrom roboassembly.simulation.windowless import import_mujoco\nimport_mujoco()\n"
        "print('mujoco' in sys.modules, 'glfw' in sys.modules, os.environ.get('MUJOCO_GL'))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["True", "False", str(chosen)]
