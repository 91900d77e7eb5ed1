"""Messages of the studio about attempts and results, in Markdown."""

from __future__ import annotations

from typing import Any

from roboassembly.furniture.model import Furniture
from roboassembly.studio.assembly_session import Attempt
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.object_centric.task import ObjectCentricVerdict
from roboassembly.task.plans.plan import UprightResult

_EXPLANATIONS: dict[str, str] = {
    ObjectCentricVerdict.NOT_AN_ACTION: "A point is not free, a grasp does not exist, or both parts belong to one "
    "group already.",
    ObjectCentricVerdict.WRONG_PAIR: "These two points do not belong together: the joined groups would not be a part "
    "of this furniture.",
    ObjectCentricVerdict.START_IN_COLLISION: "The moving group collides where it lies.",
    ObjectCentricVerdict.GOAL_IN_COLLISION: "At the joint, the moving group would collide with the ground or with "
    "another part. Another axis up may help, or moving the other group.",
    ObjectCentricVerdict.UNREACHABLE: "Obstacles block every way of the moving group to the joint.",
    ObjectCentricVerdict.BUDGET_EXHAUSTED: "The planner found no path within the number of states that it may check.",
    FullVerdict.GRASP_BLOCKED: "The rest of the group blocks the hand's way to the part. Another grasp may help.",
    FullVerdict.JOINT_BLOCKED: "The groups or the hands block each other at the joint. Other grasps may help.",
    FullVerdict.CANNOT_RELEASE: "The hand of R_a cannot leave the joined group. Another grasp may help.",
    FullVerdict.NO_ARM_SOLUTION: "No placement of the two platforms lets both arms reach the joint.",
    FullVerdict.NO_PATH: "The arms can reach the joint, but the planner found no path to it.",
    FullVerdict.NO_PLACEMENT: "The joined group cannot be set on a post.",
}
"""Explanation of each verdict; a verdict that both settings have means the same in both."""


def upright_message(result: UprightResult[Any] | None) -> str:
    """Return a sentence, to follow another, about how the finished piece stands; empty if it is not finished."""
    if result is None:
        return ""
    return " It stands on its feet." if result.success else f" It is not set upright: {result.reason}."


def attempt_message(furniture: Furniture, attempt: Attempt) -> str:
    """Return a description of one attempted action and its result, in Markdown."""
    u, v, k, l, *_ = attempt.action  # noqa: E741
    what = f"**{plain(furniture.parts[u].name)}** ({k}) onto **{plain(furniture.parts[v].name)}** ({l})"
    cost = f"{attempt.planning_steps:,} states checked in {1e3 * attempt.planning_seconds:.0f} ms"
    if attempt.merged:
        return f"✓ {what}: joined; {cost}."
    stage = f" ({attempt.stage})" if attempt.stage else ""
    explanation = _EXPLANATIONS[attempt.verdict]
    return (
        f"✗ {what}: *{verdict_name(attempt)}*{stage}; {cost}. {explanation} Nothing moved. "
        "In training, the episode would end here."
    )


def failure_notice(furniture: Furniture, attempt: Attempt) -> tuple[str, str]:
    """Return the headline and the text of a message about a failed action, in plain text."""
    u, v, *_ = attempt.action
    stage = f"It failed at: {attempt.stage}. " if attempt.stage else ""
    headline = f"{readable(furniture.parts[u].name)} onto {readable(furniture.parts[v].name)}: {verdict_name(attempt)}"
    return headline, f"{stage}{_EXPLANATIONS[attempt.verdict]} Nothing moved."


def verdict_name(attempt: Attempt) -> str:
    """Return the verdict of an attempt in words."""
    return attempt.verdict.replace("_", " ")


def readable(name: str) -> str:
    """Return the name of a part or of a piece in words."""
    return name.replace("_", " ").strip() or name


def title(name: str) -> str:
    """Return the name of a piece in words, with a capital letter: `Stool 0` for `stool-0`."""
    text = readable(name.replace("-", " "))
    return text[:1].upper() + text[1:]


def plain(text: str) -> str:
    """Return a text for Markdown that shows as it is. viser's page would execute HTML in it."""
    return "".join(f"&#{ord(c)};" if c in _SPECIAL else c for c in text)


_SPECIAL = frozenset("\\`*[]()<>!|&~\n\r\t")
