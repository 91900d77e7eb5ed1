"""Draws the pictures of the README: `.venv/bin/python tools/pictures.py`."""

import tempfile
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from PIL import Image

from drawing import Piece, drawn, hand
from roboassembly.datasets import catalogue
from roboassembly.envs.observation import Observer
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture, Part
from roboassembly.generate import CHAIRS, FAMILIES
from roboassembly.geometry.poses import SE3
from roboassembly.learning.registry import load_policy
from roboassembly.rendering.colors import WOOD
from roboassembly.robots.gripper import hand_pose
from roboassembly.solvers.oracle import Oracle
from roboassembly.solvers.search import solve, solve_full
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.object_centric.upright import set_upright
from roboassembly.task.rules.groups import TaskState
from roboassembly.viewer.film import render_contact_sheet, render_meshes, write_film, write_storyboard
from roboassembly.viewer.playback import AnyPlan

IMAGES = Path(__file__).parents[1] / "docs" / "images"
GROUPS = [(0.85, 0.65, 0.35), (0.35, 0.55, 0.80), (0.80, 0.40, 0.35), (0.45, 0.70, 0.45), (0.65, 0.50, 0.75)]


def part_in_hands(part: Part, turn: np.ndarray, size: int) -> np.ndarray:
    """One part as it stands in the furniture, a closed hand at each of its grasp regions by its first direction."""
    pose = SE3(turn, np.zeros(3))
    pieces: list[Piece] = [(part.mesh, pose, WOOD)]
    for region in part.grasps:
        pieces += hand(pose * hand_pose(region.position, region.closing, region.approaches[0]), region.width)
    return drawn(pieces, size, size)


def write_grasps(name: str, path: Path, columns: int, size: int) -> None:
    """One part of each shape of some furniture, in hands."""
    furniture = catalogue.find(name)
    tiles = []
    for shape in furniture.classes:
        part, slot = furniture.parts[shape.members[0]], furniture.assembled[shape.members[0]]
        tiles.append(part_in_hands(part, slot.rotation, size))
    tiles += [np.full_like(tiles[0], tiles[0][0, 0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    iio.imwrite(path, np.concatenate(rows))


def groups_as_they_lie(furniture: Furniture, state: TaskState, width: int, height: int) -> np.ndarray:
    """A state of the object-centric task, its groups in colours of their own."""
    meshes = [part.mesh for part in furniture.parts]
    colors = [GROUPS[state.group_of[p] % len(GROUPS)] for p in range(len(meshes))]
    return render_meshes(meshes, state.part_poses, colors, width, height)


def write_dead_end(name: str, path: Path, *, width: int, height: int) -> None:
    """The policy alone, led into a dead end: before its last good state, and after the merge that shut a part out."""
    furniture = catalogue.find(name)
    task, policy = ObjectCentricTask(furniture), load_policy("relational")
    oracle, observer = Oracle(task), Observer(furniture, MAX_PARTS, MAX_POINTS, policy.cloud_points)
    state = task.initial_state(np.random.default_rng(0))
    while not state.complete:
        action = policy.act(observer.observe(state), task.existing_actions(state))
        after = task.step(state, tuple(int(i) for i in action), 0).state
        if after is state or not oracle.state_solvable(after):
            break
        state = after
    pictures = [groups_as_they_lie(furniture, s, width, height) for s in (state, after)]
    iio.imwrite(path, np.concatenate(pictures, axis=1))


def write_loop(plan: AnyPlan, path: Path, *, width: int, height: int, fps: int) -> None:
    """The film of a plan as an animated WebP, which pages show where they are read."""
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        write_film(plan, film, width=width, height=height, fps=fps)
        frames = [Image.fromarray(frame) for frame in iio.imiter(film, plugin="FFMPEG")]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=1000 // fps, loop=0, quality=40, method=4)


write_grasps("ladder", IMAGES / "grasps.png", columns=5, size=200)
write_dead_end("splat:8", IMAGES / "dead_end.png", width=480, height=320)
ladder = set_upright(solve(catalogue.make("ladder"), 0).plan)
write_storyboard(ladder, IMAGES / "storyboard.png", columns=4, width=360, height=240)
two_robots = set_upright(solve_full(catalogue.make("stool"), 0).plan)
write_storyboard(two_robots, IMAGES / "two_robots.png", columns=5, width=320, height=240)
write_loop(two_robots, IMAGES / "two_robots.webp", width=480, height=320, fps=8)
render_contact_sheet([catalogue.make(f) for f in FAMILIES], IMAGES / "families.png", columns=7, size=200)
sixty = [catalogue.make(list(CHAIRS)[i % len(CHAIRS)], 1 + i // len(CHAIRS)) for i in range(60)]
render_contact_sheet(sixty, IMAGES / "sixty.png", columns=10, size=140, names=False)
