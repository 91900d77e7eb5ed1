"""Verdicts of full steps: how a step ended, and the stage and robot that failed."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

ROBOT_NAMES = ("R_a", "R_b")
"""Names of robots 0 and 1, as in the paper."""


class FullVerdict(StrEnum):
    """Verdict on a full step. Everything but `MERGED` ends the episode."""

    MERGED = "merged"
    NOT_AN_ACTION = "not_an_action"
    """A part, point or grasp does not exist, a point is not free, or both parts are in one group: masked out."""
    WRONG_PAIR = "wrong_pair"
    GRASP_BLOCKED = "grasp_blocked"
    """The rest of the group is in the way of the hand that comes to the part."""
    JOINT_BLOCKED = "joint_blocked"
    """The groups or the hands collide at the joint, or on every way into it of one or two straight motions."""
    CANNOT_RELEASE = "cannot_release"
    """The hand of R_a, or of R_b once R_a is gone, cannot leave the merged group."""
    NO_ARM_SOLUTION = "no_arm_solution"
    """No configuration has the hand at its pose without a collision."""
    NO_PATH = "no_path"
    """The planner found no path within its budget."""
    NO_PLACEMENT = "no_placement"
    """No post can carry the merged group, or there is no room for it."""


class Stage(StrEnum):
    """Stages of a full step, in their order. Each is a motion of one robot, but for `GRASP`."""

    MAKE_WAY = "make_way"
    """An empty robot that stands in the way drives elsewhere."""
    DRIVE_TO_GROUP = "drive_to_group"
    GRASP = "grasp"
    """Choice of the configuration that has the hand at the grasp."""
    APPROACH = "approach"
    """The open hand comes straight to the grasp."""
    LIFT = "lift"
    """The hand lifts the group straight off its post."""
    DRIVE_TO_MATE = "drive_to_mate"
    """A robot drives with its group to where both groups mate."""
    MATE = "mate"
    """R_a brings its group straight to the group of R_b."""
    RELEASE = "release"
    """The hand has opened and goes straight back."""
    LEAVE = "leave"
    """The empty robot folds its arm and drives away."""
    CARRY = "carry"
    """A robot carries a group to above the place where it will stand."""
    SET_DOWN = "set_down"
    """The hand lowers the group straight onto its post or onto the floor."""


AFTER_MATING = frozenset({Stage.RELEASE, Stage.LEAVE, Stage.CARRY, Stage.SET_DOWN})
"""Stages that follow the mating."""
PICKING = frozenset({Stage.DRIVE_TO_GROUP, Stage.GRASP, Stage.APPROACH, Stage.LIFT})
"""Stages in which a robot picks a group from its post."""
STRAIGHT = frozenset({Stage.APPROACH, Stage.LIFT, Stage.MATE, Stage.RELEASE, Stage.SET_DOWN})
"""Stages in which the hand moves along a straight line close to other things."""


_COARSE_KINDS = {
    FullVerdict.WRONG_PAIR: "wrong pair", FullVerdict.GRASP_BLOCKED: "grasp blocked",
    FullVerdict.CANNOT_RELEASE: "cannot release", FullVerdict.NO_ARM_SOLUTION: "no arm solution",
    FullVerdict.JOINT_BLOCKED: "mating path", FullVerdict.NO_PLACEMENT: "placing",
}  # fmt: skip
"""Coarse kind of failure of each verdict."""


def coarse_kind(verdict: str, stage: str) -> str:
    """Return the coarse kind of a failure, for reports: the verdict itself, in words, if it is of no known kind.

    Args:
        verdict: how the step ended, or the execution.
        stage: stage that failed; empty if none did.
    """
    if verdict == FullVerdict.NO_PATH:
        return "placing" if stage in AFTER_MATING else "path"
    return next((kind for known, kind in _COARSE_KINDS.items() if verdict == known), verdict.replace("_", " "))


def stage_text(stage: Stage, robot: int | None = None) -> str:
    """Return a stage in words, such as `R_a: drive to group`.

    Args:
        stage: what is done.
        robot: 0 or 1; None if the stage concerns both.
    """
    text = stage.value.replace("_", " ")
    return text if robot is None else f"{ROBOT_NAMES[robot]}: {text}"


@dataclass(frozen=True)
class Failure:
    """Why a step, or a part of it, cannot be done."""

    kind: FullVerdict
    stage: Stage | None = None
    """Stage that failed; None if the action itself is wrong."""
    robot: int | None = None
    """Robot that failed; None if it is both or neither."""
    final: bool = field(default=False, compare=False)
    """Whether no other attempt at the step can succeed."""
    states: int = field(default=0, compare=False)
    """Configurations tested for collision until it failed."""

    @property
    def stage_text(self) -> str:
        """Stage and robot in words; empty if no stage failed."""
        return "" if self.stage is None else stage_text(self.stage, self.robot)
