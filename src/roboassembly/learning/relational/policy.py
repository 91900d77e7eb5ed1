"""The relational network as a policy: values of all actions, and with robots a lookahead over expected merges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roboassembly.envs.observation import Observation
from roboassembly.errors import InputError
from roboassembly.geometry.meshes import Mesh
from roboassembly.learning import checkpoint
from roboassembly.learning.augmentation import AUGMENTATIONS
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS
from roboassembly.learning.layers import Params, sigmoid
from roboassembly.learning.policy import Mask, Pair, Values, surest
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.features import sunk
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.lookahead import (
    CLOSE,
    MAX_GRASPED_PAIRS,
    ForeseenMerges,
    GraspValues,
    RankedActions,
)
from roboassembly.learning.relational.joining_order import locks_out
from roboassembly.learning.relational.layout_search import BEAM_WIDTH, LayoutProblem, find_layouts
from roboassembly.learning.relational.mesh_tests import GroupMeshes, PartMeshes
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import TokenCache, Tokens, group_meshes_of, tokens_of
from roboassembly.parallel.threads import one_blas_thread
from roboassembly.task.part_frames import FramesName
from roboassembly.task.setting import SettingName

GRASP_PARAMS = "grasps"
"""Name in a checkpoint of the weights of the grasp network."""
_FULL_MASK_AXES = 6
"""Number of axes of a mask of actions in the full setting."""
_DECIMALS = 3
"""Decimals to which logits are rounded."""
_ENOUGH_ACTIONS = 5
"""Number of actions whose log-probability reaches the next pair's within `CLOSE`, from which on it is skipped."""
_OUTSIDE_PENALTY = 15.0
"""Number subtracted from the logits of pairs that are in none of the layouts that were found."""
_OUTSIDE_DOUBTFUL_PENALTY = 4.0
"""The same where the layouts are doubtful."""
_LOCKING_PENALTY = 4.0
"""Number subtracted from the logits of pairs that seem to lock a group out in all layouts that they are in."""
_SINKING_PENALTY = 10.0
"""Number subtracted from the logits of actions after which the moving group would reach into the ground."""
_UNKNOWN_GRASPS = -8.0
"""Log-probability of grasps that are not valued."""


@dataclass(frozen=True, eq=False)
class RelationalPolicy:
    """The relational network on NumPy; it takes the action that most probably leads to the finished furniture."""

    params: Params
    """Weights of `network`."""
    name: str = relational.KIND
    """Name of the policy in reports."""
    cloud_points: int = CLOUD_POINTS
    """Number of points of each part's cloud in the observations."""
    augmentations: int = 1
    """Number of augmentations over which values are averaged, 8 at most; more are more accurate and take longer."""
    lookahead: int = 60
    """Largest number of expected states that `act` looks at with robots before it takes the best action instead."""
    grasp_params: Params | None = None
    """Weights of `grasps.network`; without them, the policy works in the object-centric setting only."""
    frames: FramesName = "aligned"
    """Frames in which the observations describe parts."""
    layout_width: int = BEAM_WIDTH
    """Number of layouts in the beam search before each decision; none is looked for if 0."""
    meshes: PartMeshes | None = None
    """Meshes of the parts, if they are known."""
    cache: TokenCache = field(default_factory=TokenCache, repr=False)
    """Geometry of earlier states."""
    foreseen: ForeseenMerges = field(default_factory=ForeseenMerges, repr=False)
    """Merges that `act` foresaw in the last state, with robots."""

    @property
    def settings(self) -> tuple[SettingName, ...]:
        """Settings that the policy works in."""
        return ("object-centric",) if self.grasp_params is None else ("object-centric", "full")

    def with_meshes(self, meshes: Sequence[Mesh]) -> RelationalPolicy:
        """Return the policy for parts whose meshes are known, in the frames in which observations describe them.

        It then looks for layouts in which no parts overlap, and tells by the meshes which merge locks others out.
        """
        return replace(self, meshes=PartMeshes(meshes), cache=TokenCache(), foreseen=ForeseenMerges())

    def with_frames(self, frames: FramesName) -> RelationalPolicy:
        """Return the policy for observations in some frames."""
        return (
            self
            if frames == self.frames
            else replace(self, frames=frames, cache=TokenCache(), foreseen=ForeseenMerges())
        )

    @staticmethod
    def from_checkpoint(loaded: Checkpoint, where: str) -> RelationalPolicy:
        """Make the policy of a checkpoint.

        Args:
            loaded: checkpoint of kind `relational`.
            where: the file, for messages and reports.

        Raises:
            InputError: configuration and arrays do not fit each other.
        """
        config = checkpoint.network_config(relational.RelationalConfig(), loaded.config.get("network"), where)
        if config.token % config.heads:
            raise InputError(f"'{where}': {config.heads} heads do not divide tokens of {config.token}; they must")
        expected = relational.init(np.random.default_rng(0), config)
        params = {name: array for name, array in loaded.params.items() if name != GRASP_PARAMS}
        checkpoint.check_arrays(params, expected, where)
        grasp_params = loaded.params.get(GRASP_PARAMS)
        if grasp_params is not None:
            checkpoint.check_arrays(grasp_params, grasping.init(np.random.default_rng(0)), where)
        return RelationalPolicy(params, where, grasp_params=grasp_params)

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """Return the action of the greatest value.

        With robots, it is the one of the greatest value after which the policy foresees a way to the finished
        furniture. Where the last action had the expected result and the same merge is best, the policy does not look
        ahead again.

        Raises:
            InputError: no action exists, or the mask has grasps and the policy has no grasp network.
        """
        with one_blas_thread():
            if mask.ndim == _FULL_MASK_AXES:
                return self._act_for_robots(observation, mask)
            return surest(self.pair_values(PolicyView.from_observation(observation, mask, self.frames)))

    def values(self, observation: Observation, mask: Mask) -> Values:
        """Return logits of the probabilities of actions, in the full setting their logarithms.

        The values of actions that do not exist are -inf.

        Raises:
            InputError: the mask has grasps and the policy has no grasp network.
        """
        with one_blas_thread():
            view = PolicyView.from_observation(observation, mask, self.frames)
            if mask.ndim == _FULL_MASK_AXES:
                return self._full_values(view, mask, _ENOUGH_ACTIONS)
            return self.pair_values(view)

    def revised_values(self, observation: Observation, mask: Mask, wrong: Sequence[Pair]) -> Values:
        """Return values as `values` does; no layout has one of the wrong pairs."""
        if mask.ndim == _FULL_MASK_AXES:
            return self.values(observation, mask)
        with one_blas_thread():
            return self.pair_values(PolicyView.from_observation(observation, mask, self.frames), wrong=wrong)

    @property
    def _grasp_weights(self) -> Params:
        """Weights of the grasp network.

        Raises:
            InputError: the policy has none.
        """
        if self.grasp_params is None:
            raise InputError(f"the policy '{self.name}' has no grasp network; use --setting object-centric")
        return self.grasp_params

    def _act_for_robots(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        view = PolicyView.from_observation(observation, mask, self.frames)
        if not self.lookahead:
            return surest(self._full_values(view, mask, 1))
        rank = partial(self._ranked, grasp_values=GraspValues(self._grasp_weights))
        start = rank(view)
        choice = self.foreseen.next(start, rank, self.lookahead)
        if choice is not None and mask[choice.action]:
            action = np.array(choice.action)
        else:
            action = surest(self._full_values(view, mask, 1, start.pairs))
        self.foreseen.expect(view, action.tolist())
        return action

    def _ranked(self, view: PolicyView, grasp_values: GraspValues) -> RankedActions:
        return RankedActions(view, self._log_pairs(view), grasp_values)

    def _log_pairs(self, view: PolicyView) -> Float[np.ndarray, "P P K K"]:
        """Return the log-probability that each pair is viable; -inf where it does not exist."""
        return -np.logaddexp(0.0, -self.pair_values(view).max(axis=-1))

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Return for each action the probability that the furniture can be finished after it."""
        values = self.values(observation, mask)
        return np.exp(values) if mask.ndim == _FULL_MASK_AXES else sigmoid(values)

    def pair_values(self, view: PolicyView, wrong: Sequence[Pair] = ()) -> Values:
        """Return the logits of all object-centric actions; -inf where an action does not exist.

        Args:
            view: the state.
            wrong: pairs that are known to be wrong.
        """
        out = np.full(view.action_shape, -np.inf, np.float32)
        tokens = tokens_of(view, self.cache)
        if len(tokens.part):
            u, k = tokens.part[:, None], tokens.point[:, None]
            v, l = tokens.part[None], tokens.point[None]  # noqa: E741
            # Rounding errors must not choose between equal parts, nor between action sequences.
            fits, q = relational.judged(self.params, tokens, AUGMENTATIONS[: self.augmentations])
            fits, q = np.round(fits, _DECIMALS), np.round(q, _DECIMALS)
            for pair in wrong:
                here, there = (_alike(tokens, *end) for end in (pair[::2], pair[1::2]))
                fits[here[:, None] & there] = fits[there[:, None] & here] = -np.inf
            meshes = None if self.meshes is None else group_meshes_of(view, self.meshes, self.cache)
            problem = layout_problem(tokens, fits, meshes)
            layouts = find_layouts(problem, self.layout_width) if self.layout_width else []
            if layouts:
                placed, unlocked = set[tuple[int, int]](), set[tuple[int, int]]()
                for layout in layouts:
                    placed |= layout.placed_by
                    unlocked |= layout.placed_by - locks_out(tokens, layout, meshes)
                outside = _OUTSIDE_DOUBTFUL_PENALTY if layouts[0].doubtful else _OUTSIDE_PENALTY
                q[~_both_ways(placed, fits.shape)] -= outside
                q[_both_ways(placed - unlocked, fits.shape)] -= _LOCKING_PENALTY
            q[sunk(tokens.bounds)] -= _SINKING_PENALTY
            out[u, v, k, l] = q
        return out

    def _full_values(
        self, view: PolicyView, mask: Mask, enough: int, pairs: Float[np.ndarray, "P P K K"] | None = None
    ) -> Values:
        """Return the log-probability of actions with grasps.

        An action works if its pair is viable and if its grasps work. Grasps are valued for the best pairs only.

        Args:
            view: the state.
            mask: actions that exist.
            enough: number of best actions after which pairs that are not much better are skipped.
            pairs: log-probability of each pair, if it is known.
        """
        pairs = self._log_pairs(view) if pairs is None else pairs
        grasp_values = GraspValues(self._grasp_weights)
        out = np.where(mask, pairs[..., None, None] + _UNKNOWN_GRASPS, -np.inf).astype(np.float32)
        flat = pairs.ravel()
        best = np.full(enough, -np.inf)
        order: list[int] = np.argsort(-flat, kind="stable")[:MAX_GRASPED_PAIRS].tolist()
        for index in order:
            # No action is more probable than its pair.
            if flat[index] == -np.inf or best[0] > flat[index] - CLOSE:
                break
            u, v, k, l = np.array(np.unravel_index(index, pairs.shape)).tolist()  # noqa: E741
            grasps = grasp_values(view, u, v, k, l)
            out[u, v, k, l] = np.where(mask[u, v, k, l], flat[index] + grasps, -np.inf)
            best = np.sort([*best, *out[u, v, k, l].ravel()])[-enough:]
        return np.round(out, _DECIMALS)


def _both_ways(pairs: Iterable[tuple[int, int]], shape: tuple[int, ...]) -> Bool[np.ndarray, "n n"]:
    """Return a mask of some pairs, whichever point comes first."""
    out = np.zeros(shape, bool)
    for pair in pairs:
        out[pair] = out[pair[::-1]] = True
    return out


def _alike(tokens: Tokens, part: int, point: int) -> Bool[np.ndarray, "n"]:
    """Return which tokens are a point of a part, or the same point of a group that is alike."""
    types = np.array(tokens.types)[tokens.group]
    own = (tokens.part == part) & (tokens.point == point)
    first = int(np.argmax(own))
    return own | ((tokens.point == point) & (types == types[first]))


def layout_problem(
    tokens: Tokens, fits: Float32[np.ndarray, "n n"], meshes: GroupMeshes | None = None
) -> LayoutProblem:
    """Return the problem of laying out the groups of a state.

    Args:
        tokens: the state.
        fits: logit of whether each pair fits; -inf within a group.
        meshes: meshes of the groups, if they are known.
    """
    # A pair fits whichever of its groups moves.
    logit = 0.5 * (fits + fits.T).astype(float)
    return LayoutProblem(
        tokens.group, tokens.position.astype(float), tokens.frame.astype(float), np.logaddexp(0.0, -logit),
        tokens.types, meshes,
    )  # fmt: skip
