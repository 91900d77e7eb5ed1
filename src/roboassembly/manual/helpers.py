"""Steps that need a second pair of hands, of a person or a robot, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.manual.exits import Handling
from roboassembly.manual.merge_tree import Parts
from roboassembly.manual.steps import Manual, ManualStep

HEAVY = 15.0
"""Mass above which two people lift [kg]."""
LONG = 1.5
"""Length above which two people carry [m]."""
_FALLEN = float(np.deg2rad(25.0))
"""Tilt after which a sub-assembly that was released counts as fallen [rad]."""


@dataclass(frozen=True)
class Help:
    """Reason for a second pair of hands in a step."""

    step: int
    reason: str
    parts_held: Parts = frozenset()
    """Parts of the base that a hand holds; empty if nothing needs to be held."""


def helps(manual: Manual) -> list[Help]:
    """Return the reasons for a second pair of hands, in the order of the steps."""
    out: list[Help] = []
    for step in manual.steps:
        if not step.movers:
            continue  # fasteners need one hand
        out += [Help(step.number, reason) for reason in _reasons(manual, step)]
        if (reason := _reason_to_hold(manual, step)) is not None:
            out.append(Help(step.number, reason, step.base))
    if manual.final_turn is not None:
        whole = manual.steps[-1].result
        load = _load(manual.arrangement.handling, whole)
        if load:
            out.append(Help(len(manual.steps), f"stand the finished piece up: {load}"))
    return out


def _reasons(manual: Manual, step: ManualStep) -> list[str]:
    handling = manual.arrangement.handling
    out: list[str] = []
    if step.turned_from is not None and (load := _load(handling, step.base)):
        out.append(f"turn what is there: {load}")
    loads = dict.fromkeys(_load(handling, mover.parts) for mover in step.movers)
    out += [f"lift what comes: {load}" for load in loads if load]
    return out


def _reason_to_hold(manual: Manual, step: ManualStep) -> str | None:
    """Return why what is there, or the result of a step, must be held; None if both stand.

    What tilts less than `LEAST_TIPPING` before it falls is held, too; physics tells whether it falls by itself.
    """
    handling = manual.arrangement.handling
    for subject, parts in (("what is there", step.base), ("the result", step.result)):
        falls = parts == step.result and _falls(manual, step)
        if falls or not handling.stands(parts, step.up):
            balances = not falls and handling.stand_check.stands(parts, step.up)
            return f"hold {subject}: it {'tips over easily' if balances else 'does not stand by itself'}"
    return None


def _falls(manual: Manual, step: ManualStep) -> bool:
    """Whether physics lets the result of a step fall over once it is released."""
    record = manual.arrangement.by_node[step.result].step
    return float(np.arccos(np.clip(record.settling[-1].rotation[2, 2], -1.0, 1.0))) > _FALLEN


def _load(handling: Handling, parts: Parts) -> str:
    """Return words for what makes parts too much for one person; empty if they are not."""
    mass = handling.mass(parts)
    length = float(np.ptp(handling.points(parts), axis=0).max())
    reasons = [f"about {mass:.0f} kg of wood"] if mass > HEAVY else []
    reasons += [f"{length:.1f} m long"] if length > LONG else []
    return ", ".join(reasons)
