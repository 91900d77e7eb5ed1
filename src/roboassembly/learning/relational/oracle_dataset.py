"""Training samples of the relational policy: states of many pieces, with the oracle's label of every action.

An action is viable if the furniture can still be finished after it. It is not if its pair does not fit, if the groups
cannot mate, or if it leads into a dead end.

States come from episodes that never leave the path on which the furniture can be finished. Without a policy, the moves
are random viable ones. With a policy, its own actions are carried out as long as they are viable, and where it errs the
oracle corrects it (DAgger, Ross et al. 2011, "A Reduction of Imitation Learning and Structured Prediction").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import Furniture
from roboassembly.learning.datasets import LabeledState, SampleSet, structure_of
from roboassembly.learning.relational.tokens import Tokens, tokens_of_sample
from roboassembly.solvers.oracle import LabeledMate, Oracle
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.part_frames import principal_frames
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState

TokenPolicy = Callable[[Tokens], tuple[int, int, int]]
"""Picks an action: the tokens of the moving and of the waiting point, and `w`."""
_DEAD_END_SHARE = 0.5
"""Share of the states with an action into a dead end for which one dead end is labelled."""
_RESAMPLED_SEED = 20_251
"""Seed of the clouds with other points."""
_SAME_ROTATION = 0.02
"""Largest difference between the entries of two rotations that count as one."""


@dataclass(frozen=True, eq=False)
class LabeledEpisode:
    """An episode from loose parts to the finished furniture."""

    states: tuple[LabeledState, ...]
    """State before each merge."""
    dead_ends: tuple[LabeledState, ...]
    """Some dead ends, each one merge away from the episode."""
    mistakes: int
    """Number of actions of the policy that were not viable."""


class Labeler:
    """Labels the states of one piece of furniture, and rolls out episodes of it.

    Args:
        furniture: the piece.
        clouds: surface points of each part, as the policy sees them [m].
        oracle: oracle of the setting; the object-centric one if None.
    """

    def __init__(
        self, furniture: Furniture, clouds: Float32[np.ndarray, "P C 3"], oracle: Oracle | None = None
    ) -> None:
        self.oracle = oracle or Oracle(ObjectCentricTask(furniture))
        self._unique_parts = {c.members[0] for c in furniture.classes if len(c.members) == 1}
        # The paper's number of points at least, so that files of most pieces have arrays of one shape.
        self._observer = Observer(furniture, len(furniture.parts), furniture.padding[1], 1)
        grasps = None if self.oracle.grasp_task is None else self._observer.grasp_poses
        self._principal = principal_frames(furniture)
        rng = np.random.default_rng(_RESAMPLED_SEED)
        resampled = np.array([surface_points(part.mesh, clouds.shape[1], rng) for part in furniture.parts])
        self._empty = SampleSet(
            furniture.name, clouds, (), grasps, structure_of(furniture), self._principal.astype(np.float32), resampled
        )

    def sample_set(self, samples: Sequence[LabeledState], name: str = "") -> SampleSet:
        """Return labelled states as a data set, under the furniture's name or another one."""
        return replace(self._empty, name=name or self._empty.name, samples=tuple(samples))

    def label(self, state: TaskState, mates: Sequence[LabeledMate]) -> LabeledState:
        """Return a state as a policy sees it, labelled with the pairs that fit."""
        observation = self._observer.observe(state)
        rows = [(m.u, m.k, m.v, m.l, m.solvable, *m.feasible_w) for m in mates]
        free = self.oracle.task.free_points(state, *observation["connection_points"].shape[:2])
        return LabeledState(
            observation["connection_points"],
            observation["connections"],
            free,
            observation["poses"],
            np.array(rows, np.int16).reshape(-1, 5 + len(UP_AXES)),
            own_w=np.array([self._own_w(state, mate) for mate in mates], bool).reshape(-1, len(UP_AXES)),
        )

    def _own_w(self, state: TaskState, mate: LabeledMate) -> Bool[np.ndarray, "6"]:
        """Return whether a mate works with each of the principal axes of v's part up."""
        v_group = state.groups[state.group_of[mate.v]]
        frame_of_v = v_group.furniture_from_part[v_group.parts.index(mate.v)]
        turn = mate.merge.furniture_from_v.rotation @ frame_of_v.rotation @ self._principal[mate.v]
        return self.oracle.feasible_along(mate.moving, mate.waiting, UP_AXES @ turn.T)

    def rollout(self, rng: np.random.Generator, policy: TokenPolicy | None = None) -> LabeledEpisode:
        """Roll out one episode from loose parts to the finished furniture.

        Args:
            rng: draws the start, the dead ends, and viable actions where the policy errs or there is none.
            policy: chooses actions; those that are not viable are replaced.
        """
        state = self.oracle.task.initial_state(rng)
        states: list[LabeledState] = []
        dead_ends: list[LabeledState] = []
        mistakes = 0
        history: list[tuple[TaskState, list[LabeledMate], LabeledMate]] = []
        while not state.complete:
            mates = self.oracle.mates(state)
            viable = self._keeping_upright([m for m in mates if m.viable])
            if not viable:
                # Equal parts whose points differ: the slots alone do not show that this is a dead end. Undo one merge.
                if not history:
                    break
                state, mates, mate = history.pop()
                states.pop()
                mates = [replace(m, solvable=False) if m is mate else m for m in mates]
                viable = self._keeping_upright([m for m in mates if m.viable])
                if not viable:
                    break
                states.append(self.label(state, mates))
                mate = viable[rng.integers(len(viable))]
            else:
                states.append(self.label(state, mates))
                chosen = None if policy is None else self._chosen(policy, states[-1], viable)
                mistakes += policy is not None and chosen is None
                mate = chosen or viable[rng.integers(len(viable))]
            history.append((state, mates, mate))
            deadly = [m for m in self._keeping_upright(mates) if any(m.feasible_w) and not m.solvable]
            if deadly and rng.random() < _DEAD_END_SHARE:
                end = state.after_merge(deadly[rng.integers(len(deadly))].merge.merged)
                dead_ends.append(self.label(end, [replace(m, solvable=False) for m in self.oracle.mates(end)]))
            state = state.after_merge(mate.merge.merged)
        return LabeledEpisode(tuple(states), tuple(dead_ends), mistakes)

    def _keeping_upright(self, mates: list[LabeledMate]) -> list[LabeledMate]:
        """Mates that leave all parts of a unique shape standing as in the furniture's frame, if there are any.

        A symmetric part may be turned as well, but the parts' frames show how the furniture stands, so a policy has no
        reason to turn one.
        """

        def keeps(mate: LabeledMate) -> bool:
            merged = mate.merge.merged
            placed = zip(merged.parts, merged.furniture_from_part, strict=True)
            unique = [pose.rotation for part, pose in placed if part in self._unique_parts]
            return all(np.abs(r - unique[0]).max() <= _SAME_ROTATION for r in unique[1:])

        return [m for m in mates if keeps(m)] or mates

    def _chosen(self, policy: TokenPolicy, sample: LabeledState, viable: list[LabeledMate]) -> LabeledMate | None:
        """Mate that the policy chooses; None if it is not viable."""
        tokens = tokens_of_sample(self._empty, sample)
        row, column, w = policy(tokens)
        action = (tokens.part[row], tokens.point[row], tokens.part[column], tokens.point[column])
        return next((m for m in viable if (m.u, m.k, m.v, m.l) == action and m.feasible_w[w]), None)


def targets_of(
    tokens: Tokens, sample: LabeledState
) -> tuple[UInt8[np.ndarray, "n n"], UInt8[np.ndarray, "n n 6"]]:  # fmt: skip
    """Return which ordered pairs of tokens fit, and which actions are viable.

    Args:
        tokens: the state.
        sample: the same state with its labels.
    """
    n = len(tokens.part)
    index = np.full(sample.free.shape, -1)
    index[tokens.part, tokens.point] = np.arange(n)
    fits, viable = np.zeros((n, n), np.uint8), np.zeros((n, n, len(UP_AXES)), np.uint8)
    u, k, v, l, solvable = sample.mates[:, :5].T  # noqa: E741
    rows, columns = index[u, k], index[v, l]
    fits[rows, columns] = 1
    viable[rows, columns] = sample.mates[:, 5:] * solvable[:, None]
    return fits, viable
