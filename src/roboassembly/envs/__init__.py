"""Gymnasium environments. Importing this registers nothing heavy: environments load when they are made."""

from gymnasium.envs import registration

OBJECT_CENTRIC = "RoboAssembly/ObjectCentric-v0"


def register() -> None:
    """Tell Gymnasium the environments' names; `import roboassembly` does it."""
    if OBJECT_CENTRIC not in registration.registry:
        registration.register(OBJECT_CENTRIC, entry_point="roboassembly.envs.object_centric:ObjectCentricEnv")
