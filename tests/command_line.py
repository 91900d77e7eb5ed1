"""Type of the fixture `run`."""

from __future__ import annotations

from collections.abc import Callable

Run = Callable[..., tuple[int, str, str]]
"""Run a command line; returns exit status, stdout and stderr."""
