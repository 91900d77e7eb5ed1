"""Grasp samples from the policy's own episodes: what becomes of the grasps that it would choose.

Random grasps (`grasps.dataset`) say little of those that a policy prefers: among hundreds it takes the one whose
probability it overrates most. So the policy acts, and every action that is carried out labels its own two grasps; after
one that fails, the next best is tried in the same state. More of its favourites in each state are labelled by what can
be tested without planning: whether both grasps fit, and of a few whether the arms can do it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.envs.observation import Observer, part_clouds
from roboassembly.errors import InputError
from roboassembly.learning.datasets import CLOUD_POINTS, dataset_file
from roboassembly.learning.policy import guide_of
from roboassembly.learning.policy_weights import load_weights
from roboassembly.learning.relational.collect import CollectResult, load_piece, piece_number
from roboassembly.learning.relational.grasps.dataset import NO, UNKNOWN, YES, GraspSamples, LabeledGrasps
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.parallel.processes import map_unordered
from roboassembly.solvers.guide import Guide
from roboassembly.task.full.failure import PICKING, Failure, FullVerdict, Stage
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.task import FullOutcome, FullTask
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rollout import draw_seed, rollout
from roboassembly.task.rules.connections import GRASPS

_MAX_TRIED = 5
"""Number of actions that are carried out in a state before an episode ends."""
_EXPLORATION = 0.25
"""Share of the actions that are drawn from all suggestions, instead of the best one."""
_FIT_TESTS, _ARM_TESTS = 12, 3
"""Number of suggestions of a state of which it is tested whether the grasps fit; and, of those that do, whether the
arms pick both groups and reach the mate."""
_DOES_NOT_FIT = (FullVerdict.GRASP_BLOCKED, FullVerdict.JOINT_BLOCKED, FullVerdict.CANNOT_RELEASE)


def collect_on_policy(
    names: Sequence[str], folder: Path, policy: Path, *, episodes: int, seed: int, jobs: int,
    folders: Mapping[str, Path] | None = None,
) -> Iterator[CollectResult]:  # fmt: skip
    """Write the grasp samples of some furniture, and yield as pieces are done; existing files are kept.

    Args:
        names: names of the pieces: `family:seed` of generated ones, else keys of `folders`.
        folder: folder of the files, one for each piece.
        policy: checkpoint of the relational policy that acts, with a grasp network.
        episodes: number of episodes of each piece.
        seed: seed of the starts and of everything drawn.
        jobs: number of processes.
        folders: furniture folders of pieces that are not generated, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not dataset_file(folder, name).is_file()]
    work = partial(_collect, folder=folder, policy=policy, episodes=episodes, seed=seed, folders=dict(folders or {}))
    yield from map_unordered(work, left, jobs)


def _collect(
    name: str, *, folder: Path, policy: Path, episodes: int, seed: int, folders: Mapping[str, Path]
) -> CollectResult:
    """Write the grasp samples of one piece."""
    start = time.monotonic()
    samples: list[LabeledGrasps] = []
    mistakes = choices = 0
    clouds, grasps = np.zeros((0, CLOUD_POINTS, 3), np.float32), np.zeros((0, GRASPS, 6), np.float32)
    try:
        task = FullTask(load_piece(name, folders))
        task.check_furniture()
    except InputError:
        # Two robots cannot assemble this piece.
        pass
    else:
        parts = task.furniture.parts
        clouds = part_clouds(task.furniture, CLOUD_POINTS)
        observer = Observer(task.furniture, len(parts), task.furniture.padding[1], 1)
        grasps = observer.grasp_poses
        guide: Guide[FullState] = guide_of(_policy(policy))
        for index in range(episodes):
            rng = np.random.default_rng([seed, piece_number(name, folders), index])
            found, tried = rollout_on_policy(task, task.initial_state(rng), observer, guide, rng)
            samples += found
            choices += len(tried)
            mistakes += sum(not (sample.finish == YES).any() for sample in tried)
    GraspSamples(name, clouds, grasps, tuple(samples)).save(dataset_file(folder, name))
    return CollectResult(name, len(samples), mistakes, choices, time.monotonic() - start)


@lru_cache(maxsize=1)
def _policy(path: Path) -> RelationalPolicy:
    """Policy of a checkpoint, read once in each process."""
    return RelationalPolicy.from_checkpoint(load_weights(str(path)), str(path))


def rollout_on_policy(
    task: FullTask, state: FullState, observer: Observer, guide: Guide[FullState], rng: np.random.Generator
) -> tuple[list[LabeledGrasps], list[LabeledGrasps]]:
    """Run one episode.

    Args:
        task: rules for the furniture.
        state: start of the episode.
        observer: observer of the furniture.
        guide: suggests actions, best first.
        rng: draws explorations and the planner's seeds.

    Returns:
        All samples, and those among them of actions that were carried out and whose pair fits.
    """
    samples: list[LabeledGrasps] = []
    tried: list[LabeledGrasps] = []

    def propose(state: FullState) -> Iterator[tuple[int, ...]]:
        left = [suggestion.action for suggestion in guide(task, state)]
        samples.extend(probe_grasps(task, state, observer, left[:_FIT_TESTS], rng))
        for _ in range(min(_MAX_TRIED, len(left))):
            yield left.pop(int(rng.integers(len(left))) if rng.random() < _EXPLORATION else 0)

    for transition in rollout(task, state, propose, rng):
        outcome = transition.outcome
        if outcome.verdict not in (FullVerdict.WRONG_PAIR, FullVerdict.NOT_AN_ACTION):
            tried.append(label_outcome(task, transition.state, observer, transition.action, outcome))
            samples.append(tried[-1])
    return samples, tried


def probe_grasps(
    task: FullTask, state: FullState, observer: Observer, actions: Sequence[tuple[int, ...]], rng: np.random.Generator
) -> list[LabeledGrasps]:
    """Label the grasps of some actions without carrying them out; one sample for each pair that fits.

    Args:
        task: rules for the furniture.
        state: state of the furniture.
        observer: observer of the furniture.
        actions: actions that exist.
        rng: draws the planner's seeds.
    """
    samples: dict[tuple[int, ...], LabeledGrasps] = {}
    arm_tests = 0
    for action in actions:
        u, v, k, l, g_a, g_b = action  # noqa: E741
        mate = task.mate_grasp(state.groups, action)
        if isinstance(mate, Failure) and mate.kind is FullVerdict.WRONG_PAIR:
            continue
        if (u, v, k, l) not in samples:
            samples[u, v, k, l] = LabeledGrasps.unlabeled(task, state, observer, (u, k, v, l))
        sample = samples[u, v, k, l]
        sample.fit[g_a, g_b] = NO if isinstance(mate, Failure) else YES
        if isinstance(mate, MateGrasp) and arm_tests < _ARM_TESTS:
            arm_tests += 1
            sample.reach[g_a, g_b] = task.can_mate(state, mate, draw_seed(rng))
            for robot, part, g, grip in ((0, u, g_a, mate.grip_a), (1, v, g_b, mate.grip_b)):
                if sample.pick[robot, g] == UNKNOWN:
                    sample.pick[robot, g] = task.can_pick(state, part, grip, robot, draw_seed(rng))
    return list(samples.values())


def label_outcome(
    task: FullTask, state: FullState, observer: Observer, action: tuple[int, ...], outcome: FullOutcome
) -> LabeledGrasps:
    """Label the two grasps of an action whose pair fits, by how far it came.

    Args:
        task: rules for the furniture.
        state: state before the action.
        observer: observer of the furniture.
        action: the action.
        outcome: outcome of the action.
    """
    u, v, k, l, g_a, g_b = action  # noqa: E741
    sample = LabeledGrasps.unlabeled(task, state, observer, (u, k, v, l))
    both, of_robot = (g_a, g_b), ((0, g_a), (1, g_b))
    if outcome.verdict in _DOES_NOT_FIT:
        sample.fit[both] = NO
        return sample
    sample.fit[both] = YES
    failure = outcome.failure
    if failure == Failure(FullVerdict.NO_ARM_SOLUTION, Stage.MATE):
        sample.reach[both] = NO
        return sample
    sample.reach[both] = YES
    if failure is not None and failure.stage in PICKING:
        # R_a picks first.
        if failure.robot == 1:
            sample.pick[of_robot[0]] = YES
        sample.pick[of_robot[failure.robot == 1]] = NO
        return sample
    sample.pick[of_robot[0]] = sample.pick[of_robot[1]] = YES
    sample.finish[both] = NO if outcome.step is None else YES
    return sample
