"""RoboAssembly: plan, simulate and learn furniture assembly."""

__version__ = "0.1.0"
