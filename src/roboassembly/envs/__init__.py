"""Gymnasium environments. Importing this package is cheap: environments load when they are made."""

from gymnasium.envs import registration

OBJECT_CENTRIC = "RoboAssembly/ObjectCentric-v0"
FULL = "RoboAssembly/Full-v0"
_ENTRIES = {
    OBJECT_CENTRIC: "roboassembly.envs.object_centric:ObjectCentricEnv",
    FULL: "roboassembly.envs.full:FullEnv",
}


def register() -> None:
    """Register the environments with Gymnasium; `import roboassembly` calls it."""
    for name, entry in _ENTRIES.items():
        if name not in registration.registry:
            registration.register(name, entry_point=entry)  # pyright: ignore[reportUnknownMemberType]
