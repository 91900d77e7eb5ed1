"""Episodes kept in a file as they end, one a line, so that what was stopped goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import Episode


def read_episodes(path: Path, about: dict[str, Any]) -> list[Episode] | None:
    """The episodes of a file, the last line perhaps half written; None if it holds those of something else.

    Args:
        path: of the file; if it is not there, neither are episodes.
        about: what they are of, as `playing` was told.
    """
    if not path.is_file():
        return []
    out: list[Episode] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines()):
        try:
            told = json.loads(line)
            if number:
                told |= {"actions": tuple(tuple(a) for a in told["actions"])}
                out.append(Episode(**told | {"step_seconds": tuple(told["step_seconds"])}))
            elif told != json.loads(json.dumps(about)):
                return None
        except (ValueError, TypeError, KeyError):
            if number:
                break
            return None
    return out


def record_episodes(
    path: Path, about: dict[str, Any], there: list[Episode], play: Callable[[], Iterator[Episode]]
) -> Iterator[Episode]:
    """Those that are there, and the others as they are played and kept.

    Args:
        path: of the file, written anew with what is there.
        about: what the episodes are of; JSON.
        there: to begin with.
        play: the others.

    Raises:
        InputError: the file cannot be written.
    """
    lines = [json.dumps(about), *(json.dumps(asdict(e)) for e in there)]
    scratch = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_text("".join(line + "\n" for line in lines))
        scratch.replace(path)
        file = path.open("a")
    except OSError as error:
        raise InputError(f"cannot write to '{path}': {error.strerror or error}") from None
    yield from there
    with file:
        for episode in play():
            file.write(json.dumps(asdict(episode)) + "\n")
            file.flush()
            yield episode
