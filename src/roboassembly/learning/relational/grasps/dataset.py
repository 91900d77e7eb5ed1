"""Training samples of the grasp network: which grasps can carry out pairs that fit, in episodes of many pieces.

An episode takes viable pairs, as the oracle knows them, and tries random grasps until an action works. The sample of a
pair says which grasps can pick the groups, which two fit at the mate, where the arms reach it, and what became of the
actions that were carried out.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int8

from roboassembly.envs.observation import Observer, part_clouds
from roboassembly.errors import InputError
from roboassembly.learning import archive
from roboassembly.learning.datasets import CLOUD_POINTS, check_format, dataset_file, group_labels
from roboassembly.learning.relational.collect import CollectResult, load_piece, piece_number
from roboassembly.learning.relational.policy_view import PolicyView, digests_of
from roboassembly.parallel.processes import map_unordered
from roboassembly.solvers.hand_oracle import HandOracle, hand_oracle
from roboassembly.solvers.oracle import LabeledMate, Oracle
from roboassembly.task.full.grips import Grip, MateGrasp
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rollout import draw_seed, rollout
from roboassembly.task.rules.connections import GRASPS

FORMAT = 2
"""Version of the files."""
UNKNOWN, NO, YES = -1, 0, 1
"""Values of a label."""
_FIT_TESTS = 16
"""Number of grasp pairs of which it is tested whether both fit together."""
_REACH_TESTS = 6
"""Number of grasp pairs that fit of which it is tested whether the arms reach the mate."""
_PAIRS = 3
"""Number of viable pairs of a state that are tried before an episode ends."""
_TRIES = 3
"""Number of grasp pairs that are carried out for a pair of points, until one works."""


@dataclass(frozen=True, eq=False)
class LabeledGrasps:
    """One pair that fits in one state, and the labels of its grasps: `UNKNOWN`, `NO` or `YES`."""

    points: Float32[np.ndarray, "P K 9"]
    """Connection points, as in the observation."""
    connections: Float32[np.ndarray, "P P 6"]
    """Relative poses of joined parts, as in the observation."""
    free: Bool[np.ndarray, "P K"]
    """Whether each point exists and is free."""
    poses: Float32[np.ndarray, "P 6"]
    """World pose of each part, as in the observation."""
    pair: tuple[int, int, int, int]
    """The pair (u, k, v, l)."""
    pick: Int8[np.ndarray, "2 8"]
    """Whether R_a can pick u's group from its post with each grasp, and R_b v's."""
    fit: Int8[np.ndarray, "8 8"]
    """Whether two grasps fit at their parts and at the mate."""
    reach: Int8[np.ndarray, "8 8"]
    """Whether both arms then reach the mate somewhere."""
    finish: Int8[np.ndarray, "8 8"]
    """Whether all else then works, too."""

    @staticmethod
    def unlabeled(
        task: FullTask, state: FullState, observer: Observer, pair: tuple[int, int, int, int]
    ) -> LabeledGrasps:
        """Return a pair (u, k, v, l) of which no label is known.

        Args:
            task: rules for the furniture.
            state: state of the furniture.
            observer: observer of the furniture.
            pair: the pair; it fits.
        """
        observation = observer.observe(state.groups)
        free = task.rules.free_points(state.groups, *observation["connection_points"].shape[:2])
        return LabeledGrasps(
            observation["connection_points"], observation["connections"], free, observation["poses"], pair,
            np.full((2, GRASPS), UNKNOWN, np.int8),
            *(np.full((GRASPS, GRASPS), UNKNOWN, np.int8) for _ in range(3)),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class GraspSamples:
    """The labelled grasps of one piece of furniture."""

    name: str
    """Name of the furniture."""
    clouds: Float32[np.ndarray, "P C 3"]
    """Surface points of each part in its frame [m]."""
    grasps: Float32[np.ndarray, "P 8 6"]
    """Gripper pose of each grasp in the part's frame, as in the observation."""
    samples: tuple[LabeledGrasps, ...]

    def view(self, sample: LabeledGrasps) -> PolicyView:
        """Return what a policy sees of the state of a sample."""
        connections, clouds = sample.connections.astype(float), self.clouds.astype(float)
        return PolicyView(
            clouds, sample.points.astype(float), connections, sample.free, group_labels(connections),
            self.grasps.astype(float), sample.poses.astype(float), digests_of(clouds),
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Write as npz, whole or not at all; clouds are stored as 16-bit floats, half a millimetre exact."""
        mates = [(x.fit, x.reach, x.finish) for x in self.samples]
        arrays = {
            "format": np.array(FORMAT),
            "name": np.array(self.name),
            "clouds": self.clouds.astype(np.float16),
            "grasps": self.grasps,
            "points": np.array([x.points for x in self.samples]),
            "connections": np.array([x.connections for x in self.samples]),
            "free": np.array([x.free for x in self.samples]),
            "poses": np.array([x.poses for x in self.samples]),
            "pairs": np.array([x.pair for x in self.samples], np.int16).reshape(-1, 4),
            "pick": np.array([x.pick for x in self.samples], np.int8).reshape(-1, 2, GRASPS),
            "mate": np.array(mates, np.int8).reshape(-1, 3, GRASPS, GRASPS),
        }
        archive.write(path, arrays)

    @staticmethod
    def load(path: Path) -> GraspSamples:
        """Read what `save` wrote.

        Raises:
            InputError: the file is broken, or of another format.
        """
        with archive.reading(path, "a file of grasp samples", "remove it and build it again") as z:
            check_format(path, z, FORMAT)
            names = ("points", "connections", "free", "poses", "pairs", "pick", "mate")
            samples = tuple(
                LabeledGrasps(points, connections, free, poses, tuple(pair.tolist()), pick, *mate)
                for points, connections, free, poses, pair, pick, mate in zip(*(z[n] for n in names), strict=True)
            )
            return GraspSamples(str(z["name"]), z["clouds"].astype(np.float32), z["grasps"], samples)


class GraspLabeler:
    """Assembles one piece of furniture with two robots, and labels the grasps.

    Args:
        task: rules for the furniture.
        tries: number of grasp pairs that are carried out for each pair of points, of those that passed all tests.
        oracle: oracle of the task; a new one if None.
    """

    def __init__(self, task: FullTask, tries: int, oracle: Oracle | None = None) -> None:
        self.task, self.tries = task, tries
        self._oracle = oracle or HandOracle(task)
        self._observer = Observer(task.furniture, len(task.furniture.parts), task.furniture.padding[1], 1)

    def collect(self, rng: np.random.Generator, episodes: int) -> GraspSamples:
        """Return the samples of some episodes.

        Raises:
            InputError: the furniture does not suit the cell.
        """
        furniture = self.task.furniture
        clouds = part_clouds(furniture, CLOUD_POINTS)
        samples: list[LabeledGrasps] = []
        for _ in range(episodes):
            samples += self.rollout(self.task.initial_state(rng), rng)
        return GraspSamples(furniture.name, clouds, self._observer.grasp_poses, tuple(samples))

    def rollout(self, state: FullState, rng: np.random.Generator) -> list[LabeledGrasps]:
        """Run one episode of viable pairs, and return a sample of each pair that was tested."""
        samples: list[LabeledGrasps] = []

        def propose(state: FullState) -> Iterator[tuple[int, ...]]:
            pairs = self._oracle.right_pairs(state.groups)
            order: list[int] = rng.permutation(len(pairs)).tolist()
            mates = (self._oracle.label(state.groups, pairs[index]) for index in order)
            for mate in islice((m for m in mates if m.viable), _PAIRS):
                pick, fit, reach = self._tested(state, mate, rng)
                sample = LabeledGrasps.unlabeled(self.task, state, self._observer, (mate.u, mate.k, mate.v, mate.l))
                samples.append(replace(sample, pick=pick, fit=fit, reach=reach))
                both = (pick[0, :, None] == YES) & (pick[1] == YES)
                for g_a, g_b in rng.permutation(np.argwhere(both & (reach == YES)))[: self.tries].tolist():
                    yield mate.u, mate.v, mate.k, mate.l, g_a, g_b

        for transition in rollout(self.task, state, propose, rng):
            samples[-1].finish[transition.action[4:]] = YES if transition.merged else NO
        return samples

    def _tested(
        self, state: FullState, mate: LabeledMate, rng: np.random.Generator
    ) -> tuple[Int8[np.ndarray, "2 8"], Int8[np.ndarray, "8 8"], Int8[np.ndarray, "8 8"]]:
        """Labels `pick`, `fit` and `reach`: of each grasp alone, and of some pairs of grasps."""
        task, groups, merge = self.task, state.groups, mate.merge
        u_group, v_group = groups.groups[groups.group_of[mate.u]], groups.groups[groups.group_of[mate.v]]
        pick = np.full((2, GRASPS), UNKNOWN, np.int8)
        fit, reach = np.full((GRASPS, GRASPS), NO, np.int8), np.full((GRASPS, GRASPS), UNKNOWN, np.int8)
        fitting: list[dict[int, Grip]] = []
        for robot, part in enumerate((mate.u, mate.v)):
            grips = task.free_grips(groups, part)
            for g, grip in grips.items():
                pick[robot, g] = task.can_pick(state, part, grip, robot, draw_seed(rng))
            fitting.append({g: h for g, h in grips.items() if task.grip_fits(u_group, v_group, merge, h, robot)})
        both = [(a, b) for a in fitting[0] for b in fitting[1]]
        fit[tuple(np.array(both, int).reshape(-1, 2).T)] = UNKNOWN
        reach_tests = 0
        order: list[int] = rng.permutation(len(both))[:_FIT_TESTS].tolist()
        for a, b in (both[index] for index in order):
            checked = task.check_grips(u_group, v_group, merge, fitting[0][a], fitting[1][b])
            fit[a, b] = isinstance(checked, MateGrasp)
            if isinstance(checked, MateGrasp) and reach_tests < _REACH_TESTS:
                reach_tests += 1
                reach[a, b] = task.can_mate(state, checked, draw_seed(rng))
        return pick, fit, reach


def collect_grasps(
    names: Sequence[str], folder: Path, *, episodes: int, seed: int, jobs: int, folders: Mapping[str, Path]
) -> Iterator[CollectResult]:
    """Write the grasp samples of some furniture, and yield as pieces are done; existing files are kept.

    Args:
        names: names of the pieces: `family:seed` of generated ones, else keys of `folders`.
        folder: folder of the files, one for each piece. Furniture that does not suit the robots gives no samples.
        episodes: number of episodes of each piece.
        seed: seed of starts, pairs and grasps.
        jobs: number of processes.
        folders: furniture folders of pieces that are not generated, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not dataset_file(folder, name).is_file()]
    yield from map_unordered(
        partial(_collect, folder=folder, episodes=episodes, seed=seed, folders=dict(folders)), left, jobs
    )


def _collect(name: str, *, folder: Path, episodes: int, seed: int, folders: Mapping[str, Path]) -> CollectResult:
    start = time.monotonic()
    try:
        oracle = hand_oracle(load_piece(name, folders))
    except InputError:
        # A few generated pieces are invalid, cannot be held, or have too many parts.
        samples = GraspSamples(
            name, np.zeros((0, CLOUD_POINTS, 3), np.float32), np.zeros((0, GRASPS, 6), np.float32), ()
        )
    else:
        labeler = GraspLabeler(oracle.grasp_task, _TRIES, oracle)
        samples = labeler.collect(np.random.default_rng([seed, piece_number(name, folders)]), episodes)
    samples.save(dataset_file(folder, name))
    return CollectResult(name, len(samples.samples), 0, 0, time.monotonic() - start)
