"""What plays: anything that picks an action from an observation and the mask of existing actions.

A policy of your own needs no base class, only the attributes of `Policy`:

    class Mine:
        name = "mine"
        cloud_points = 128

        def act(self, observation, mask):
            return np.argwhere(mask)[0]

    players.play_episode(Mine(), catalogue.make("stool"), seed=0)

One that plays with robots says so: `settings = ("object-centric", "full")`.

In a file of its own, `my_policy.py`, all commands take it (`roboassembly evaluate --policy my_policy.py`). The file
defines `policy`: a function that gets a seed and returns a policy, or a class whose objects are made of a seed.

    def policy(seed: int) -> Mine:
        return Mine()

It is called for every episode anew, with another seed each, so that nothing depends on what was played before; what
takes long, like reading weights, is better done once in the file. `docs/your-own-policy.md` has examples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int

from roboassembly.envs.observation import Observation, Observer
from roboassembly.errors import InputError, PolicyError
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.solvers.guide import Guide, Suggestion
from roboassembly.task.setting import SettingName, Task

RANDOM = "random"
MAKER = "policy"
"""What a policy's file defines."""
_TIE = 1e-3
"""Values nearer than this to the best count as equal: rounding must not choose between equal parts."""
_SUGGESTIONS = 32
"""That a guide makes in a state, at most."""

Mask = Bool[np.ndarray, "P P K K ..."]
"""Which actions `(u, v, k, l, w)` exist, or `(u, v, k, l, g_a, g_b)` with robots, as in `info["action_mask"]`."""
Values = Float32[np.ndarray, "P P K K ..."]


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

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """The action to take, `(u, v, k, l, w)` or `(u, v, k, l, g_a, g_b)`; arrays as in `envs.observation`,
        padded."""
        ...


def settings_of(policy: Policy) -> tuple[SettingName, ...]:
    """In which a policy can play: its attribute `settings`; object-centric if it has none."""
    return getattr(policy, "settings", ("object-centric",))


def chosen(policy: Policy, observation: Observation, mask: Mask) -> tuple[int, ...]:
    """The action that a policy picks.

    Raises:
        PolicyError: it is no row of whole numbers, one for each axis of the mask.
    """
    picked = policy.act(observation, mask)
    try:
        action = np.asarray(picked)
    except (TypeError, ValueError):
        action = np.empty(0)
    if action.shape != (mask.ndim,) or action.dtype.kind not in "iu":
        told = " ".join(repr(picked).split())
        raise PolicyError(f"the policy '{policy.name}' picked {told:.200}; {mask.ndim} whole numbers would do")
    return tuple(int(a) for a in action)


def check_setting(policy: Policy, setting: SettingName, solver: str) -> None:
    """That a policy can play in a setting.

    Args:
        policy: any.
        setting: `object-centric` or `full`.
        solver: that could be named instead.

    Raises:
        InputError: it cannot.
    """
    if setting not in settings_of(policy):
        lacks = "chooses no grasps" if setting == "full" else "plays with robots only"
        raise InputError(
            f"'{policy.name}' {lacks}; --setting {setting} takes --policy {solver}, or a policy whose `settings` "
            "name it"
        )


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
    settings: tuple[SettingName, ...] = ("object-centric", "full")

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """One of the existing actions, all alike.

        Raises:
            InputError: there is none.
        """
        choices = np.flatnonzero(mask)
        if not len(choices):
            raise InputError("the mask has no action; the episode is over")
        return np.array(np.unravel_index(self.rng.choice(choices), mask.shape))


def surest(values: Values) -> Int[np.ndarray, "_"]:
    """The action of the greatest value; of those within rounding of it, the first.

    Raises:
        InputError: no action exists.
    """
    best = float(values.max())
    if best == -np.inf:
        raise InputError("no action exists; the episode is over")
    return np.array(np.unravel_index(int(np.argmax(values >= best - _TIE)), values.shape))


@dataclass(eq=False)
class _PolicyGuide:
    """Suggests what a policy values most."""

    policy: ValuePolicy
    _seen: tuple[Furniture, Observer] | None = field(default=None, init=False)

    def __call__(self, task: Task[Any, Any], state: Any) -> Sequence[Suggestion]:
        if self._seen is None or self._seen[0] is not task.furniture:
            observer = Observer(task.furniture, MAX_PARTS, MAX_POINTS, self.policy.cloud_points)
            self._seen = task.furniture, observer
        observation = self._seen[1].observe(task.groups_of(state))
        mask = task.existing_actions(state)
        if isinstance(self.policy, ConfidentPolicy):
            scores = _told(self.policy, "probabilities", self.policy.probabilities(observation, mask), mask)
        else:
            # Of values we know only which are better, so the best is always worth a try.
            values = _told(self.policy, "values", self.policy.values(observation, mask), mask)
            values = np.where(mask, values, -np.inf)
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


def _told(policy: Policy, what: str, values: Values, mask: Mask) -> Values:
    """What a policy says of all actions.

    Raises:
        PolicyError: it has another shape than the mask, or says nothing of an action that exists.
    """
    values = np.asarray(values)
    if values.shape != mask.shape:
        raise PolicyError(f"`{what}` of the policy '{policy.name}' has the shape {values.shape}, the mask {mask.shape}")
    if np.isnan(values[mask]).any():
        raise PolicyError(f"`{what}` of the policy '{policy.name}' is not a number for some action that exists")
    return values


def guide_of(policy: Policy) -> Guide:
    """Lets a policy guide the search (`solvers.search.solve(..., guide=...)`).

    Raises:
        InputError: the policy does not value actions.
    """
    if not isinstance(policy, ValuePolicy):
        raise InputError(
            f"the policy '{policy.name}' does not value actions (it has no method `values`), so it cannot guide the "
            "search; it can play alone: assemble with --no-search, or evaluate without --search"
        )
    return _PolicyGuide(policy)
