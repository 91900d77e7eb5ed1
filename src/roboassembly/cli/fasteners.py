"""Lines and figures on the fasteners of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roboassembly.task.plans.full_plan import FullPlan
    from roboassembly.task.plans.plan import Insertion, Plan

_NAMED = 5
"""Number of fasteners without a way in that are named."""


def _insertions(plan: Plan | FullPlan) -> tuple[tuple[Insertion, ...], tuple[tuple[int, str], ...]] | None:
    """Return insertions, and fasteners without; None of a plan in which a person puts them in."""
    return (plan.insertions, plan.not_inserted) if plan.setting == "object-centric" else None


def fastener_lines(plan: Plan | FullPlan) -> list[str]:
    """Return lines for the user: how many fasteners go in, and those that have no free way in."""
    from roboassembly.furniture.fasteners import counted

    fasteners = plan.furniture.fasteners
    total = counted([fastener.kind for fastener in fasteners])
    found = _insertions(plan)
    if found is None:
        return [f"{total}: a person puts them in; the robots join the other parts only"]
    done, failed = found
    early = sum(insertion.after < len(plan.steps) - 1 for insertion in done)
    lines = [f"{len(done)} of {len(fasteners)} fasteners go in ({total}), {early} of them before the last step"]
    lines += [f"  {fasteners[index].name} does not go in: {reason}" for index, reason in failed[:_NAMED]]
    return lines + [f"  and {len(failed) - _NAMED} more"] * (len(failed) > _NAMED)


def fastener_report(plan: Plan | FullPlan) -> dict[str, Any]:
    """Return the figures on fasteners for a report."""
    fasteners = plan.furniture.fasteners
    done, failed = _insertions(plan) or ((), ())
    return {
        "count": len(fasteners),
        "inserted": {fasteners[i.fastener].name: i.after + 1 for i in done},
        "not_inserted": {fasteners[index].name: reason for index, reason in failed},
    }
