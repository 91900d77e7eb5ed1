"""Any plan in time, whatever the setting."""

from __future__ import annotations

from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan
from roboassembly.viewer.robots import FullDirector, make_full_timeline
from roboassembly.viewer.timeline import Director, Timeline, make_timeline

AnyPlan = Plan | FullPlan
SECONDS_PER_STEP, FULL_SECONDS_PER_STEP = 1.8, 6.0


def timeline_of(
    plan: AnyPlan, frames_per_second: float, seconds_per_step: float | None, *, slower: float = 1.0
) -> Timeline:
    """Lay a plan out in time.

    Args:
        plan: of either setting; one that failed is laid out as far as it got.
        frames_per_second: positive.
        seconds_per_step: about how long each step lasts; as long as suits the setting if None.
        slower: than that, if it is None.

    Raises:
        InputError: a rate or duration that is not a positive finite number.
    """
    if isinstance(plan, FullPlan):
        seconds = FULL_SECONDS_PER_STEP * slower if seconds_per_step is None else seconds_per_step
        return make_full_timeline(plan, frames_per_second=frames_per_second, seconds_per_step=seconds)
    seconds = SECONDS_PER_STEP * slower if seconds_per_step is None else seconds_per_step
    return make_timeline(plan, frames_per_second=frames_per_second, seconds_per_step=seconds)


def director_of(plan: AnyPlan, frames_per_second: float) -> Director | FullDirector:
    """Makes frames of a plan step by step, each as long as suits the setting."""
    if isinstance(plan, FullPlan):
        return FullDirector(plan, frames_per_second, FULL_SECONDS_PER_STEP)
    return Director(plan, frames_per_second, SECONDS_PER_STEP)
