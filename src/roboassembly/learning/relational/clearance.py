"""Room for hands at connection points: what the network that values pairs is told of `g_a` and `g_b`.

Late in an assembly no hand may reach the place where the next parts meet, and no merge can be undone. Which grasps of a
part its own group still leaves free, and which of them would meet the other group at the joint, follows from the clouds
as in `hands`; here it is told of all free points and of all pairs of them, more coarsely.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float16, Float32

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.relational.grasps.features import (
    ARM_FAR,
    ARM_STRETCHES,
    FAR,
    NEAR,
    around,
    boxes,
    clearance,
    from_arm,
    widths,
)
from roboassembly.robots.gripper import MAX_OPENING, RETREAT
from roboassembly.task.full.cell import WIDER

HOLD, ROOM = 16, 4
"""Numbers that describe a grasp as a point sees it, and the grasps of one point's part at a pair."""
MIRRORED = np.where(np.isin(np.arange(HOLD), (1, 4)), -1, 1).astype(np.float16)
"""By what a mirror multiplies what describes a grasp: what lies along the tangent of the other side changes sign."""
_EVERY = 2
"""Of how many points of a cloud one is looked at."""
MET = 480
"""Points of the other group that are looked at, at most."""


class Grasps:
    """The hands at one part, and how much room its group leaves them.

    Args:
        poses: of each grasp in the part's frame, translation and Euler angles; 0 where there is none.
        own: points of the part, in its group's frame.
        rest: points of the group's other parts.
        turn: `group_from_part`.
        shift: the same, metres.
    """

    def __init__(
        self, poses: Float[np.ndarray, "8 6"], own: Float[np.ndarray, "c 3"], rest: Float[np.ndarray, "m 3"],
        turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"],
    ) -> None:  # fmt: skip
        self.there: Bool[np.ndarray, "8"] = np.any(poses, axis=1)
        self.turn: Float[np.ndarray, "8 3 3"] = turn @ rotations_from_euler(poses[:, 3:])
        self.at: Float[np.ndarray, "8 3"] = poses[:, :3] @ turn.T + shift
        self.width: Float[np.ndarray, "8"] = widths(self.turn, self.at, own)
        self.clear = np.full((len(poses), 3), -FAR)
        """Metres to the part as the open hand comes, to the other parts then, and to these once it holds."""
        self.arm = np.zeros((len(poses), len(ARM_STRETCHES)))
        """Metres from wrist and forearm to the group."""
        wide = np.minimum(MAX_OPENING, self.width + WIDER)
        for g in np.flatnonzero(self.there).tolist():
            held, others = (around(self.turn[g], self.at[g], points[::_EVERY]) for points in (own, rest))
            self.clear[g] = (
                clearance(held, wide[g], RETREAT), clearance(others, wide[g], RETREAT), clearance(others, self.width[g])
            )  # fmt: skip
            whole = np.concatenate([held, others], axis=1)
            self.arm[g] = [from_arm(whole, *stretch) for stretch in ARM_STRETCHES]

    def seen_from(self, at: Float[np.ndarray, "3"], frame: Float[np.ndarray, "3 3"]) -> Float16[np.ndarray, "8 16"]:
        """The hands in the frame of a connection point of the part, which is given in the group's frame."""
        told = np.concatenate(
            [
                4.0 * (self.at - at) @ frame,
                self.turn[:, :, 2] @ frame,
                np.abs(self.turn[:, :, 1] @ frame),
                np.tanh(self.clear / NEAR),
                self.clear[:, 1:2] / FAR,
                self.arm / ARM_FAR,
                self.there[:, None],
            ],
            axis=1,
        )
        return np.where(self.there[:, None], told, 0.0).astype(np.float16)

    def room(
        self, turn: Float[np.ndarray, "l 3 3"], shift: Float[np.ndarray, "l 3"], met: Float[np.ndarray, "n 3"]
    ) -> Float16[np.ndarray, "l 4"]:
        """How much room the hands have at some joints: the best of them has, the second best, what share has any, and
        the best one by the other group alone.

        Args:
            turn: `other_from_group`, once joined, of each joint.
            shift: the same, metres.
            met: points of the other group, in its frame.
        """
        here = np.einsum("lni,lij->jln", met[None] - shift[:, None], turn).astype(np.float32)
        flat = here.reshape(3, -1)
        nearest = np.full((len(self.there), len(turn)), -FAR)
        for g in np.flatnonzero(self.there).tolist():
            local = self.turn[g].T.astype(np.float32) @ (flat - self.at[g].astype(np.float32)[:, None])
            outside = _outside(local, self.width[g]).reshape(len(turn), -1)
            nearest[g] = np.minimum(outside.min(axis=1), FAR)
        own = self.clear.min(axis=1)
        both = np.sort(np.minimum(nearest, own[:, None]), axis=0)
        told = [both[-1], both[-2], nearest.max(axis=0)]
        share = (both > 0.0).mean(axis=0)
        return np.stack([*(np.tanh(x / NEAR) for x in told), share], axis=1).astype(np.float16)


def _outside(points: Float32[np.ndarray, "3 n"], opening: float) -> Float32[np.ndarray, "n"]:
    """Metres from each point, in the frame of a hand's tips, to the boxes around palm and fingers; negative inside."""
    out = np.full(points.shape[1], np.inf, np.float32)
    for low, high, opens in zip(*boxes(), strict=True):
        beside = None
        middle, half = 0.5 * (low + high) + opening * opens, 0.5 * (high - low)
        # One axis after the other: NumPy takes five times as long over short last axes.
        for axis in range(3):
            along = np.abs(points[axis] - np.float32(middle[axis])) - np.float32(half[axis])
            beside = along if beside is None else np.maximum(beside, along, out=beside)
        assert beside is not None
        np.minimum(out, beside, out=out)
    return out
