"""Episode records and the file that keeps them, one a line, so that a stopped evaluation continues where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError


@dataclass(frozen=True)
class Episode:
    """One attempt at one piece of furniture."""

    furniture: str
    parts: int
    seed: int
    """Seed of the start and of all draws; `reset(seed=...)` of the environment."""
    success: bool
    merges: int
    verdict: str
    """Outcome of the last step (verdict of the setting or of the execution); for a solver `merged` or why it failed."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float
    policy_seconds: float = 0.0
    """Time that the policy took to choose [s]."""
    actions: tuple[tuple[int, ...], ...] = ()
    """Action of each step; empty if the solver takes none."""
    family: str = ""
    """Family of the furniture; empty if the set does not name it."""
    unseen: bool | None = None
    """Whether the family occurs in no training; None if the set does not say."""
    reason: str = ""
    """Why a solver found nothing, or the stage in which a policy's last step failed with robots, in words."""
    stage: str = ""
    """Stage in which a policy's last step failed with robots (`Stage`); empty if none did."""
    step_seconds: tuple[float, ...] = ()
    """Planning time of each merge of the plan [s]."""
    executed: dict[str, Any] | None = None
    """Result of a plan that was carried out in physics: `task.full.execution.PlanExecution` in numbers."""
    violations: int | None = None
    """Number of violations that an audit of the plan found; None without an audit."""


def read_episodes(path: Path, about: dict[str, Any]) -> list[Episode] | None:
    """Read the episodes of a file whose last line may be half written; None if the file belongs to something else.

    Args:
        path: file of episodes; a missing file holds none.
        about: description of the evaluation, as given to `record_episodes`.
    """
    if not path.is_file():
        return []
    episodes: list[Episode] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines()):
        try:
            fields = json.loads(line)
            if number:
                fields |= {"actions": tuple(tuple(a) for a in fields["actions"])}
                episodes.append(Episode(**fields | {"step_seconds": tuple(fields["step_seconds"])}))
            elif fields != json.loads(json.dumps(about)):
                return None
        except (ValueError, TypeError, KeyError):
            if number:
                break
            return None
    return episodes


def record_episodes(
    path: Path, about: dict[str, Any], known: list[Episode], run_rest: Callable[[], Iterator[Episode]]
) -> Iterator[Episode]:
    """Yield the known episodes, then the others as they end and are written.

    Args:
        path: file of episodes; it is written anew with the known ones.
        about: description of the evaluation; JSON.
        known: first episodes.
        run_rest: runs the other episodes.

    Raises:
        InputError: the file cannot be written.
    """
    lines = [json.dumps(about), *(json.dumps(asdict(e)) for e in known)]
    try:
        with atomic_write(path) as unfinished:
            unfinished.write_text("".join(line + "\n" for line in lines))
        file = path.open("a")
    except OSError as error:
        raise InputError(f"cannot write to '{path}': {error.strerror or error}") from None
    yield from known
    with file:
        for episode in run_rest():
            file.write(json.dumps(asdict(episode)) + "\n")
            file.flush()
            yield episode
