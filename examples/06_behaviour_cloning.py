r"""Clone a merge of a stool from demonstrations, with scikit-learn, and count successes from new starts.

    python -m pip install '.[demos,imitation]'                      # in the source folder
    roboassembly demos stool --task merge --merge 0 --layout 1 --part-position 0.02 --part-angle 0.2 \
        --control joint_position --episodes 100 --out merges
    python examples/06_behaviour_cloning.py merges                  # trains in seconds, then 50 new starts

The task: one merge of the stool, from both parts on their posts to the closed joint, in one layout of the cell. Starts
differ in where each part stands, by up to 20 mm along each axis and 0.2 rad. docs/demonstrations.md says what came out.

The policy predicts chunks of actions. An episode has three phases, by which hands hold something; at the beginning of
each, a classifier picks one of the ways in which the demonstrations do the phase, and a regression gives all commands
of the phase, both from how the two parts stood at the start. A robot with an empty hand moves in the frame of its part,
so that all demonstrations reach the part in the same way.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from sklearn.base import BaseEstimator
from sklearn.cluster import DBSCAN
from sklearn.dummy import DummyClassifier
from sklearn.linear_model import LogisticRegression, Ridge
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from roboassembly.control.controls import PLACE_RANGE
from roboassembly.control.observation import ROBOT_FIELDS
from roboassembly.datasets import catalogue
from roboassembly.demonstrations.features import environment_state, environment_state_names, robot_state
from roboassembly.demonstrations.lerobot_dataset import CHUNK
from roboassembly.demonstrations.replay import Demonstrations
from roboassembly.geometry.poses import from_quaternion

HOLDS = ROBOT_FIELDS.index("holds")
CLOSED = -0.9
"""Action of a hand below which it closes with force."""
ALIKE, FEWEST = 0.05, 10
"""Root mean square difference of two demonstrations of a phase that are alike, in the numbers of `canonical`; and the
smallest number of demonstrations from which a way to do a phase is learned."""
Rows = np.ndarray


# Frames: how far both parts are from where they stand in the first demonstration.


@dataclass(frozen=True)
class Shift:
    """Level motion of a part: a turn about the world's vertical, then a translation."""

    turn: float
    x: float
    y: float

    @property
    def matrix(self) -> np.ndarray:
        """Homogeneous matrix."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.array([[c, -s, self.x], [s, c, self.y], [0.0, 0.0, 1.0]])


NOWHERE = Shift(0.0, 0.0, 0.0)


class Starts:
    """Reads from an observation how the part stands that each robot takes.

    Args:
        parts: number of parts in the observation.
        episode: rows of `observation.environment_state` of the first demonstration.
    """

    def __init__(self, parts: int, episode: Rows) -> None:
        names = environment_state_names(parts)
        # The first part of a group that a robot holds at the end stands for the group.
        takes = [[names.index(f"part{p}/held_by_{robot}") for p in range(parts)] for robot in "ab"]
        self.columns = [names.index(f"part{int(episode[-1, held].argmax())}/x") for held in takes]
        self.reference = [self._pose(episode[0], column) for column in self.columns]

    def shifts(self, state: Rows) -> list[Shift]:
        """Return the shift of each part against the first demonstration."""
        found = []
        for column, reference in zip(self.columns, self.reference, strict=True):
            by = self._pose(state, column) * reference.inverse()
            turn = np.arctan2(by.rotation[1, 0] - by.rotation[0, 1], by.rotation[0, 0] + by.rotation[1, 1])
            found.append(Shift(float(turn), float(by.translation[0]), float(by.translation[1])))
        return found

    @staticmethod
    def _pose(state: Rows, column: int):
        return from_quaternion(state[column : column + 3].astype(float), state[column + 3 : column + 7].astype(float))


def canonical(actions: Rows, frames: list[Shift]) -> Rows:
    """Return commands in the frames of both robots, as rows of 24: place, cosine and sine of the yaw, arm, hand."""
    rows = []
    for numbers, frame in zip(np.split(actions.astype(float), 2, axis=1), frames, strict=True):
        place = np.column_stack([PLACE_RANGE * numbers[:, :2], np.ones(len(numbers))])
        yaw = np.pi * numbers[:, 2] - frame.turn
        back = np.linalg.inv(frame.matrix)
        rows += [(place @ back.T)[:, :2], np.cos(yaw)[:, None], np.sin(yaw)[:, None], numbers[:, 3:]]
    return np.concatenate(rows, axis=1)


def action_of(row: Rows, frames: list[Shift]) -> Rows:
    """Return the action of a row of `canonical`."""
    numbers = []
    for command, frame in zip(np.split(row, 2), frames, strict=True):
        place = frame.matrix @ [*command[:2], 1.0]
        yaw = np.arctan2(command[3], command[2]) + frame.turn
        hand = -1.0 if command[-1] < CLOSED else command[-1]
        wrapped = (yaw + np.pi) % (2.0 * np.pi) - np.pi
        numbers += [*(place[:2] / PLACE_RANGE), wrapped / np.pi, *command[4:-1], hand]
    return np.clip(numbers, -1.0, 1.0).astype(np.float32)


# The policy.


class ChunkPolicy:
    """Acts in an episode: one chunk of commands a phase, from how both parts stood before it was begun."""

    def __init__(self, demos: Demonstrations, folder: Path) -> None:
        episodes = [_rows(folder, record.index) for record in demos.episodes]
        self.starts = Starts(demos.max_parts, episodes[0]["observation.environment_state"])
        samples: dict[tuple[bool, ...], list[tuple[Rows, Rows]]] = {}
        for rows in episodes:
            shifts = self.starts.shifts(rows["observation.environment_state"][0])
            holds = rows["observation.state"].reshape(-1, 2, len(ROBOT_FIELDS))[..., HOLDS] > 0.5
            for phase in {tuple(pair) for pair in holds.tolist()}:
                actions = rows["action"][(holds == phase).all(axis=1)]
                chunk = canonical(actions, self._frames(shifts, phase))
                samples.setdefault(phase, []).append((_features(shifts), chunk))
        self.models = {phase: PhaseModel(chunks) for phase, chunks in samples.items()}

    def reset(self, observation: Mapping[str, Rows]) -> None:
        """Begin an episode."""
        self._shifts = self.starts.shifts(environment_state(observation))
        self._phase: tuple[bool, ...] = ()

    def act(self, observation: Mapping[str, Rows]) -> Rows:
        """Return the next action; hands that hold what no demonstration holds change nothing."""
        phase = tuple((robot_state(observation).reshape(2, -1)[:, HOLDS] > 0.5).tolist())
        if phase != self._phase and phase in self.models:
            self._phase, self._step = phase, 0
            self._chunk = self.models[phase].predict(_features(self._shifts))
        row = self._chunk[min(self._step, len(self._chunk) - 1)]
        self._step += 1
        return action_of(row, self._frames(self._shifts, self._phase))

    @staticmethod
    def _frames(shifts: list[Shift], phase: tuple[bool, ...]) -> list[Shift]:
        """Return each robot's frame: that of its part, or the world's once the robot holds it."""
        return [NOWHERE if holds else shift for shift, holds in zip(shifts, phase, strict=True)]


class PhaseModel:
    """Predicts the commands of a phase: a classifier picks a way to do it, a regression gives its commands.

    The planner does a phase in a few ways, such as a drive on either side of a post; a mean of two ways would be none.
    Demonstrations that are alike are a way; what only a few do is left out.

    Args:
        chunks: features and commands of each demonstration.
    """

    def __init__(self, chunks: list[tuple[Rows, Rows]]) -> None:
        longest = max(len(chunk) for _, chunk in chunks)
        # A chunk that ends early goes on with its last command.
        whole = np.stack([chunk[np.minimum(np.arange(longest), len(chunk) - 1)].ravel() for _, chunk in chunks])
        features = np.stack([row for row, _ in chunks])
        labels = DBSCAN(eps=ALIKE * np.sqrt(whole.shape[1]), min_samples=3).fit_predict(whole)
        if (labels == -1).all():
            labels[:] = 0
        sizes = {int(way): int((labels == way).sum()) for way in set(labels.tolist()) - {-1}}
        ways = [way for way, size in sizes.items() if size >= FEWEST] or [max(sizes, key=lambda way: sizes[way])]
        self.regressions = {
            way: _quadratic(Ridge(1e-2)).fit(features[labels == way], whole[labels == way]) for way in ways
        }
        classifier = LogisticRegression(max_iter=1000) if len(ways) > 1 else DummyClassifier()
        known = np.isin(labels, ways)
        self.classifier = _quadratic(classifier).fit(features[known], labels[known])
        print(f"a phase of up to {longest} steps: {' and '.join(str(sizes[way]) for way in ways)} demonstrations alike")

    def predict(self, features: Rows) -> Rows:
        """Return the commands of the phase, a row of 24 for each step."""
        (way,) = self.classifier.predict(features[None])
        return self.regressions[int(way)].predict(features[None]).reshape(-1, 24)


def _quadratic(model: BaseEstimator) -> Pipeline:
    return make_pipeline(StandardScaler(), PolynomialFeatures(2), model)


def _features(shifts: list[Shift]) -> Rows:
    return np.array([number for s in shifts for number in (s.x, s.y, s.turn)])


def _rows(folder: Path, index: int) -> dict[str, Rows]:
    table = pq.read_table(folder / f"data/chunk-{index // CHUNK:03d}/file-{index % CHUNK:03d}.parquet")
    names = ("observation.state", "observation.environment_state", "action")
    return {name: np.stack(table.column(name).to_numpy(zero_copy_only=False)) for name in names}


def main() -> None:
    """Train, and count successes from new starts."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("demos", type=Path, help="a LeRobot data set of one merge with --control joint_position")
    parser.add_argument("--starts", type=int, default=50, help="number of new starts")
    parser.add_argument("--seed", type=int, default=40_000, help="seed of the first one")
    args = parser.parse_args()
    begun = time.monotonic()
    demos = Demonstrations(args.demos)
    if (demos.config.task, demos.config.control) != ("merge", "joint_position"):
        parser.error("the demonstrations must be of --task merge, with --control joint_position")
    policy = ChunkPolicy(demos, args.demos)
    print(f"trained on {len(demos.episodes)} demonstrations in {time.monotonic() - begun:.1f} s")
    seen = {record.seed for record in demos.episodes}
    env = demos.config.make_env(catalogue.find(demos.episodes[0].furniture), demos.max_parts)
    longest = 2 * max(record.frames for record in demos.episodes)
    successes = 0
    for seed in range(args.seed, args.seed + args.starts):
        assert seed not in seen
        observation, info = env.reset(seed=seed, options=demos.config.reset_options())
        policy.reset(observation)
        for _ in range(longest):
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            if terminated or truncated:
                break
        successes += info["is_success"]
        ending = "joined" if info["is_success"] else info["failure"] or "not joined"
        print(f"start {seed}: {ending} after {info['seconds']:.1f} s", flush=True)
    print(f"{successes} of {args.starts} new starts succeed")


if __name__ == "__main__":
    main()
