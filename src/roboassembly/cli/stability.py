"""`roboassembly stability`: which groups of a plan stand on their own, by physics, and which must be held."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from roboassembly.cli.output import DONE, check_writable, print_json, say, show

if TYPE_CHECKING:
    from roboassembly.task.plans.plan import Plan
    from roboassembly.task.plans.stability import GroupStability


@dataclass(frozen=True)
class StabilityCommand:
    """Tell which groups of a plan without robots stand on their own in every state, by physics."""

    plan: Annotated[Path, tyro.conf.Positional]
    """A plan.json that `roboassembly assemble` wrote without robots. Its furniture is `furniture/` beside it, or else a
    built-in piece."""
    page: bool = False
    """Write assembly.html beside the plan again, with captions that say what to hold."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        from roboassembly.simulation.windowless import import_mujoco
        from roboassembly.studio.sources import open_plan
        from roboassembly.task.object_centric.stability import with_stability
        from roboassembly.task.plans.plan_record import read_plan

        started = time.perf_counter()
        _, furniture = open_plan(self.plan)
        plan = read_plan(self.plan.read_bytes(), f"{self.plan}", furniture)
        if self.page:
            check_writable(self.plan.parent)
        import_mujoco()
        plan = with_stability(plan)
        outputs: dict[str, str] = {}
        if self.page:
            from roboassembly.viewer.html import write_html

            write_html(plan, self.plan.parent / "assembly.html")
            outputs["html"] = str(self.plan.parent / "assembly.html")
        lines = stability_lines(plan)
        if self.json:
            say(*lines)
            print_json(
                {
                    "success": True,
                    "furniture": furniture.name,
                    **stability_report(plan),
                    "seconds": round(time.perf_counter() - started, 3),
                    "outputs": outputs,
                }
            )
        else:
            show(*lines, *outputs.values())
        return DONE


def stability_lines(plan: Plan) -> list[str]:
    """Return lines for the user: how many steps need no hand, and what to hold in the others."""
    assert plan.stability is not None
    steps, to_hold = len(plan.steps), [i for i in plan.stability.steps_held if i >= 0]
    if plan.stability.stable:
        return [f"every group stands on its own in all {steps} steps"]
    head = (
        f"groups stand on their own in {steps - len(to_hold)} of {steps} steps; a helping hand or a fixture is needed:"
    )
    return [head, *(f"  {_line(plan, group)}" for group in plan.stability.unstable)]


def _line(plan: Plan, group: GroupStability) -> str:
    from roboassembly.task.plans.stability import GroupRole, group_name

    names = [part.name for part in plan.furniture.parts]
    name, moves = group_name(names, group.parts), _moves(group)
    if group.role is GroupRole.RESTING:
        when = "before step 1" if group.step < 0 else f"after step {group.step + 1}"
        return f"{when}: hold {name}, which does not stay as it lies: {moves}"
    if group.role is GroupRole.WAITING:
        coming = group_name(names, sorted(plan.steps[group.step].moving))
        return f"step {group.step + 1}: hold {name} while {coming} comes: {moves}"
    return f"step {group.step + 1}: hold {name} once it is joined: {moves}"


def _moves(group: GroupStability) -> str:
    return f"released, it tilts by {math.degrees(group.tilt):.0f}° and moves {1e3 * group.shift:.0f} mm"


def stability_report(plan: Plan) -> dict[str, Any]:
    """Return the figures on stability for a report: counts, and every group in every state."""
    assert plan.stability is not None
    return {
        "stable": plan.stability.stable,
        "steps": len(plan.steps),
        "steps_held": [index + 1 for index in plan.stability.steps_held],
        "groups": [
            {
                "step": g.step + 1,
                "role": g.role.value,
                "parts": [plan.furniture.parts[p].name for p in g.parts],
                "stable": g.stable,
                "tilt_deg": round(math.degrees(g.tilt), 2),
                "shift_mm": round(1e3 * g.shift, 1),
            }
            for g in plan.stability.groups
        ],
    }
