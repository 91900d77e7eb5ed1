"""The relational network as a policy: values of all actions, and plans that it follows in imagination."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Int

from roboassembly.envs.observation import Observation
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.augmentation import AUGMENTATIONS
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS
from roboassembly.learning.layers import Params, sigmoid
from roboassembly.learning.policy import Mask, Values, surest
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.features import handling_of
from roboassembly.learning.relational.policy_view import Situation
from roboassembly.learning.relational.tokens import Memory, tokens_of
from roboassembly.task.setting import SettingName

HANDS, HELD = "hands", "held"
"""Under which names a checkpoint holds the weights of the network that chooses grasps, and of the one that values pairs
where hands have to join them."""
_WITH_GRASPS = 6
"""Dimensions of a mask of actions with two grasps."""
_DECIMALS = 3
"""Of logits that are told apart."""
_CONSIDERED = 400
"""Actions among which those of different groups are looked for."""
_HANDLED = 12
"""Right pairs, the surest ones, for which hands are looked for."""
_ENOUGH, _HARDLY = 5, 0.03
"""With so many actions of which the logarithms of their chances are less than this below what any hands could make of
the next pair, that one is not looked at."""
_HOPELESS = -20.0
"""Logarithm of the chance that is left where nothing can be joined any more."""
_UNHANDLED = -8.0
"""Logarithm of the chance of hands that nobody looked at."""


@dataclass(frozen=True, eq=False)
class RelationalPolicy:
    """The relational network, on NumPy; the surest choice first."""

    params: Params
    name: str = relational.KIND
    cloud_points: int = CLOUD_POINTS
    views: int = 1
    """Ways in which each state is looked at, up to eight: more are surer and take longer."""
    ahead: int = 4
    """Plans that it follows in imagination, side by side; none below two."""
    depth: int = 1
    """Merges that it imagines of each."""
    hands: Params | None = None
    """Of the network that chooses grasps (`grasping`); None if there is none, and no playing with robots then."""
    held: Params | None = None
    """Like `params`, for what hands have to join; the same if None."""
    memory: Memory = field(default_factory=Memory, repr=False)

    @property
    def settings(self) -> tuple[SettingName, ...]:
        """In which it can play."""
        return ("object-centric",) if self.hands is None else ("object-centric", "full")

    @staticmethod
    def from_checkpoint(loaded: Checkpoint, where: str) -> RelationalPolicy:
        """The policy that a checkpoint holds.

        Args:
            loaded: of kind `relational`.
            where: the file, for messages and reports.

        Raises:
            InputError: its configuration or arrays are not those of such a network.
        """
        config = checkpoint.network_config(relational.RelationalConfig(), loaded.config.get("network"), where)
        if config.token % config.heads:
            raise InputError(f"'{where}': {config.heads} heads do not divide tokens of {config.token}; they must")
        wanted = relational.init(np.random.default_rng(0), config)
        params = {name: array for name, array in loaded.params.items() if name not in (HANDS, HELD)}
        hands, held = loaded.params.get(HANDS), loaded.params.get(HELD)
        with_hands = wanted | relational.init_hands(np.random.default_rng(0), config)
        for own, like in ((params, wanted), (held, with_hands), (hands, grasping.init(np.random.default_rng(0)))):
            if own is not None:
                checkpoint.check_arrays(own, like, where)
        return RelationalPolicy(params, where, hands=hands, held=held)

    def values(self, observation: Observation, mask: Mask) -> Values:
        """Logits that actions are good, or with robots the logarithms of their chances; -inf where the action does not
        exist.

        Raises:
            InputError: the policy knows nothing of hands, and the mask is one of grasps.
        """
        situation = Situation.of(observation, mask)
        if mask.ndim != _WITH_GRASPS:
            return self._values(situation)
        if self.hands is None:
            raise InputError(f"the policy '{self.name}' has learnt nothing of hands; --setting object-centric would do")
        pairs = self if self.held is None else replace(self, params=self.held)
        return pairs._held(situation, pairs._values(situation), self.hands, mask)

    def _values(self, situation: Situation) -> Values:
        out = np.full(situation.actions, -np.inf, np.float32)
        tokens = tokens_of(situation, self.memory, hands="hold" in self.params)
        if len(tokens.part):
            u, k = tokens.part[:, None], tokens.point[:, None]
            v, l = tokens.part[None], tokens.point[None]  # noqa: E741
            # Equal parts are worth the same but for rounding, which must not choose between them, nor between plans.
            out[u, v, k, l] = np.round(relational.values(self.params, tokens, AUGMENTATIONS[: self.views]), _DECIMALS)
        return out

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Chance that the furniture can still be finished after each action."""
        values = self.values(observation, mask)
        return np.exp(values) if mask.ndim == _WITH_GRASPS else sigmoid(values)

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """The surest action; with `ahead`, the first of the plan after which the furniture most surely can be finished.

        Raises:
            InputError: there is none, or the policy knows nothing of hands and is asked for grasps.
        """
        if mask.ndim == _WITH_GRASPS:
            return surest(self.values(observation, mask))
        situation = Situation.of(observation, mask)
        values = self._values(situation)
        if self.ahead < 2:
            return surest(values)
        return self._plan(_Plan(situation, values))

    def _held(self, situation: Situation, values: Values, hands: Params, mask: Mask) -> Values:
        """Of actions with two grasps: that the pair is good, that something good is left then, that the hands fit."""
        pairs = -np.logaddexp(0.0, -values.max(axis=-1))
        if self.ahead > 1:
            pairs = self._hopeful(situation, values, pairs)
        out = np.where(mask, pairs[..., None, None] + _UNHANDLED, -np.inf).astype(np.float32)
        flat = pairs.ravel()
        found = np.full(_ENOUGH, -np.inf)
        for index in np.argsort(-flat, kind="stable")[:_HANDLED]:
            # No hands make an action surer than its pair is.
            if flat[index] == -np.inf or found[0] > flat[index] - _HARDLY:
                break
            u, v, k, l = (int(i) for i in np.unravel_index(index, pairs.shape))  # noqa: E741
            chance = grasping.log_chance(hands, handling_of(situation, u, k, v, l))
            out[u, v, k, l] = np.where(mask[u, v, k, l], flat[index] + chance, -np.inf)
            found = np.sort([*found, *out[u, v, k, l].ravel()])[-_ENOUGH:]
        return np.round(out, _DECIMALS)

    def _hopeful(self, situation: Situation, values: Values, pairs: np.ndarray) -> np.ndarray:
        """With what is left after the best merge of each two groups added to all their pairs."""
        group = situation.group
        hopes: dict[frozenset[int], float] = {}
        for action in _candidates(values, group, self.ahead):
            plan = self._imagined(_Plan(situation, values), action, 0.0, frozenset())
            hopes[frozenset((int(group[action[0]]), int(group[action[1]])))] = max(plan.hope, _HOPELESS)
        # Nobody looked at the others because they are worse.
        out = pairs + min(hopes.values(), default=0.0)
        for two, hope in hopes.items():
            one, other = sorted(two)
            here = np.isin(group, one)[:, None] & np.isin(group, other)[None]
            out = np.where((here | here.T)[..., None, None], pairs + hope, out)
        return out

    def _plan(self, start: _Plan) -> Int[np.ndarray, "5"]:
        """Beam search in imagination: `depth` merges deep, `ahead` plans wide."""
        plans = [start]
        for _ in range(self.depth):
            wider: dict[frozenset[_Pair], tuple[_Plan, tuple[int, ...], float]] = {}
            for plan in plans:
                for action in _candidates(plan.values, plan.situation.group, self.ahead):
                    u, v, k, l, _ = action  # noqa: E741
                    chance = plan.chance + _log_sigmoid(float(plan.values[action]))
                    # Merges in another order are the same plan.
                    key = plan.pairs | {frozenset(((u, k), (v, l)))}
                    if key not in wider or chance > wider[key][2]:
                        wider[key] = plan, action, chance
            if not wider:
                break
            likely = sorted(wider.items(), key=lambda item: -item[1][2])[: self.ahead]
            plans = [self._imagined(plan, action, chance, key) for key, (plan, action, chance) in likely]
        best = max(plans, key=lambda plan: plan.chance + plan.hope)
        return surest(start.values) if best.first is None else np.array(best.first)

    def _imagined(self, plan: _Plan, action: tuple[int, ...], chance: float, pairs: frozenset[_Pair]) -> _Plan:
        u, v, k, l, _ = action  # noqa: E741
        after = plan.situation.after(u, k, v, l)
        return _Plan(after, self._values(after), plan.first or action, chance, pairs)


_Pair = frozenset[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class _Plan:
    """Merges in imagination, and what would be left."""

    situation: Situation
    values: Values
    first: tuple[int, ...] | None = None
    """The action to begin with."""
    chance: float = 0.0
    """Logarithm, that all merges so far are good."""
    pairs: frozenset[_Pair] = frozenset()

    @property
    def hope(self) -> float:
        """Logarithm of the chance that it can be finished; certain where nothing is left to be joined."""
        best = float(self.values.max(initial=-np.inf))
        if best == -np.inf:
            return 0.0 if self.situation.joined else -np.inf
        return _log_sigmoid(best)


def _candidates(values: Values, group: Int[np.ndarray, "P"], count: int) -> list[tuple[int, ...]]:
    """The best action of each two groups, best first."""
    # Few of all actions exist; of equal ones the first counts, on every machine.
    exist = np.flatnonzero(values > -np.inf)
    order = exist[np.argsort(-values.ravel()[exist], kind="stable")[:_CONSIDERED]]
    out: dict[frozenset[int], tuple[int, ...]] = {}
    for flat in order:
        if len(out) == count:
            break
        action = tuple(int(i) for i in np.unravel_index(flat, values.shape))
        out.setdefault(frozenset((int(group[action[0]]), int(group[action[1]]))), action)
    return list(out.values())


def _log_sigmoid(logit: float) -> float:
    return float(-np.logaddexp(0.0, -logit))
