"""Captions of the frames of a film."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from roboassembly.furniture.model import Furniture
from roboassembly.task.plans.plan import Plan, UprightResult
from roboassembly.task.plans.stability import group_name


def step_caption(furniture: Furniture, index: int, steps: int, action: Sequence[int], sizes: tuple[int, int]) -> str:
    """Return a caption such as `step 3 of 14: back_slat_1 onto post_left (+3)`.

    Args:
        furniture: furniture of the plan.
        index: index of the step.
        steps: number of steps of the plan.
        action: action of the step; it begins with the part that moves and the part that waits.
        sizes: numbers of parts in the groups of these two parts.
    """
    names = [
        furniture.parts[part].name + (f" (+{size - 1})" if size > 1 else "")
        for part, size in zip(action[:2], sizes, strict=True)
    ]
    return f"step {index + 1} of {_expected_steps(furniture, steps)}: {' onto '.join(names)}"


def held_caption(plan: Plan, index: int) -> str:
    """Return what to hold in a step, such as `; hold post_left (+2)`; empty if all stands, or if nobody asked."""
    group = None if plan.stability is None else plan.stability.group_to_hold(index)
    return "" if group is None else f"; hold {group_name([p.name for p in plan.furniture.parts], group.parts)}"


def ending_caption(furniture: Furniture, steps: int, success: bool, upright: UprightResult[Any] | None) -> str:
    """Return the caption of the last frames, which says whether the furniture was assembled."""
    if success:
        note = ", not set upright" if upright is not None and not upright.success else ""
        return f"{furniture.name}: assembled in {steps} step{'s' if steps != 1 else ''}{note}"
    return f"{furniture.name}: not assembled, stopped after {steps} of {_expected_steps(furniture, steps)} steps"


def _expected_steps(furniture: Furniture, steps: int) -> int:
    # Each step merges two groups: a complete assembly has one step fewer than parts.
    return max(steps, len(furniture.parts) - 1)
