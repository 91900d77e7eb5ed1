"""What plays: anything that picks an action from an observation and the mask of existing actions.

A policy of your own needs no base class, only the attributes of `Policy`:

    class Mine:
        name = "mine"
        cloud_points = 128

        def act(self, observation, mask):
            return np.argwhere(mask)[0]

    evaluate.play_episode(Mine(), catalogue.make("stool"), seed=0)
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int

from roboassembly.envs.object_centric import existing_actions
from roboassembly.envs.observation import Observation, Observer
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.learning import checkpoint, relational
from roboassembly.learning.checkpoint import Checkpoint
from roboassembly.learning.layers import Params, sigmoid
from roboassembly.learning.lessons import CLOUD_POINTS
from roboassembly.learning.situation import Situation
from roboassembly.learning.tokens import Memory, tokens_of
from roboassembly.learning.views import VIEWS
from roboassembly.solvers.guide import Guide, Suggestion
from roboassembly.task.groups import TaskState
from roboassembly.task.object_centric import ObjectCentricTask

if TYPE_CHECKING:
    from roboassembly.learning.paper import PaperConfig

RANDOM = "random"
SHIPPED = ("relational", "paper")
"""Policies whose checkpoints belong into the package, as `weights/NAME.npz`."""
NAMES = (RANDOM, *SHIPPED)
_TIE = 1e-3
"""Values nearer than this to the best count as equal: rounding must not choose between equal parts."""
_CONSIDERED = 400
"""Actions among which those of different groups are looked for."""
_SUGGESTIONS = 32
"""That a guide makes in a state, at most."""
_LARGEST, _DEEPEST = 4096, 64
"""Of any size, and of layers, in a checkpoint's configuration: a broken file must not ask for all memory."""
Config = TypeVar("Config", relational.RelationalConfig, "PaperConfig")

Mask = Bool[np.ndarray, "P P K K 6"]
"""Which actions `(u, v, k, l, w)` exist, as in `info["action_mask"]`."""
Values = Float32[np.ndarray, "P P K K 6"]


class Policy(Protocol):
    """Picks actions."""

    @property
    def name(self) -> str:
        """For reports."""
        ...

    @property
    def cloud_points(self) -> int:
        """Points of each part's cloud that observations must have."""
        ...

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "5"]:
        """The action `(u, v, k, l, w)` to take; arrays as in `envs.observation`, padded."""
        ...


@runtime_checkable
class ValuePolicy(Policy, Protocol):
    """Values all actions and takes the best."""

    def values(self, observation: Observation, mask: Mask) -> Values:
        """What each action is worth, on a scale of the policy's own; -inf where the action does not exist."""
        ...


@runtime_checkable
class ConfidentPolicy(ValuePolicy, Protocol):
    """Knows besides how likely each action is good, which tells a guided search when to leave it alone."""

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Chance that the furniture can still be finished after the action, 0 to 1; 0 where it does not exist."""
        ...


@dataclass(eq=False)
class RandomPolicy:
    """Any action that exists."""

    rng: np.random.Generator
    name: str = RANDOM
    cloud_points: int = 1

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "5"]:
        """One of the existing actions, all alike.

        Raises:
            InputError: there is none.
        """
        choices = np.flatnonzero(mask)
        if not len(choices):
            raise InputError("the mask has no action; the episode is over")
        return np.array(np.unravel_index(self.rng.choice(choices), mask.shape))


@dataclass(frozen=True, eq=False)
class RelationalPolicy:
    """The relational network, on NumPy; the surest choice first."""

    params: Params
    name: str = relational.KIND
    cloud_points: int = CLOUD_POINTS
    views: int = 1
    """Ways in which each state is looked at, up to eight: more are surer and take longer."""
    ahead: int = 0
    """Plans that it follows in imagination, side by side; none below two."""
    depth: int = 1
    """Merges that it imagines of each."""
    memory: Memory = field(default_factory=Memory, repr=False)

    @staticmethod
    def from_checkpoint(loaded: Checkpoint, where: str) -> RelationalPolicy:
        """The policy that a checkpoint holds.

        Args:
            loaded: of kind `relational`.
            where: the file, for messages and reports.

        Raises:
            InputError: its configuration or arrays are not those of such a network.
        """
        config = _network_config(relational.RelationalConfig(), loaded.config.get("network"), where)
        if config.token % config.heads:
            raise InputError(f"'{where}': {config.heads} heads do not divide tokens of {config.token}; they must")
        _check_arrays(loaded.params, relational.init(np.random.default_rng(0), config), where)
        return RelationalPolicy(loaded.params, where)

    def values(self, observation: Observation, mask: Mask) -> Values:
        """Logits that actions are good; -inf where the action does not exist."""
        return self._values(Situation.of(observation, mask), mask)

    def _values(self, situation: Situation, mask: Mask) -> Values:
        out = np.full(mask.shape, -np.inf, np.float32)
        tokens = tokens_of(situation, self.memory)
        if len(tokens.part):
            u, k = tokens.part[:, None], tokens.point[:, None]
            v, l = tokens.part[None], tokens.point[None]  # noqa: E741
            out[u, v, k, l] = relational.values(self.params, tokens, VIEWS[: self.views])
        return out

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Chance that the furniture can still be finished after each action."""
        return sigmoid(self.values(observation, mask))

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "5"]:
        """The surest action; with `ahead`, the first of the plan after which the furniture most surely can be finished.

        Raises:
            InputError: there is none.
        """
        situation = Situation.of(observation, mask)
        values = self._values(situation, mask)
        if self.ahead < 2:
            return surest(values)
        return self._plan(_Plan(situation, values), mask)

    def _plan(self, start: _Plan, mask: Mask) -> Int[np.ndarray, "5"]:
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
            plans = [self._imagined(plan, action, chance, key, mask) for key, (plan, action, chance) in likely]
        best = max(plans, key=lambda plan: plan.chance + plan.hope)
        return surest(start.values) if best.first is None else np.array(best.first)

    def _imagined(
        self, plan: _Plan, action: tuple[int, ...], chance: float, pairs: frozenset[_Pair], mask: Mask
    ) -> _Plan:
        u, v, k, l, _ = action  # noqa: E741
        after = plan.situation.after(u, k, v, l)
        return _Plan(after, self._values(after, mask), plan.first or action, chance, pairs)


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
    order = np.argsort(values, axis=None)[::-1][:_CONSIDERED]
    out: dict[frozenset[int], tuple[int, ...]] = {}
    for flat in order:
        action = tuple(int(i) for i in np.unravel_index(flat, values.shape))
        if values[action] == -np.inf or len(out) == count:
            break
        out.setdefault(frozenset((int(group[action[0]]), int(group[action[1]]))), action)
    return list(out.values())


def _log_sigmoid(logit: float) -> float:
    return float(-np.logaddexp(0.0, -logit))


def surest(values: Values) -> Int[np.ndarray, "5"]:
    """The action of the greatest value; of those within rounding of it, the first.

    Raises:
        InputError: no action exists.
    """
    best = float(values.max())
    if best == -np.inf:
        raise InputError("no action exists; the episode is over")
    return np.array(np.unravel_index(int(np.argmax(values >= best - _TIE)), values.shape))


def load_policy(name: str, seed: int = 0) -> Policy:
    """A policy by name, or from a checkpoint.

    Args:
        name: `random`, `relational`, `paper`, or the path of a checkpoint.
        seed: of policies that draw.

    Raises:
        UnknownNameError: no such policy.
        InputError: the checkpoint is missing, broken, or of another network.
    """
    if name == RANDOM:
        return RandomPolicy(np.random.default_rng(seed))
    if name in SHIPPED:
        place = _shipped(name)
        if not place.is_file():
            raise InputError(
                f"this installation has no weights for the policy '{name}'; train it (roboassembly train) and give "
                "the checkpoint's path"
            )
        with resources.as_file(place) as path:
            return _of_checkpoint(checkpoint.load(path), name)
    path = Path(name)
    if not (path.exists() or path.suffix == ".npz" or "/" in name):
        raise UnknownNameError("policy", name, [*NAMES, "PATH.npz"])
    return _of_checkpoint(checkpoint.load(path), name)


def _shipped(name: str) -> Traversable:
    return resources.files("roboassembly.learning") / "weights" / f"{name}.npz"


def weights_hash(name: str) -> str:
    """Of a policy's checkpoint, by name or path; empty if there is none."""
    place = _shipped(name) if name in SHIPPED else Path(name)
    return hashlib.sha256(place.read_bytes()).hexdigest()[:16] if place.is_file() else ""


def _of_checkpoint(loaded: Checkpoint, where: str) -> Policy:
    if loaded.kind == relational.KIND:
        return RelationalPolicy.from_checkpoint(loaded, where)
    if loaded.kind == "paper":
        from roboassembly.learning import autoencoder, paper

        rng, zeros = np.random.default_rng(0), np.zeros(paper.STATE, np.float32)
        network = paper.init(rng, _network_config(paper.PaperConfig(), loaded.config.get("network"), where))
        inputs = {"mean": zeros, "scale": zeros}
        wanted = {"network": network, "inputs": inputs, "encoder": autoencoder.init(rng)}
        _check_arrays(loaded.params, wanted, where)
        return paper.PaperPolicy.from_checkpoint(loaded)
    raise InputError(f"'{where}' holds a '{loaded.kind}' network, which is no policy; '{relational.KIND}' would do")


def _network_config(usual: Config, found: Any, where: str) -> Config:
    """The sizes of a network from a checkpoint's configuration, checked.

    Args:
        usual: such a configuration, for the names and kinds of its fields.
        found: what the checkpoint has.
        where: the file.

    Raises:
        InputError: it has other fields, or sizes that are none.
    """
    known = {f.name: getattr(usual, f.name) for f in fields(usual)}
    if not isinstance(found, dict) or found.keys() != known.keys():
        told = ", ".join(sorted(found)) if isinstance(found, dict) else repr(found)
        raise InputError(f"'{where}': config['network'] holds {told}; it should hold {', '.join(known)}")
    for name, value in found.items():
        if type(value) is not type(known[name]):
            raise InputError(f"'{where}': config['network']['{name}'] is {value!r}; like {known[name]!r} would do")
        most = _DEEPEST if name == "layers" else _LARGEST
        if isinstance(value, int) and not isinstance(value, bool) and not 1 <= value <= most:
            raise InputError(f"'{where}': config['network']['{name}'] is {value}; 1 to {most} would do")
    return replace(usual, **found)


def _check_arrays(found: Params, wanted: Params, where: str, above: str = "") -> None:
    """That a checkpoint's arrays have the names, shapes and kind of numbers of a network.

    Raises:
        InputError: naming the first that does not fit.
    """
    if found.keys() != wanted.keys():
        lacks, more = sorted(wanted.keys() - found.keys()), sorted(found.keys() - wanted.keys())
        raise InputError(
            f"'{where}' does not fit its own configuration: at '{above or '/'}' it lacks {lacks} and has {more} besides"
        )
    for name, value in wanted.items():
        own, at = found[name], f"{above}/{name}"
        if isinstance(value, dict) != isinstance(own, dict):
            raise InputError(f"'{where}': '{at}' is not what its configuration asks for")
        if isinstance(value, dict):
            _check_arrays(own, value, where, at)
        elif own.shape != value.shape or own.dtype != value.dtype:
            raise InputError(
                f"'{where}': '{at}' is {own.dtype} {own.shape}; its configuration asks for {value.dtype} {value.shape}"
            )
        elif not np.isfinite(own).all():
            raise InputError(f"'{where}': '{at}' has numbers that are not finite; the training went wrong")


@dataclass(eq=False)
class _PolicyGuide:
    """Suggests what a policy values most."""

    policy: ValuePolicy
    _seen: tuple[Furniture, Observer] | None = field(default=None, init=False)

    def __call__(self, task: ObjectCentricTask, state: TaskState) -> Sequence[Suggestion]:
        if self._seen is None or self._seen[0] is not task.furniture:
            observer = Observer(task.furniture, MAX_PARTS, MAX_POINTS, self.policy.cloud_points)
            self._seen = task.furniture, observer
        observation, mask = self._seen[1].observe(state), existing_actions(task, state)
        if isinstance(self.policy, ConfidentPolicy):
            scores = self.policy.probabilities(observation, mask)
        else:
            # Of values we know only which are better, so the best is always worth a try.
            values = self.policy.values(observation, mask)
            best = values.max()
            scores = np.exp(values - best) if np.isfinite(best) else np.zeros_like(values)
        flat = np.where(mask, scores, 0.0).ravel()
        top = np.argpartition(-flat, _SUGGESTIONS)[:_SUGGESTIONS]
        # Rounded, and then by number: rounding errors must not choose between equal parts.
        order = top[np.lexsort((top, -np.round(flat[top] / _TIE)))]
        return [
            Suggestion(tuple(int(i) for i in np.unravel_index(index, mask.shape)), float(flat[index]))
            for index in order
            if flat[index] > 0.0
        ]


def guide_of(policy: Policy) -> Guide:
    """Lets a policy guide the search (`solvers.search.solve(..., guide=...)`).

    Raises:
        InputError: the policy does not value actions.
    """
    if not isinstance(policy, ValuePolicy):
        raise InputError(f"the policy '{policy.name}' does not value actions, so it cannot guide the search")
    return _PolicyGuide(policy)
