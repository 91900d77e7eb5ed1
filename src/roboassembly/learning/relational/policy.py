"""The relational network as a policy: values of all actions, and on request a beam search over expected merges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from roboassembly.envs.observation import Observation
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.augmentation import AUGMENTATIONS
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS
from roboassembly.learning.layers import Params, sigmoid
from roboassembly.learning.policy import Mask, Pair, Values, surest
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.features import sunk
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.features import grasp_features
from roboassembly.learning.relational.joining_order import locks_out
from roboassembly.learning.relational.layout_search import BEAM_WIDTH, LayoutProblem, find_layouts
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import GroupedPoints, TokenCache, Tokens, tokens_of
from roboassembly.parallel.threads import one_blas_thread
from roboassembly.task.part_frames import FramesName
from roboassembly.task.setting import SettingName

GRASP_PARAMS, FULL_PARAMS = "grasps", "full"
"""Names in a checkpoint of the weights of the grasp network, and of those that value pairs in the full setting."""
_FULL_MASK_AXES = 6
"""Number of axes of a mask of actions in the full setting."""
_DECIMALS = 3
"""Decimals to which logits are rounded."""
_MAX_CANDIDATES = 400
"""Number of best actions among which those of different groups are looked for."""
_MAX_GRASPED_PAIRS = 12
"""Number of best pairs whose grasps are valued."""
_ENOUGH_ACTIONS, _CLOSE = 5, 0.03
"""Number of actions whose log-probability reaches the next pair's within a margin, from which on it is skipped."""
_HOPELESS = -20.0
"""Log-probability of finishing where no action is left."""
_OUTSIDE_PENALTY = 15.0
"""Number subtracted from the logits of pairs that are in none of the layouts that were found."""
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
    beam_width: int = 1
    """Number of action sequences that `act` compares; below 2, it takes the best action. With the weights of this
    package, a beam of 4 assembles as many chairs as none, in twice the time."""
    beam_depth: int = 1
    """Number of merges in each of these sequences."""
    grasp_params: Params | None = None
    """Weights of `grasps.network`; without them, the policy works in the object-centric setting only."""
    full_params: Params | None = None
    """Weights of `network` for the full setting; `params` if None."""
    frames: FramesName = "aligned"
    """Frames in which the observations describe parts."""
    layout_width: int = BEAM_WIDTH
    """Number of layouts in the beam search before each decision; none is looked for if 0, nor with robots."""
    cache: TokenCache = field(default_factory=TokenCache, repr=False)
    """Geometry of earlier states."""

    @property
    def settings(self) -> tuple[SettingName, ...]:
        """Settings that the policy works in."""
        return ("object-centric",) if self.grasp_params is None else ("object-centric", "full")

    def with_frames(self, frames: FramesName) -> RelationalPolicy:
        """Return the policy for observations in some frames."""
        return self if frames == self.frames else replace(self, frames=frames, cache=TokenCache())

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
        with_grasps = expected | relational.init_grasp_inputs(np.random.default_rng(0), config)
        params = {name: array for name, array in loaded.params.items() if name not in (GRASP_PARAMS, FULL_PARAMS)}
        grasp_params, full_params = loaded.params.get(GRASP_PARAMS), loaded.params.get(FULL_PARAMS)
        grasp_net = grasping.init(np.random.default_rng(0))
        for found, like in ((params, expected), (full_params, with_grasps), (grasp_params, grasp_net)):
            if found is not None:
                checkpoint.check_arrays(found, like, where)
        return RelationalPolicy(params, where, grasp_params=grasp_params, full_params=full_params)

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """Return the action of the greatest value.

        With a beam, in the object-centric setting, it is the first of the action sequence after which the furniture can
        most probably be finished.

        Raises:
            InputError: no action exists, or the mask has grasps and the policy has no grasp network.
        """
        if mask.ndim == _FULL_MASK_AXES:
            return surest(self._full_values(observation, mask, 1))
        with one_blas_thread():
            view = PolicyView.from_observation(observation, mask, self.frames)
            values = self.pair_values(view)
            return surest(values) if self.beam_width < 2 else self._beam_search(_Sequence(view, values))

    def values(self, observation: Observation, mask: Mask) -> Values:
        """Return logits of the probabilities of actions, in the full setting their logarithms.

        The values of actions that do not exist are -inf.

        Raises:
            InputError: the mask has grasps and the policy has no grasp network.
        """
        if mask.ndim == _FULL_MASK_AXES:
            return self._full_values(observation, mask, _ENOUGH_ACTIONS)
        with one_blas_thread():
            return self.pair_values(PolicyView.from_observation(observation, mask, self.frames))

    def revised_values(self, observation: Observation, mask: Mask, wrong: Sequence[Pair]) -> Values:
        """Return values as `values` does; no layout has one of the wrong pairs."""
        if mask.ndim == _FULL_MASK_AXES:
            return self.values(observation, mask)
        with one_blas_thread():
            return self.pair_values(PolicyView.from_observation(observation, mask, self.frames), wrong=wrong)

    def _full_values(self, observation: Observation, mask: Mask, enough: int) -> Values:
        """Return the values of the full setting; see `_grasp_values`.

        Raises:
            InputError: the policy has no grasp network.
        """
        if self.grasp_params is None:
            raise InputError(f"the policy '{self.name}' has no grasp network; use --setting object-centric")
        # Layouts know nothing of hands: with them, fewer chairs are finished.
        params = self.params if self.full_params is None else self.full_params
        policy = replace(self, params=params, layout_width=0)
        with one_blas_thread():
            view = PolicyView.from_observation(observation, mask, self.frames)
            return policy._grasp_values(view, self.grasp_params, mask, enough)

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Return for each action the probability that the furniture can be finished after it."""
        values = self.values(observation, mask)
        return np.exp(values) if mask.ndim == _FULL_MASK_AXES else sigmoid(values)

    def pair_values(self, view: PolicyView, grouped: GroupedPoints | None = None, wrong: Sequence[Pair] = ()) -> Values:
        """Return the logits of all object-centric actions; -inf where an action does not exist.

        Args:
            view: the state.
            grouped: free points of the state, if they are known.
            wrong: pairs that are known to be wrong.
        """
        out = np.full(view.action_shape, -np.inf, np.float32)
        with_grasps = "grasp" in self.params
        tokens = tokens_of(view, self.cache, grasps=with_grasps, grouped=grouped)
        if len(tokens.part):
            u, k = tokens.part[:, None], tokens.point[:, None]
            v, l = tokens.part[None], tokens.point[None]  # noqa: E741
            # Rounding errors must not choose between equal parts, nor between action sequences.
            fits, q = relational.judged(self.params, tokens, AUGMENTATIONS[: self.augmentations])
            fits, q = np.round(fits, _DECIMALS), np.round(q, _DECIMALS)
            for pair in wrong:
                here, there = (_alike(tokens, *end) for end in (pair[::2], pair[1::2]))
                fits[here[:, None] & there] = fits[there[:, None] & here] = -np.inf
            layouts = find_layouts(layout_problem(tokens, fits), self.layout_width) if self.layout_width else []
            if layouts:
                placed, unlocked = set[tuple[int, int]](), set[tuple[int, int]]()
                for layout in layouts:
                    placed |= layout.placed_by
                    unlocked |= layout.placed_by - locks_out(tokens, layout)
                q[~_both_ways(placed, fits.shape)] -= _OUTSIDE_PENALTY
                q[_both_ways(placed - unlocked, fits.shape)] -= _LOCKING_PENALTY
            if not with_grasps:
                q[sunk(tokens.bounds)] -= _SINKING_PENALTY
            out[u, v, k, l] = q
        return out

    def _beam_search(self, start: _Sequence) -> Int[np.ndarray, "5"]:
        """First action of the best of `beam_width` sequences of `beam_depth` merges."""
        beam = [start]
        for _ in range(self.beam_depth - 1):
            beam = [self._extended(step) for step in self._next_steps(beam)] or beam
        chosen, best = None, -np.inf
        finish: dict[tuple[bytes, ...], float] = {}
        for step in self._next_steps(beam):
            # No sequence is more probable than its merges, so the rest cannot be better.
            if chosen is not None and step.log_probability <= best:
                break
            log_total = step.log_probability + self._log_finish(step.view_after, finish)
            if chosen is None or log_total > best:
                chosen, best = step.first, log_total
        # Nothing is left to merge only where the beam is already longer than the assembly.
        chosen = chosen or max(beam, key=lambda s: s.log_probability + self._log_finish(s.view, finish)).first
        return surest(start.values) if chosen is None else np.array(chosen)

    def _next_steps(self, beam: list[_Sequence]) -> list[_Step]:
        """Return the most probable actions after some sequences, `beam_width` at most, the most probable first."""
        steps: dict[frozenset[_Mate], _Step] = {}
        for sequence in beam:
            for action in _candidates(sequence.values, sequence.view.group, self.beam_width):
                log_probability = sequence.log_probability + _log_sigmoid(float(sequence.values[action]))
                step = _Step(sequence, action, log_probability)
                # The same merges in another order are the same sequence.
                if step.mates not in steps or log_probability > steps[step.mates].log_probability:
                    steps[step.mates] = step
        return sorted(steps.values(), key=lambda step: -step.log_probability)[: self.beam_width]

    def _extended(self, step: _Step) -> _Sequence:
        """Return the sequence with one more action."""
        after = step.view_after
        return _Sequence(after, self.pair_values(after), step.first, step.log_probability, step.mates)

    def _log_finish(self, view: PolicyView, known: dict[tuple[bytes, ...], float]) -> float:
        """Return the log-probability that the furniture can be finished from a state; 0 where it is finished.

        Args:
            view: the state.
            known: results by the state's groups, extended here. It spares the same merge of another of some equal
                parts; a caller keeps it for one decision only, because states are equal but for rounding.
        """
        grouped = GroupedPoints.of_view(view, self.cache, grasps="grasp" in self.params)
        key = grouped.state_key
        if key not in known:
            best = float(self.pair_values(view, grouped).max(initial=-np.inf))
            known[key] = _log_sigmoid(best) if best > -np.inf else (0.0 if view.complete else -np.inf)
        return known[key]

    def _grasp_values(self, view: PolicyView, grasp_params: Params, mask: Mask, enough: int) -> Values:
        """Log-probabilities of actions with grasps.

        An action works if its pair is viable and if its grasps work; with a beam, a viable action must be left
        afterwards, too. Grasps are valued for the best pairs only.

        Args:
            view: the state.
            grasp_params: weights of `grasps.network`.
            mask: actions that exist.
            enough: number of best actions after which pairs that are not much better are skipped.
        """
        values = self.pair_values(view)
        pairs = -np.logaddexp(0.0, -values.max(axis=-1))
        if self.beam_width > 1:
            pairs = self._with_log_finish(view, values, pairs)
        out = np.where(mask, pairs[..., None, None] + _UNKNOWN_GRASPS, -np.inf).astype(np.float32)
        flat = pairs.ravel()
        best = np.full(enough, -np.inf)
        order: list[int] = np.argsort(-flat, kind="stable")[:_MAX_GRASPED_PAIRS].tolist()
        for index in order:
            # No action is more probable than its pair.
            if flat[index] == -np.inf or best[0] > flat[index] - _CLOSE:
                break
            u, v, k, l = np.array(np.unravel_index(index, pairs.shape)).tolist()  # noqa: E741
            grasps = grasping.log_probability(grasp_params, grasp_features(view, u, k, v, l))
            out[u, v, k, l] = np.where(mask[u, v, k, l], flat[index] + grasps, -np.inf)
            best = np.sort([*best, *out[u, v, k, l].ravel()])[-enough:]
        return np.round(out, _DECIMALS)

    def _with_log_finish(
        self, view: PolicyView, values: Values, pairs: Float[np.ndarray, "P P K K"]
    ) -> Float[np.ndarray, "P P K K"]:
        """Log-probabilities of pairs, plus that of finishing after the best merge of their two groups."""
        group = view.group
        log_finish: dict[tuple[int, int], float] = {}
        known: dict[tuple[bytes, ...], float] = {}
        for action in _candidates(values, group, self.beam_width):
            after = _Step(_Sequence(view, values), action, 0.0).view_after
            u_group, v_group = sorted((int(group[action[0]]), int(group[action[1]])))
            log_finish[u_group, v_group] = max(self._log_finish(after, known), _HOPELESS)
        # All other groups are worse, so nothing is computed for them.
        out = pairs + min(log_finish.values(), default=0.0)
        for (u_group, v_group), finish in log_finish.items():
            here: Bool[np.ndarray, "P P"] = np.isin(group, u_group)[:, None] & np.isin(group, v_group)[None]
            out = np.where((here | here.T)[..., None, None], pairs + finish, out)
        return out


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


def layout_problem(tokens: Tokens, fits: Float32[np.ndarray, "n n"]) -> LayoutProblem:
    """Return the problem of laying out the groups of a state.

    Args:
        tokens: the state.
        fits: logit of whether each pair fits; -inf within a group.
    """
    # A pair fits whichever of its groups moves.
    logit = 0.5 * (fits + fits.T).astype(float)
    return LayoutProblem(
        tokens.group, tokens.position.astype(float), tokens.frame.astype(float), np.logaddexp(0.0, -logit), tokens.types
    )


_Mate = frozenset[tuple[int, int]]
"""Two mated points, each as its part and its number."""


@dataclass(frozen=True, eq=False)
class _Sequence:
    """A sequence of merges, and the state that it should lead to."""

    view: PolicyView
    values: Values
    """Values of the actions in this state."""
    first: tuple[int, ...] | None = None
    """First action of the sequence."""
    log_probability: float = 0.0
    """Log-probability that all merges are viable."""
    mates: frozenset[_Mate] = frozenset()


@dataclass(frozen=True, eq=False)
class _Step:
    """One more action after a sequence."""

    before: _Sequence
    action: tuple[int, ...]
    log_probability: float
    """Log-probability that all merges are viable, this one included."""

    @property
    def first(self) -> tuple[int, ...]:
        """First action of the longer sequence."""
        return self.before.first or self.action

    @property
    def mates(self) -> frozenset[_Mate]:
        """Mates of the longer sequence."""
        u, v, k, l, _ = self.action  # noqa: E741
        return self.before.mates | {frozenset(((u, k), (v, l)))}

    @property
    def view_after(self) -> PolicyView:
        """Expected state after the action."""
        u, v, k, l, _ = self.action  # noqa: E741
        return self.before.view.after_merge(u, k, v, l)


def _candidates(values: Values, group: Int[np.ndarray, "P"], count: int) -> list[tuple[int, ...]]:
    """Best action of each two groups, the best `count` of them in order."""
    # Few of all actions exist; of equal ones the first counts, on every machine.
    exist = np.flatnonzero(values > -np.inf)
    order: list[int] = exist[np.argsort(-values.ravel()[exist], kind="stable")[:_MAX_CANDIDATES]].tolist()
    out: dict[frozenset[int], tuple[int, ...]] = {}
    for flat in order:
        if len(out) == count:
            break
        action: tuple[int, ...] = tuple(np.array(np.unravel_index(flat, values.shape)).tolist())
        out.setdefault(frozenset((int(group[action[0]]), int(group[action[1]]))), action)
    return list(out.values())


def _log_sigmoid(logit: float) -> float:
    return float(-np.logaddexp(0.0, -logit))
