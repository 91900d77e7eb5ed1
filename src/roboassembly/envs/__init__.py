"""Gymnasium environments. Importing this package is cheap: Gymnasium and the environments load when they are used."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

OBJECT_CENTRIC = "RoboAssembly/ObjectCentric-v0"
FULL = "RoboAssembly/Full-v0"
CONTROL = "RoboAssembly/Control-v0"
_ENTRIES = {
    OBJECT_CENTRIC: "roboassembly.envs.object_centric:ObjectCentricEnv",
    FULL: "roboassembly.envs.full:FullEnv",
    CONTROL: "roboassembly.control.env:ControlEnv",
}


def register() -> None:
    """Register the environments with Gymnasium."""
    from gymnasium.envs import registration

    for name, entry in _ENTRIES.items():
        if name not in registration.registry:
            registration.register(name, entry_point=entry)  # pyright: ignore[reportUnknownMemberType]


def register_with_gymnasium() -> None:
    """Register the environments now if Gymnasium is loaded, else as soon as it is; `import roboassembly` calls it.

    Gymnasium takes most of the time of `import roboassembly`, and few commands use it.
    """
    if "gymnasium" in sys.modules:
        register()
    elif not any(isinstance(finder, _GymnasiumFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _GymnasiumFinder())


class _GymnasiumFinder(MetaPathFinder):
    """Finds Gymnasium as Python does, and registers the environments once it is loaded."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            register()

        spec.loader.exec_module = load_and_register
        return spec
