"""The policy protocol: anything that picks an action from an observation and the mask of existing actions.

Your own policy needs no base class, only the attributes of `Policy`:

    class Mine:
        name = "mine"
        cloud_points = 128

        def act(self, observation, mask):
            return np.argwhere(mask)[0]

    rollout.run_episode(Mine(), catalogue.make("stool"), seed=0)

A policy that acts in the full setting says so: `settings = ("object-centric", "full")`.

All commands take a policy from a file (`roboassembly evaluate --policy my_policy.py`). The file defines `policy`: a
function that gets a seed and returns a policy, or a class whose constructor takes a seed.

    def policy(seed: int) -> Mine:
        return Mine()

It is called for each episode, with a different seed, so that no episode depends on an earlier one. Do what takes long,
like reading weights, once when the file is loaded. `docs/your-own-policy.md` has examples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int

from roboassembly.envs.observation import Observation, Observer
from roboassembly.errors import InputError, PolicyError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.settings import SETTINGS
from roboassembly.solvers.guide import Guide, Suggestion
from roboassembly.task.part_frames import FramesName
from roboassembly.task.setting import SettingName, Task

RANDOM = "random"
MAKER = "policy"
"""Name that the file of a policy defines."""
TIE = 1e-3
"""Values nearer than this to the best count as equal: rounding must not choose between equal parts."""
_SUGGESTIONS = 32
"""Largest number of suggestions of a guide in a state."""

Mask = Bool[np.ndarray, "P P K K ..."]
"""Mask of the existing actions, `(u, v, k, l, w)` or in the full setting `(u, v, k, l, g_a, g_b)`:
`info["action_mask"]`."""
Values = Float32[np.ndarray, "P P K K ..."]
"""A value for each action."""
Pair = tuple[int, int, int, int]
"""Parts and points of a pair, `(u, v, k, l)`."""


class Policy(Protocol):
    """Policy: picks actions."""

    @property
    def name(self) -> str:
        """Name in reports."""
        ...

    @property
    def cloud_points(self) -> int:
        """Number of points of each part's cloud in the observations."""
        ...

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """Return the action to take, `(u, v, k, l, w)` or `(u, v, k, l, g_a, g_b)`.

        Args:
            observation: arrays as in `envs.observation`, padded.
            mask: which actions exist.
        """
        ...


def settings_of(policy: Policy) -> tuple[SettingName, ...]:
    """Return the settings that a policy can act in: its attribute `settings`; object-centric if it has none."""
    return getattr(policy, "settings", ("object-centric",))


def chosen(policy: Policy, observation: Observation, mask: Mask) -> tuple[int, ...]:
    """Return the action that a policy picks.

    Raises:
        PolicyError: it is not a row of whole numbers, one for each axis of the mask.
    """
    picked = policy.act(observation, mask)
    try:
        action = np.asarray(picked)
    except (TypeError, ValueError):
        action = np.empty(0)
    if action.shape != (mask.ndim,) or action.dtype.kind not in "iu":
        found = " ".join(repr(picked).split())
        raise PolicyError(f"the policy '{policy.name}' picked {found:.200}; expected {mask.ndim} integers")
    return tuple(int(a) for a in action)


def check_setting(policy: Policy, setting: SettingName, solver: str) -> None:
    """Check that a policy can act in a setting.

    Args:
        policy: policy.
        setting: `object-centric` or `full`.
        solver: name of a solver to suggest instead.

    Raises:
        InputError: it cannot.
    """
    if setting not in settings_of(policy):
        raise InputError(
            f"'{policy.name}' {SETTINGS[setting].lacking}; --setting {setting} takes --policy {solver}, or a policy "
            "whose `settings` name it"
        )


@runtime_checkable
class ValuePolicy(Policy, Protocol):
    """Policy that values all actions and takes the best."""

    def values(self, observation: Observation, mask: Mask) -> Values:
        """Return a value of each action, on the policy's own scale; -inf where the action does not exist."""
        ...


@runtime_checkable
class ConfidentPolicy(ValuePolicy, Protocol):
    """Policy that also gives probabilities, which tell a guided search when to ignore it."""

    def probabilities(self, observation: Observation, mask: Mask) -> Values:
        """Return the probability that the furniture can be finished after each action; 0 where it does not exist."""
        ...


@runtime_checkable
class RevisingPolicy(ValuePolicy, Protocol):
    """Policy that values actions anew once it hears which pairs are wrong."""

    def revised_values(self, observation: Observation, mask: Mask, wrong: Sequence[Pair]) -> Values:
        """Return values as `values` does, given the pairs that the environment refused as wrong in this state."""
        ...


@runtime_checkable
class FramedPolicy(Policy, Protocol):
    """Policy that must know in which frames the parts are described, because they say what `w` names."""

    def with_frames(self, frames: FramesName) -> Policy:
        """Return the policy for observations in some frames."""
        ...


def with_frames(policy: Policy, frames: FramesName) -> Policy:
    """Return a policy for observations in some frames: the policy itself if it need not know."""
    return policy.with_frames(frames) if isinstance(policy, FramedPolicy) else policy


@runtime_checkable
class MeshPolicy(Policy, Protocol):
    """Policy that uses the parts' meshes besides the observations."""

    def with_meshes(self, meshes: Sequence[Mesh]) -> Policy:
        """Return the policy for parts with these meshes, in the frames in which observations describe the parts."""
        ...


def with_meshes(policy: Policy, meshes: Sequence[Mesh]) -> Policy:
    """Return a policy that knows the parts' meshes: the policy itself if it has no use for them."""
    return policy.with_meshes(meshes) if isinstance(policy, MeshPolicy) else policy


class Choices:
    """Choices of a policy in one state, the first one and those after refused ones.

    Args:
        policy: the policy.
        observation: the state.
        mask: actions that exist.
    """

    def __init__(self, policy: Policy, observation: Observation, mask: Mask) -> None:
        self._policy, self._observation, self._whole = policy, observation, mask
        self.mask = mask
        """Actions that are left."""
        self._values: Values | None = None
        self._wrong: list[Pair] = []

    def next(self) -> tuple[int, ...] | None:
        """Return the policy's choice among the actions that are left; None if none is left.

        After a refused action, a policy that values actions values them by the whole mask: its view of a state follows
        from it. It does so once, and again after each wrong pair if it takes notice of them.

        Raises:
            PolicyError: the policy picks something that is no action.
        """
        if not self.mask.any():
            return None
        if self.mask is self._whole or not isinstance(self._policy, ValuePolicy):
            return chosen(self._policy, self._observation, self.mask)
        if self._values is None:
            if self._wrong and isinstance(self._policy, RevisingPolicy):
                values = self._policy.revised_values(self._observation, self._whole, tuple(self._wrong))
            else:
                values = self._policy.values(self._observation, self._whole)
            self._values = _checked_values(self._policy, "values", values, self._whole)
        return tuple(surest(np.where(self.mask, self._values, -np.inf)).tolist())

    def refuse(self, action: tuple[int, ...], *, wrong_pair: bool) -> None:
        """Leave out an action that was refused, and all actions with its pair if the pair is wrong."""
        self.mask = self.mask.copy()
        u, v, k, l, *rest = action  # noqa: E741
        if wrong_pair:
            self.mask[u, v, k, l] = self.mask[v, u, l, k] = False
            self._wrong.append((u, v, k, l))
            if isinstance(self._policy, RevisingPolicy):
                self._values = None
        else:
            self.mask[(u, v, k, l, *rest)] = False


@dataclass(eq=False)
class RandomPolicy:
    """Policy that draws any existing action."""

    rng: np.random.Generator
    name: str = RANDOM
    cloud_points: int = 1
    settings: tuple[SettingName, ...] = ("object-centric", "full")

    def act(self, observation: Observation, mask: Mask) -> Int[np.ndarray, "_"]:
        """Draw one of the existing actions, all equally likely.

        Raises:
            InputError: there is none.
        """
        choices = np.flatnonzero(mask)
        if not len(choices):
            raise InputError("the mask has no action; the episode is over")
        return np.array(np.unravel_index(int(self.rng.choice(choices)), mask.shape))


def surest(values: Values) -> Int[np.ndarray, "_"]:
    """Return the action with the greatest value; the first of those within rounding of it.

    Raises:
        InputError: no action exists.
    """
    best = float(values.max())
    if best == -np.inf:
        raise InputError("no action exists; the episode is over")
    return np.array(np.unravel_index(int(np.argmax(values >= best - TIE)), values.shape))


@dataclass(eq=False)
class _PolicyGuide:
    """Guide that suggests what a policy values most."""

    policy: ValuePolicy
    _seen: tuple[Furniture, Observer] | None = field(default=None, init=False)

    def __call__(self, task: Task[Any, Any], state: Any) -> Sequence[Suggestion]:
        if self._seen is None or self._seen[0] is not task.furniture:
            observer = Observer(task.furniture, *task.furniture.padding, self.policy.cloud_points)
            self._seen = task.furniture, observer
        groups = task.groups_of(state)
        observation = self._seen[1].observe(groups)
        mask = task.existing_actions(groups, *task.furniture.padding)
        if isinstance(self.policy, ConfidentPolicy):
            scores = _checked_values(self.policy, "probabilities", self.policy.probabilities(observation, mask), mask)
        else:
            # Only the order of values is known, so the best is always worth a try.
            values = _checked_values(self.policy, "values", self.policy.values(observation, mask), mask)
            values = np.where(mask, values, -np.inf)
            best = values.max()
            scores = np.exp(values - best) if np.isfinite(best) else np.zeros_like(values)
        flat = np.where(mask, scores, 0.0).ravel()
        top = np.argpartition(-flat, _SUGGESTIONS)[:_SUGGESTIONS]
        # Rounded, then by number: rounding errors must not choose between equal parts.
        order: list[int] = top[np.lexsort((top, -np.round(flat[top] / TIE)))].tolist()
        return [
            Suggestion(tuple(int(i) for i in np.unravel_index(index, mask.shape)), float(flat[index]))
            for index in order
            if flat[index] > 0.0
        ]


def _checked_values(policy: Policy, what: str, values: Values, mask: Mask) -> Values:
    """Return the values of a policy, checked.

    Raises:
        PolicyError: their shape is not that of the mask, or the value of an existing action is not a number.
    """
    values = np.asarray(values)
    if values.shape != mask.shape:
        raise PolicyError(f"`{what}` of the policy '{policy.name}' has the shape {values.shape}, the mask {mask.shape}")
    if np.isnan(values[mask]).any():
        raise PolicyError(f"`{what}` of the policy '{policy.name}' is not a number for some action that exists")
    return values


def guide_of(policy: Policy) -> Guide[Any]:
    """Return a guide for the search (`solvers.search.solve(..., guide=...)`) from a policy.

    Raises:
        InputError: the policy does not value actions.
    """
    if not isinstance(policy, ValuePolicy):
        raise InputError(
            f"the policy '{policy.name}' does not value actions (it has no method `values`), so it cannot guide the "
            "search; it can play alone: assemble with --no-search, or evaluate without --search"
        )
    return _PolicyGuide(policy)
