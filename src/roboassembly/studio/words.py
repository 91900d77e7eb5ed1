"""What the studio says."""

from __future__ import annotations

from typing import Any

from roboassembly.furniture.model import Furniture
from roboassembly.studio.session import Tried
from roboassembly.task.full.task import FullVerdict
from roboassembly.task.object_centric.task import ObjectCentricVerdict
from roboassembly.task.plans.plan import UprightResult

WAYS = ("+z up", "−z up", "+x up", "−x up", "+y up", "−y up")
"""For each `w`, in the frame of the assembled furniture."""

_WHY: dict[str, str] = {
    ObjectCentricVerdict.NOT_AN_ACTION: "A point is not free, a grasp is not there, or both parts are in one "
    "group already.",
    ObjectCentricVerdict.WRONG_PAIR: "These two points do not belong together: joined so, the two groups are no "
    "piece of this furniture.",
    ObjectCentricVerdict.START_IN_COLLISION: "The moving group touches something where it lies.",
    ObjectCentricVerdict.GOAL_IN_COLLISION: "Joined, the moving group would be in the ground or in another part. "
    "Another axis up may do, or the other group moving.",
    ObjectCentricVerdict.UNREACHABLE: "Whatever way the moving group comes, something is in between.",
    ObjectCentricVerdict.BUDGET_EXHAUSTED: "The planner found no way in with the states that it may check.",
    FullVerdict.GRASP_BLOCKED: "The hand cannot come to the part past the rest of its group. Another grasp may do.",
    FullVerdict.JOINT_BLOCKED: "The groups or the hands are in each other's way at the joint. Other grasps may do.",
    FullVerdict.CANNOT_RELEASE: "R_a's hand could not leave the joined group. Another grasp may do.",
    FullVerdict.NO_ARM_SOLUTION: "No stance of both platforms lets both arms reach the joint.",
    FullVerdict.NO_PATH: "The arms can reach the joint but find no way there.",
    FullVerdict.NO_PLACEMENT: "There is no way of setting the joined group on a post.",
}
"""What a verdict means; those that both settings have mean the same in both."""


def upright_note(result: UprightResult[Any] | None) -> str:
    """How the finished piece ends, in Markdown, to follow another sentence; empty as long as it is not finished."""
    if result is None:
        return ""
    return " It stands on its feet." if result.success else f" It is not set upright: {result.reason}."


def told(furniture: Furniture, tried: Tried) -> str:
    """One action and what came of it, in Markdown."""
    u, v, k, l, *_ = tried.action  # noqa: E741
    what = f"**{furniture.parts[u].name}** ({k}) onto **{furniture.parts[v].name}** ({l})"
    cost = f"{tried.planning_steps:,} states checked in {1e3 * tried.planning_seconds:.0f} ms"
    if tried.merged:
        return f"✓ {what}: joined; {cost}."
    leg = f" in “{tried.leg}”" if tried.leg else ""
    name, why = tried.verdict.replace("_", " "), _WHY[tried.verdict]
    return f"✗ {what}: *{name}*{leg}; {cost}. {why} Nothing moved; in training this would end the episode."
