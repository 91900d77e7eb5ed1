"""Animations and timelines of plans of either setting."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

from roboassembly.errors import InputError
from roboassembly.task.setting import SettingName
from roboassembly.viewer.timeline import Frame, Timeline

if TYPE_CHECKING:
    from roboassembly.task.plans.full_plan import FullPlan
    from roboassembly.task.plans.plan import Plan
    from roboassembly.viewer.full_animation import FullPlanAnimator
    from roboassembly.viewer.object_centric_animation import PlanAnimator

AnyPlan: TypeAlias = "Plan | FullPlan"
"""Plan of either setting."""


def _object_centric(plan: Plan, frames_per_second: float, seconds_per_step: float) -> PlanAnimator:
    from roboassembly.viewer.object_centric_animation import PlanAnimator

    return PlanAnimator(plan, frames_per_second, seconds_per_step)


def _full(plan: FullPlan, frames_per_second: float, seconds_per_step: float) -> FullPlanAnimator:
    from roboassembly.viewer.full_animation import FullPlanAnimator

    return FullPlanAnimator(plan, frames_per_second, seconds_per_step)


_ANIMATORS: dict[SettingName, tuple[Callable[[Any, float, float], PlanAnimator | FullPlanAnimator], float]] = {
    "object-centric": (_object_centric, 1.8),
    "full": (_full, 5.0),
}
"""Animator and default duration of a step [s] of each setting."""
OVERTURE_SECONDS, FINALE_SECONDS = 1.0, 2.0


def make_timeline(
    plan: AnyPlan, frames_per_second: float = 30.0, seconds_per_step: float | None = None, *, slowdown: float = 1.0
) -> Timeline:
    """Return the timeline of a plan. A failed plan is shown as far as it got.

    Args:
        plan: plan of either setting.
        frames_per_second: frame rate; positive.
        seconds_per_step: approximate duration of a step [s]; the default of the plan's setting if None.
        slowdown: factor on that default.

    Raises:
        InputError: a rate or duration is not a positive finite number.
    """
    animator = make_animator(plan, frames_per_second, seconds_per_step, slowdown=slowdown)
    return Timeline(plan.furniture.name, animator.objects, tuple(_all_frames(animator)), frames_per_second)


def make_animator(
    plan: AnyPlan, frames_per_second: float, seconds_per_step: float | None = None, *, slowdown: float = 1.0
) -> PlanAnimator | FullPlanAnimator:
    """Return the object that makes the frames of a plan; arguments and errors as of `make_timeline`."""
    make, default = _ANIMATORS[plan.setting]
    seconds = default * slowdown if seconds_per_step is None else seconds_per_step
    for name, value in (("frames_per_second", frames_per_second), ("seconds_per_step", seconds)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}; it must be a positive number")
    return make(plan, frames_per_second, seconds)


def _all_frames(animator: PlanAnimator | FullPlanAnimator) -> Iterator[Frame]:
    def count(seconds: float) -> int:
        return max(1, round(seconds * animator.frames_per_second))

    yield from itertools.repeat(animator.opening(), count(OVERTURE_SECONDS))
    for index in range(len(animator.plan.steps)):
        yield from animator.step(index)
    yield from animator.upright()
    yield from itertools.repeat(animator.ending(), count(FINALE_SECONDS))
