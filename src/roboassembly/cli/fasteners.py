"""Lines and figures on the fasteners of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roboassembly.furniture.model import Furniture
    from roboassembly.task.plans.plan import Plan

_NAMED = 5
"""Number of fasteners without a way in that are named."""


def fasteners_by_hand(furniture: Furniture) -> str:
    """Return the line on furniture whose fasteners a person puts in."""
    return f"{_counted(furniture)}: a person puts them in; the robots join the other parts only"


def fastener_lines(plan: Plan) -> list[str]:
    """Return lines for the user: how many fasteners go in, and those that have no free way in."""
    fasteners, done, failed = plan.furniture.fasteners, plan.insertions, plan.not_inserted
    early = sum(insertion.after < len(plan.steps) - 1 for insertion in done)
    total = _counted(plan.furniture)
    lines = [f"{len(done)} of {len(fasteners)} fasteners go in ({total}), {early} of them before the last step"]
    lines += [f"  {fasteners[index].name} does not go in: {reason}" for index, reason in failed[:_NAMED]]
    return lines + [f"  and {len(failed) - _NAMED} more"] * (len(failed) > _NAMED)


def fastener_report(plan: Plan) -> dict[str, Any]:
    """Return the figures on fasteners for a report."""
    fasteners = plan.furniture.fasteners
    return {
        "count": len(fasteners),
        "inserted": {fasteners[i.fastener].name: i.after + 1 for i in plan.insertions},
        "not_inserted": {fasteners[index].name: reason for index, reason in plan.not_inserted},
    }


def _counted(furniture: Furniture) -> str:
    from roboassembly.furniture.fasteners import counted

    return counted([fastener.kind for fastener in furniture.fasteners])
