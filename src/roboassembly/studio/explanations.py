"""Explanations of an action's components, shown where they are chosen."""

from __future__ import annotations

from collections.abc import Sequence

UP_AXES = (
    "+z up, as when finished", "−z up, upside down", "+x up, on a side", "−x up, on a side", "+y up, on a side",
    "−y up, on a side",
)  # fmt: skip
"""Label of each `w`: the axis of the assembled furniture that points up."""
_W_HINT = (
    "The pose of the group that waits: which axis of the finished piece points up while the other group comes. "
    "The green arrow on the part shows it. Try another one if the joint is too low or its way is blocked."
)
_GRASP_HINT = (
    "Where robot {robot} holds the part that {does}: one of two places for the fingers, and one of four directions for "
    "the hand. Purple lines on the part show it. Try another one if the hand is in the way."
)


def hint_of(name: str) -> str:
    """Return the explanation of a component: `w`, `g_a` or `g_b`."""
    if name == "w":
        return _W_HINT
    return _GRASP_HINT.format(robot=f"R_{name[-1]}", does="moves" if name == "g_a" else "waits")


def label_of(name: str) -> str:
    """Return the label of a component: `w`, `g_a` or `g_b`."""
    return "Pose while waiting (w)" if name == "w" else f"Grasp of R_{name[-1]} ({name})"


def options_of(name: str, count: int) -> tuple[str, ...]:
    """Return the texts of a component's values; each begins with the value."""
    if name == "w":
        return tuple(f"{i}: {axis}" for i, axis in enumerate(UP_AXES))
    return tuple(f"{i}: place {i // 4 + 1}, hand from side {i % 4 + 1}" for i in range(count))


def explanation_of(names: Sequence[str], chosen: tuple[bool, bool]) -> str:
    """Return what to do next with the form, in Markdown.

    Args:
        names: components after the points: `w`, or `g_a` and `g_b`.
        chosen: whether a point of the moving part, and one of the waiting part, is chosen.
    """
    if not chosen[0]:
        return "**1.** Click a blue dot of the part that should **move**. Orange marks it."
    if not chosen[1]:
        return "**2.** Click a blue dot of the part that should **wait** for it. Green marks it."
    if names == ["w"]:
        return "**3.** Choose how the green part waits: the arrow points up while the other one comes. Then *Join*."
    return "**3.** Choose where the robots hold the parts: purple lines show the hands. Then *Join*."
