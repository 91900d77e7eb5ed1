"""Successful episodes as a Minari data set, for learners that read those.

Minari keeps its data sets in a folder of folders (`$MINARI_DATASETS_PATH`, by default `~/.minari/datasets`), each named
like `chairs-v0`. So what is exported to `data/chairs-v0` is loaded by

    MINARI_DATASETS_PATH=data python -c 'import minari; print(minari.load_dataset("chairs-v0"))'

Observations, actions and rewards are those of `RoboAssembly/ObjectCentric-v0`; `recover_environment()` makes it again,
and each episode's metadata has its `seed` and `options`, so that every episode can be replayed.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from roboassembly import __version__
from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs import OBJECT_CENTRIC
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.evaluation.rollout import Episode

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

CLOUD_POINTS = 128
"""Points of each part's cloud in exported observations: the environment's own default."""
_ID = re.compile(r"[-\w]+-v\d+")


@dataclass(frozen=True)
class Exported:
    """What was written."""

    path: Path
    episodes: int
    steps: int
    refused: int
    """Successful episodes that did not succeed again in the environment: the search's paths may be others."""


def check_target(path: Path) -> None:
    """That a data set can be written there, before long work begins.

    Raises:
        MissingExtraError: Minari is not installed.
        InputError: no name for a data set, or something is there already.
    """
    try:
        import h5py  # noqa: F401
        import minari  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError(str(error.name), "learn") from None
    if not _ID.fullmatch(path.name):
        raise InputError(f"--export {path}: '{path.name}' is no name of a Minari data set; like 'chairs-v0' would do")
    if path.exists():
        raise InputError(f"--export {path}: there is something already; name a new folder")


def export(
    path: Path, played: Iterable[tuple[FurnitureRef, Episode]], policy: str, cloud_points: int = CLOUD_POINTS
) -> Exported:
    """Replay successful episodes in the environment and write them, whole or not at all.

    Args:
        path: a folder that is not there yet, named like `chairs-v0`.
        played: pieces, and what was played with them; failed episodes are left out.
        policy: what chose the actions, for the data set's description.
        cloud_points: of each part, in the observations.

    Raises:
        MissingExtraError: Minari is not installed.
        InputError: the path is of no use, or there is no successful episode.
    """
    check_target(path)
    from minari.dataset.minari_storage import MinariStorage

    good = [(pick, episode) for pick, episode in played if episode.success and episode.actions]
    if not good:
        raise InputError(f"--export {path}: no episode succeeded, so there is nothing to export")
    names = list(dict.fromkeys(_furniture_name(pick) for pick, _ in good))
    env = gymnasium.make(OBJECT_CENTRIC, furniture=names, cloud_points=cloud_points, disable_env_checker=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    written = steps = 0
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent.resolve()) as scratch:
        storage = MinariStorage.new(
            Path(scratch) / "data", env.observation_space, env.action_space, env.spec, data_format="hdf5"
        )
        for pick, episode in good:
            buffer = _replay(env, episode, names.index(_furniture_name(pick)), written)
            if buffer is not None:
                storage.update_episodes([buffer])
                written, steps = written + 1, steps + len(buffer)
        if not written:
            raise InputError(f"--export {path}: none of {len(good)} episodes succeeded again; nothing to export")
        storage.update_metadata(_metadata(path.name, policy))
        (Path(scratch) / path.name).mkdir()
        shutil.move(Path(scratch) / "data", Path(scratch) / path.name / "data")
        (Path(scratch) / path.name).rename(path)
    return Exported(path, written, steps, len(good) - written)


def _furniture_name(pick: FurnitureRef) -> str:
    """As the environment takes it."""
    return pick.name if pick.folder is None else str(pick.folder)


def _metadata(name: str, policy: str) -> dict[str, Any]:
    from minari import __version__ as minari_version

    return {
        "dataset_id": name,
        "minari_version": minari_version,
        "algorithm_name": policy,
        "description": f"Successful episodes of {OBJECT_CENTRIC}, chosen by {policy}.",
        "requirements": [f"roboassembly=={__version__}"],
    }


def _replay(env: gymnasium.Env[Any, Any], episode: Episode, index: int, number: int) -> EpisodeBuffer | None:
    """The episode again; None if it does not succeed."""
    from minari.data_collector import EpisodeBuffer

    options = {"furniture": index}
    observation, info = env.reset(seed=episode.seed, options=options)
    seen, rewards = [observation], []
    for action in episode.actions:
        observation, reward, terminated, _, info = env.step(np.array(action))
        seen.append(observation)
        rewards.append(float(reward))
        if terminated:
            break
    if not info["success"]:
        return None
    n = len(rewards)
    return EpisodeBuffer(
        id=number,
        seed=episode.seed,
        options=options,
        observations={key: np.array([o[key] for o in seen]) for key in seen[0]},
        actions=np.array(episode.actions[:n], np.int64),  # pyright: ignore[reportArgumentType] (arrays are stored as they are)
        rewards=rewards,
        terminations=[False] * (n - 1) + [True],
        truncations=[False] * n,
        infos={},
    )
