"""Comparison of plans."""

from __future__ import annotations

import hashlib

from roboassembly.task.plans.plan import Plan


def plan_digest(plan: Plan) -> str:
    """Return a hash of all numbers of a plan but its times."""
    out = hashlib.sha256()
    for where in plan.initial:
        out.update(where.homogeneous.tobytes())
    for step in plan.steps:
        out.update(
            repr(
                (step.action, step.waiting, step.planning_steps, step.planner, sorted(step.moving), sorted(step.still))
            ).encode()
        )
        poses = [*step.path, *step.settling, *step.after, *(step.moving[p] for p in sorted(step.moving))]
        poses += [step.still[p] for p in sorted(step.still)]
        for where in poses:
            out.update(where.homogeneous.tobytes())
    out.update(repr((plan.success, plan.seed)).encode())
    return out.hexdigest()
