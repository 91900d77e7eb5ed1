"""Converts a checkpoint of the relational policy from format 1 to format 2: same weights, new names.

python tools/convert_weights.py OLD.npz NEW.npz
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.learning import archive

META = "meta.json"
NETWORK = {
    "own": "point", "judge": "pair", "right": "fits", "end": "conflict_input", "conflict_1": "conflict_first",
    "conflict_2": "conflict_second", "conflict_rel": "conflict_pose", "pair_own": "pair_features", "q_way": "q_axis",
    "held": "grasp_token", "hold": "grasp", "room": "clearance",
}  # fmt: skip
"""New names of the arrays of the network that values pairs."""
GRASPS = {"a": "grasp_a", "b": "grasp_b", "pair": "mate", "take": "pick", "two": "grasp_pair"}
"""New names of the arrays of the network that chooses grasps."""
CONFIG = {"ends": "conflict_inputs", "views": "augment", "blind": "hide_surface", "plays": "episodes"}
"""New names of settings."""


def new_name(name: str) -> str:
    """Return the new path of an array in the file."""
    section, *path = name.split("/")
    if section != "params":
        return name
    if path[0] == "hands":
        path = ["grasps", GRASPS.get(path[1], path[1]), *path[2:]]
    elif path[0] == "held":
        path = ["full", NETWORK.get(path[1], path[1]), *path[2:]]
    else:
        path[0] = NETWORK.get(path[0], path[0])
    return "/".join([section, *path])


def new_config(value: Any) -> Any:
    """Return a configuration with the new names."""
    return {CONFIG.get(k, k): new_config(v) for k, v in value.items()} if isinstance(value, dict) else value


def convert(old: Path, new: Path) -> None:
    """Convert a file.

    Raises:
        SystemExit: the file is no relational policy of format 1.
    """
    with np.load(old, allow_pickle=False) as z:
        arrays = {name: z[name] for name in z.files}
    meta = json.loads(bytes(arrays.pop(META)).decode())
    if meta["format"] != 1 or meta["kind"] != "relational":
        raise SystemExit(
            f"{old} holds a '{meta['kind']}' network of format {meta['format']}, not a relational one of 1"
        )
    meta |= {"format": 2, "config": new_config(meta["config"])}
    renamed = {new_name(name): array for name, array in arrays.items()}
    archive.write(new, {**renamed, META: np.frombuffer(json.dumps(meta).encode(), np.uint8)})


if __name__ == "__main__":
    convert(Path(sys.argv[1]), Path(sys.argv[2]))
