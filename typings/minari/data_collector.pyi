# The part of Minari that this project uses; its own types are of bare lists and dictionaries. tests/test_stubs.py
# compares it with the library.
from collections.abc import Mapping
from typing import Any

import numpy as np

class EpisodeBuffer:
    def __init__(
        self,
        *,
        id: int | None = ...,
        seed: int | None = ...,
        options: Mapping[str, Any] | None = ...,
        observations: Mapping[str, np.ndarray] | None = ...,
        actions: np.ndarray | None = ...,
        rewards: list[float] = ...,
        terminations: list[bool] = ...,
        truncations: list[bool] = ...,
        infos: Mapping[str, Any] | None = ...,
    ) -> None: ...
    def __len__(self) -> int: ...
