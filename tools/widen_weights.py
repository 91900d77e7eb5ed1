"""Converts the relational policy of November 2026 to the inputs of its successor: same function in aligned frames.

python tools/widen_weights.py OLD.npz NEW.npz

New inputs get weights of 0, so that training can start from the old policy.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from roboassembly.learning import archive

META = "meta.json"
POINT = [0, 1, 21, 22, 23, 24, 25, 26, *range(27, 36), 17, 18, 19, 36]
"""New place of each old point feature."""
PAIR = [*range(10), 63, *range(64, 67), *range(67, 70), 70, 10, 11, 71, *range(72, 75), *range(12, 27)]
"""New place of each old pair feature."""
AXIS = [0, 1, 2, 3, 4, 6, 7]
"""New place of each old feature of `w`."""
INPUTS = {"point/0/w": (POINT, 37), "pair_features/w": (PAIR, 75), "q_axis/w": (AXIS, 15)}
"""Arrays that grow, with the new places of their rows and their new number of rows."""


def widen(old: Path, new: Path) -> None:
    """Convert a file."""
    with np.load(old, allow_pickle=False) as z:
        arrays = {name: z[name] for name in z.files}
    for name, value in arrays.items():
        for suffix, (places, rows) in INPUTS.items():
            if name in (f"params/{suffix}", f"params/full/{suffix}"):
                if len(value) != len(places):
                    raise SystemExit(f"{old}: '{name}' has {len(value)} rows, expected {len(places)}")
                wide = np.zeros((rows, *value.shape[1:]), value.dtype)
                wide[places] = value
                arrays[name] = wide
    meta = json.loads(bytes(arrays[META]).decode())
    arrays[META] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    archive.write(new, arrays)


if __name__ == "__main__":
    widen(Path(sys.argv[1]), Path(sys.argv[2]))
