"""RoboAssembly: plan, simulate and learn furniture assembly."""

__version__ = "0.1.0"

from roboassembly.envs import register_with_gymnasium as _register

_register()
