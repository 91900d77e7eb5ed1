"""Draws the failed episodes of a policy, one row per episode.

    roboassembly evaluate --policy relational --set SET --json > episodes.json
    python tools/failures.py episodes.json PICTURE.png [NAME ...]

Without names, it draws the first failed episode of each verdict, or of each kind of failure with robots. A row shows,
from left to right: the groups as they lay before the last action, with its two groups in colours; the two groups as the
action would join them, with the hands that would hold them if there are robots; the same parts where they belong.
"""

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np

from drawing import Piece, drawn, hand
from roboassembly.datasets.sets import FurnitureRef, furniture_refs
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.colors import Color
from roboassembly.task.full.failure import coarse_kind
from roboassembly.task.full.grips import grip_of
from roboassembly.task.rules.groups import Group, TaskState

WIDTH, HEIGHT = 480, 340
MOVED, WAITING, OTHER = (0.30, 0.50, 0.80), (0.88, 0.55, 0.25), (0.80, 0.80, 0.78)


def of_group(furniture: Furniture, group: Group, at: SE3, color: Color) -> Iterable[Piece]:
    """Yield the parts of a group whose frame is at a pose."""
    for part, pose in zip(group.parts, group.furniture_from_part, strict=True):
        yield furniture.parts[part].mesh, at * pose, color


def of_hand(furniture: Furniture, group: Group, at: SE3, part: int, grasp: int) -> Iterable[Piece]:
    """Yield the closed hand that holds a part of a group."""
    held = grip_of(furniture, group, part, grasp)
    if held is not None:
        yield from hand(at * held.furniture_from_tips, held.closed)


def row(furniture: Furniture, env: Any, state: TaskState, action: Sequence[int]) -> np.ndarray:
    """Draw the three pictures of a last action."""
    u, v, k, l, *ways = action  # noqa: E741
    moved, waiting = (state.groups[state.group_of[part]] for part in (u, v))
    color = {id(moved): MOVED, id(waiting): WAITING}
    lay = [p for g in state.groups for p in of_group(furniture, g, g.world_from_furniture, color.get(id(g), OTHER))]

    pairs, still = env.task.rules.pairs, SE3.Identity()
    dictated = pairs.dictated(moved, waiting, u, k, v, l)
    joined = [*of_group(furniture, waiting, still, WAITING), *of_group(furniture, moved, dictated, MOVED)]
    if len(ways) == 2:
        joined += of_hand(furniture, moved, dictated, u, ways[0])
        joined += of_hand(furniture, waiting, still, v, ways[1])

    assigned = pairs.assign_slots(state) or state
    slots = {state.group_of[u]: MOVED, state.group_of[v]: WAITING}
    colors = {slot: slots.get(i, OTHER) for i, group in enumerate(assigned.groups) for slot in group.slots}
    belong = [
        (part.mesh, pose, colors.get(i, OTHER))
        for i, (part, pose) in enumerate(zip(furniture.parts, furniture.assembled, strict=True))
    ]
    return np.concatenate([drawn(pieces, WIDTH, HEIGHT) for pieces in (lay, joined, belong)], axis=1)


def found(picks: Sequence[FurnitureRef], name: str, full: bool) -> Furniture:
    """Return the piece of a set with a name, which may differ from the name of its folder."""
    likely = sorted(picks, key=lambda p: p.name.replace(":", "-") != name)
    return next(f for f in (p.furniture(with_grasps=full) for p in likely) if f.name == name)


def main(source: Path, picture: Path, names: Sequence[str]) -> None:
    """Draw one picture of all rows, and print what each row shows."""
    report = json.loads(source.read_text())
    full = report["setting"] == "full"
    failed = [e for e in report["per_furniture"] if not e["success"] and len(e["actions"]) > e["merges"]]
    first = {coarse_kind(e["verdict"], e["stage"]) if full else e["verdict"]: e for e in reversed(failed)}
    chosen = [e for e in failed if e["furniture"] in names] if names else list(first.values())
    if not chosen:
        sys.exit(f"{source} has no such failed episode; failed are: {', '.join(e['furniture'] for e in failed)}")
    picks = furniture_refs(report["set"])
    rows = []
    for episode in chosen:
        furniture = found(picks, episode["furniture"], full)
        env: Any = (FullEnv if full else ObjectCentricEnv)(furniture, frames=report["frames"])
        env.reset(seed=episode["seed"])
        for action in episode["actions"][:-1]:
            env.step(np.array(action))
        last = episode["actions"][-1]
        rows.append(row(furniture, env, env.task.groups_of(env.state), last))
        why = f"{episode['verdict']} {episode['reason']}".strip()
        print(f"{episode['furniture']}: merge {episode['merges'] + 1} of {len(furniture.parts) - 1}, {why}")
    iio.imwrite(picture, np.concatenate(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
