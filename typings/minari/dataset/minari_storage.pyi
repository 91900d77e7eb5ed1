from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gymnasium import Space
from gymnasium.envs.registration import EnvSpec
from minari.data_collector import EpisodeBuffer

class MinariStorage:
    @classmethod
    def new(
        cls,
        data_path: Path,
        observation_space: Space[Any] | None = ...,
        action_space: Space[Any] | None = ...,
        env_spec: EnvSpec | None = ...,
        data_format: str = ...,
    ) -> MinariStorage: ...
    def update_episodes(self, episodes: Iterable[EpisodeBuffer]) -> None: ...
    def update_metadata(self, metadata: Mapping[str, Any]) -> None: ...
