"""Exports successful episodes as a Minari data set.

Minari keeps its data sets in a folder of folders (`$MINARI_DATASETS_PATH`, by default `~/.minari/datasets`), each named
like `chairs-v0`. So what is exported to `data/chairs-v0` is loaded by

    MINARI_DATASETS_PATH=data python -c 'import minari; print(minari.load_dataset("chairs-v0"))'

Observations, actions and rewards are those of `RoboAssembly/ObjectCentric-v0`; `recover_environment()` makes it again,
and each episode's metadata has its `seed` and `options`, so that every episode can be replayed.
"""

from __future__ import annotations

import importlib
import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from roboassembly import __version__
from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs import OBJECT_CENTRIC
from roboassembly.envs.assembly import reward_of
from roboassembly.envs.observation import Observer
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.evaluation.episodes import Episode
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rollout import rollout

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

CLOUD_POINTS = 128
"""Points of each part's cloud in exported observations; the environment's default."""
_ID = re.compile(r"[-\w]+-v\d+")


@dataclass(frozen=True)
class Exported:
    """Summary of a written data set."""

    path: Path
    episodes: int
    steps: int
    refused: int
    """Successful episodes that failed when run again: the search may have found other paths."""


def check_target(path: Path) -> None:
    """Check that a data set can be written to a path, before long work begins.

    Raises:
        MissingExtraError: Minari is not installed.
        InputError: the name suits no data set, or the path exists.
    """
    try:
        for needed in ("h5py", "minari"):
            importlib.import_module(needed)
    except ModuleNotFoundError as error:
        raise MissingExtraError(str(error.name), "learn") from None
    if not _ID.fullmatch(path.name):
        raise InputError(
            f"--export {path}: '{path.name}' is not the name of a Minari data set; expected one like 'chairs-v0'"
        )
    if path.exists():
        raise InputError(f"--export {path}: there is something already; name a new folder")


def export(
    path: Path, episodes: Iterable[tuple[FurnitureRef, Episode]], policy: str, cloud_points: int = CLOUD_POINTS
) -> Exported:
    """Replay successful episodes in the environment and write them, whole or not at all.

    Args:
        path: new folder, named like `chairs-v0`.
        episodes: pieces and their episodes; failed ones are left out.
        policy: name of what chose the actions, for the data set's description.
        cloud_points: points of each part's cloud in the observations.

    Raises:
        MissingExtraError: Minari is not installed.
        InputError: the path cannot be used, or there is no successful episode.
    """
    check_target(path)
    from minari.dataset.minari_storage import MinariStorage

    solved = [(ref, episode) for ref, episode in episodes if episode.success and episode.actions]
    if not solved:
        raise InputError(f"--export {path}: no episode succeeded, so there is nothing to export")
    names = list(dict.fromkeys(ref.argument for ref, _ in solved))
    env = gymnasium.make(OBJECT_CENTRIC, furniture=names, cloud_points=cloud_points, disable_env_checker=True)
    tasks: tuple[ObjectCentricTask, ...] = env.get_wrapper_attr("tasks")
    path.parent.mkdir(parents=True, exist_ok=True)
    written = steps = 0
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent.resolve()) as scratch:
        storage = MinariStorage.new(
            Path(scratch) / "data", env.observation_space, env.action_space, env.spec, data_format="hdf5"
        )
        for ref, episode in solved:
            index = names.index(ref.argument)
            buffer = _replay(tasks[index], episode, index, written, cloud_points)
            if buffer is not None:
                storage.update_episodes([buffer])
                written, steps = written + 1, steps + len(buffer)
        if not written:
            raise InputError(f"--export {path}: none of {len(solved)} episodes succeeded again; nothing to export")
        storage.update_metadata(_metadata(path.name, policy))
        (Path(scratch) / path.name).mkdir()
        shutil.move(Path(scratch) / "data", Path(scratch) / path.name / "data")
        (Path(scratch) / path.name).rename(path)
    return Exported(path, written, steps, len(solved) - written)


def _metadata(name: str, policy: str) -> dict[str, Any]:
    from minari import __version__ as minari_version

    return {
        "dataset_id": name,
        "minari_version": minari_version,
        "algorithm_name": policy,
        "description": f"Successful episodes of {OBJECT_CENTRIC}, chosen by {policy}.",
        "requirements": [f"roboassembly=={__version__}"],
    }


def _replay(
    task: ObjectCentricTask, episode: Episode, index: int, number: int, cloud_points: int
) -> EpisodeBuffer | None:
    """Run the episode's actions again as the environment does; None if the episode does not succeed."""
    from minari.data_collector import EpisodeBuffer

    rng = np.random.default_rng(episode.seed)
    actions = iter(episode.actions)
    initial = task.initial_state(rng)
    tried = list(rollout(task, initial, lambda _: islice(actions, 1), rng))
    if not tried or not tried[-1].outcome.state.complete:
        return None
    observer = Observer(task.furniture, *task.furniture.padding, cloud_points)
    seen = [observer.observe(state) for state in (initial, *(t.outcome.state for t in tried))]
    n = len(tried)
    return EpisodeBuffer(
        id=number,
        seed=episode.seed,
        options={"furniture": index},
        observations={key: np.array([o[key] for o in seen]) for key in seen[0]},
        actions=np.array([t.action for t in tried], np.int64),
        rewards=[reward_of(t.merged, t.outcome.state.complete) for t in tried],
        terminations=[False] * (n - 1) + [True],
        truncations=[False] * n,
        infos={},
    )
