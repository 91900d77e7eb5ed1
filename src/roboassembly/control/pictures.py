"""Pictures of an episode: those of the cameras that are observed, and those of `render`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from jaxtyping import UInt8

from roboassembly.control.cameras import CAMERAS, FAR, FIRST_PART, CellCameras, CellView
from roboassembly.control.cell import ControlCell
from roboassembly.control.looks import draw_looks
from roboassembly.control.randomization import Variation
from roboassembly.furniture.model import Furniture
from roboassembly.robots.body import placed


@dataclass(frozen=True)
class PictureConfig:
    """Cameras that are observed, and sizes of pictures."""

    cameras: tuple[str, ...]
    camera_width: int
    camera_height: int
    depth: bool
    """Whether distances are observed."""
    segmentation: bool
    """Whether it is observed what each pixel shows."""
    width: int
    """Width of the pictures of `render` [pixels]."""
    height: int


def picture_space(config: PictureConfig, max_parts: int) -> dict[str, spaces.Space[np.ndarray]]:
    """Return the spaces of the pictures that are observed."""
    shape = (config.camera_height, config.camera_width)
    out: dict[str, spaces.Space[np.ndarray]] = {}
    for camera in config.cameras:
        out[f"rgb_{camera}"] = spaces.Box(0, 255, (*shape, 3), np.uint8)
        if config.depth:
            out[f"depth_{camera}"] = spaces.Box(0.0, FAR, shape, np.float32)
        if config.segmentation:
            out[f"segmentation_{camera}"] = spaces.Box(0, FIRST_PART + max_parts - 1, shape, np.uint16)
    return out


class EpisodeCameras:
    """Draws the pictures of one episode after another; graphics resources are made when they are first needed.

    Args:
        config: cameras and sizes.
    """

    def __init__(self, config: PictureConfig) -> None:
        self.config = config
        self._cameras: CellCameras | None = None
        self._made_for: tuple[Furniture, float, int | None] | None = None
        self._variation: Variation | None = None
        self._rng = np.random.default_rng(0)

    def start(self, cell: ControlCell, variation: Variation) -> None:
        """Begin an episode.

        Args:
            cell: robots and groups of the episode.
            variation: draws of the episode.
        """
        self._variation = variation
        # Other noise than that of the state, from the same seed.
        self._rng = np.random.default_rng([variation.sensors, 1])
        seed = variation.looks if variation.ranges.changes_pictures else None
        if self._made_for != (cell.furniture, cell.cell.radius, seed):
            self.close()
            self._made_for = cell.furniture, cell.cell.radius, seed

    def observe(self, cell: ControlCell) -> dict[str, np.ndarray]:
        """Return the pictures that are observed, with the noise of their sensors.

        Raises:
            RenderingUnavailableError: this machine cannot draw off screen.
        """
        config, out = self.config, dict[str, np.ndarray]()
        sizes = dict.fromkeys(config.cameras, (config.camera_width, config.camera_height))
        drawn = self._ready(cell).draw(view_of(cell), sizes, depth=config.depth, segmentation=config.segmentation)
        for camera, picture in drawn.items():
            out[f"rgb_{camera}"] = self._noisy(picture.rgb)
            if picture.depth is not None:
                out[f"depth_{camera}"] = picture.depth
            if picture.segmentation is not None:
                out[f"segmentation_{camera}"] = picture.segmentation
        return out

    def render(self, cell: ControlCell) -> UInt8[np.ndarray, "height width 3"]:
        """Return the picture of `render`.

        Raises:
            RenderingUnavailableError: this machine cannot draw off screen.
        """
        size = self.config.width, self.config.height
        return self._ready(cell).draw(view_of(cell), {"overview": size})["overview"].rgb

    def close(self) -> None:
        """Free the graphics resources; `observe` and `render` allocate them again."""
        if self._cameras is not None:
            self._cameras.close()
            self._cameras = None

    def _ready(self, cell: ControlCell) -> CellCameras:
        if self._cameras is None:
            assert self._variation is not None
            parts = len(cell.furniture.parts)
            looks = draw_looks(self._variation.ranges, parts, len(CAMERAS), self._variation.looks)
            config = self.config
            width, height = max(config.width, config.camera_width), max(config.height, config.camera_height)
            self._cameras = CellCameras(cell.furniture, cell.cell.radius, looks, width, height)
        return self._cameras

    def _noisy(self, rgb: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
        assert self._variation is not None
        noise = self._variation.ranges.pixel_noise
        if not noise:
            return rgb
        return np.clip(np.rint(rgb + self._rng.normal(0.0, noise, rgb.shape)), 0, 255).astype(np.uint8)


def view_of(cell: ControlCell) -> CellView:
    """Return the poses of all that a picture of a cell shows."""
    physics = cell.physics
    a, b = (tuple(pose for _, pose in placed(physics.configuration(robot), physics.opening(robot))) for robot in (0, 1))
    tips = physics.tips(0), physics.tips(1)
    return CellView(cell.part_sevens(), (a, b), [post.top for post in cell.posts], tips)
