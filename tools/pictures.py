"""Draws the pictures and the film of the documentation, into docs/images.

python tools/pictures.py              # all of them
python tools/pictures.py film rooms   # some of them, by name
"""

import sys
import tomllib
from collections.abc import Callable
from html import escape
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from PIL import Image

from drawing import Piece, drawn, hand
from roboassembly.control.cameras import CAMERAS
from roboassembly.control.env import ControlEnv
from roboassembly.control.randomization import Randomization
from roboassembly.control.replay import commands_of
from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Part
from roboassembly.generate import CHAIRS, FAMILIES
from roboassembly.geometry.poses import SE3
from roboassembly.learning.policy import guide_of
from roboassembly.learning.registry import load_policy
from roboassembly.manual.document import pages_of, title_of
from roboassembly.manual.make import make_manual
from roboassembly.manual.writers import pdf
from roboassembly.rendering.colors import WOOD, distinct_colors
from roboassembly.rendering.renderer import Quality
from roboassembly.robots.gripper import hand_pose
from roboassembly.settings import set_upright
from roboassembly.solvers.full_search import solve_full
from roboassembly.solvers.options import grasping
from roboassembly.solvers.search import solve
from roboassembly.viewer.camera_path import follow
from roboassembly.viewer.film import film_scene, render_contact_sheet, shots, write_storyboard
from roboassembly.viewer.film_segments import draw_shots
from roboassembly.viewer.playback import AnyPlan, make_timeline

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
LOOP = Quality(scale=1, samples=4, shadow_size=2048, shadow_taps=(12, 20))
"""Quality of the film of the README."""
MANUAL_PAGE = 4
"""Page of a manual that stands for it in README, from 0."""


def part_in_hands(part: Part, turn: np.ndarray, size: int) -> np.ndarray:
    """Draw one part as it stands in the furniture, with a closed hand at each of its grasp regions."""
    pose = SE3(turn, np.zeros(3))
    pieces: list[Piece] = [(part.mesh, pose, WOOD)]
    for region in part.grasps:
        pieces += hand(pose * hand_pose(region.position, region.closing, region.approaches[0]), region.width)
    return drawn(pieces, size, size)


def write_grasps(name: str, path: Path, columns: int, size: int) -> None:
    """Draw one part of each shape of some furniture, each in two hands."""
    furniture = catalogue.find(name)
    tiles = []
    for shape in furniture.classes:
        part, slot = furniture.parts[shape.members[0]], furniture.assembled[shape.members[0]]
        tiles.append(part_in_hands(part, slot.rotation, size))
    tiles += [np.full_like(tiles[0], tiles[0][0, 0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    iio.imwrite(path, np.concatenate(rows))


def write_loop(plan: AnyPlan, path: Path, *, width: int, height: int, fps: int, seconds_per_step: float) -> None:
    """Write the film of a plan as an animated WebP, which code hosts play in a page; it pauses at its end."""
    timeline = make_timeline(plan, fps, seconds_per_step)
    with film_scene(timeline, width, height, LOOP).renderer() as renderer:
        drawn = draw_shots(renderer, shots(timeline, follow(timeline, width / height)))
        first, *others = (Image.fromarray(picture) for picture in drawn)
    durations = [*[1000 // fps] * len(others), 3000]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, quality=55, method=4)


def draw_film() -> None:
    """Draw the film of the README: two robots assemble a chair and set it upright."""
    plan = set_upright(solve_full(catalogue.make("splat", 1), 1).plan)
    write_loop(plan, IMAGES / "two_robots.webp", width=960, height=540, fps=10, seconds_per_step=4.0)


def draw_two_robots() -> None:
    """Draw the steps of a stool that two robots assemble."""
    plan = set_upright(solve_full(catalogue.make("stool"), 0).plan)
    write_storyboard(plan, IMAGES / "two_robots_steps.webp")


def draw_control() -> None:
    """Draw what the four cameras of `Control-v0` see as a merge ends: without and with randomization."""
    rows: list[np.ndarray] = []
    for ranges in (None, Randomization.full()):
        env = ControlEnv(
            "stool", task="merge", obs="rgbd", segmentation=True, camera_width=240, camera_height=180,
            randomization=ranges,
        )  # fmt: skip
        env.reset(seed=1, options={"merge": 5})
        assert env.merge is not None
        task, state = env.task, env.state
        actions = grasping(task, state, state.groups, *(frozenset(group) for group in env.merge.groups))
        step = next(step for action in actions if (step := task.step(state, action, 0).step) is not None)
        seen: dict[str, np.ndarray] = {}
        for targets, openings in commands_of(step.segments, env.cell):
            seen, _, over, *_ = env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
            if over:
                break
        env.close()
        rows.append(np.concatenate([seen[f"rgb_{camera}"] for camera in CAMERAS], axis=1))
        if ranges is None:
            near = [255 * np.clip(seen[f"depth_{camera}"] / 6.0, 0.0, 1.0) for camera in CAMERAS]
            rows.append(np.repeat(np.concatenate(near, axis=1).astype(np.uint8)[..., None], 3, axis=2))
            kinds = np.concatenate([seen[f"segmentation_{camera}"] for camera in CAMERAS], axis=1)
            colors = np.array([(1.0, 1.0, 1.0), *distinct_colors(range(int(kinds.max())))])
            rows.append((255 * colors[kinds]).astype(np.uint8))
    iio.imwrite(IMAGES / "control.png", np.concatenate(rows))


def draw_storyboard() -> None:
    """Draw the steps of a chair whose parts move by themselves."""
    plan = set_upright(solve(catalogue.make("ladder"), 0).plan)
    write_storyboard(plan, IMAGES / "storyboard.webp")


def draw_sixty() -> None:
    """Draw sixty chairs, of all families."""
    pieces = [catalogue.make(list(CHAIRS)[i % len(CHAIRS)], 1 + i // len(CHAIRS)) for i in range(60)]
    render_contact_sheet(pieces, IMAGES / "sixty.webp", columns=10, size=140, names=False)


ROOMS = {
    "cli": "commands",
    "bench": "speed against other libraries",
    "studio": "the page in the browser",
    "manual": "manuals for people",
    "viewer": "films, pages, playback",
    "evaluation": "rollouts, benchmark table",
    "learning": "policies, paper/ and relational/",
    "demonstrations": "data sets of control",
    "settings": "what differs between the settings",
    "audit": "plans checked by python-fcl",
    "control": "continuous control",
    "envs": "Gymnasium environments",
    "solvers": "search, oracle, baselines",
    "rendering": "pictures off screen",
    "task": "rules, object_centric/, full/, plans/",
    "planning": "collision worlds, RRT-Connect",
    "simulation": "MuJoCo: settling, execution",
    "datasets": "sets, catalogue",
    "generate": "furniture families",
    "importers": "furniture formats",
    "repair": "gaps, trimming",
    "furniture": "parts, contacts, grasps, storage",
    "robots": "mobile Franka, reach",
    "geometry": "poses, meshes, scenes",
    "parallel": "processes, Ray",
    "statistics": "intervals",
    "atomic_file": "whole files",
    "errors": "one-line errors",
}
"""What each room of the package holds."""


def draw_manual(path: Path, width: int) -> None:
    """Draw a page of the manual of the built-in chair."""
    import pypdfium2

    piece = catalogue.make("ladder")
    guide = guide_of(load_policy("relational"))
    manual = make_manual(piece, [step.action for step in solve(piece, 0, guide=guide).plan.steps], 0)
    document = pypdfium2.PdfDocument(pdf(pages_of(manual), title_of(manual)))
    page = document[MANUAL_PAGE]
    picture = page.render(scale=2 * width / page.get_width()).to_pil()
    picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS).save(
        path, quality=90, method=6
    )


def draw_rooms() -> None:
    """Draw the rooms of the package, layer above layer, as the import contract in pyproject.toml has them."""
    (IMAGES / "rooms.svg").write_text(rooms_picture())


def rooms_picture() -> str:
    """Return the SVG of `draw_rooms`."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = [line.replace("roboassembly.", "").split(" | ") for line in contracts[0]["layers"]]
    width, high, gap, top = 760, 40, 8, 34
    height = top + len(layers) * (high + gap) + 4
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        ' font-family="Helvetica, Arial, sans-serif">',
        f'<rect width="{width}" height="{height}" rx="6" fill="#ffffff"/>',
        '<text x="16" y="22" font-size="13" fill="#555555">A room imports only from rooms below it.</text>',
    ]
    for row, rooms in enumerate(layers):
        wide = (width - 32 - gap * (len(rooms) - 1)) / len(rooms)
        for column, room in enumerate(rooms):
            x, y = 16 + column * (wide + gap), top + row * (high + gap)
            color = _shade(row, len(layers))
            text = f'<text x="{x + 12:.0f}"'
            end = "/" if (ROOT / "src" / "roboassembly" / room).is_dir() else ".py"
            out += [
                f'<rect x="{x:.0f}" y="{y}" width="{wide:.0f}" height="{high}" rx="5" fill="{color}"/>',
                f'{text} y="{y + 17}" font-size="14" font-weight="bold" fill="#222222">{room}{end}</text>',
                f'{text} y="{y + 33}" font-size="12" fill="#444444">{escape(ROOMS[room])}</text>',
            ]
    return "\n".join([*out, "</svg>"]) + "\n"


def _shade(row: int, rows: int) -> str:
    """A colour from light orange at the top to light brown at the bottom."""
    share = row / max(1, rows - 1)
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in ((255, 222), (226, 205), (186, 190)))


PICTURES: dict[str, Callable[[], None]] = {
    "film": draw_film,
    "storyboard": draw_storyboard,
    "two_robots": draw_two_robots,
    "grasps": lambda: write_grasps("ladder", IMAGES / "grasps.png", columns=5, size=200),
    "families": lambda: render_contact_sheet(
        [catalogue.make(f) for f in FAMILIES], IMAGES / "families.webp", columns=7, size=200
    ),
    "sixty": draw_sixty,
    "manual": lambda: draw_manual(IMAGES / "manual.webp", width=760),
    "control": draw_control,
    "rooms": draw_rooms,
}

if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        PICTURES[chosen]()
