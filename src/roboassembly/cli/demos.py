"""`roboassembly demos`: demonstrations for continuous control, planned and carried out in physics, as a data set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs, Ray, require_at_least, selected_furniture, workers
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, refuse_furniture_folder, show
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.demonstrations.config import DemoConfig
    from roboassembly.demonstrations.recording import DemoPiece
    from roboassembly.demonstrations.staging import EpisodeRecord

_DEFAULT = "stool"
CameraName = Literal["wrist_a", "wrist_b", "overview", "overview_back"]
"""Name of a camera, like `control.cameras.CAMERAS`, which is slow to import."""


@dataclass(frozen=True)
class DemosCommand:
    """Record demonstrations for RoboAssembly/Control-v0: plan, carry out in physics, keep what succeeds."""

    furniture: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[FURNITURE]")] = None
    """A built-in piece (`FAMILY` or `FAMILY:SEED`) or a furniture folder. Without it and --set: `stool`."""
    set: Annotated[str | None, tyro.conf.arg(name="set", metavar="SET")] = None
    """Furniture in place of a single piece: `NAME:SPLIT` of a data set, with the split train, easy, hard, test or all;
    or `folder:PATH`, a folder of furniture folders."""
    episodes: int = 10
    """Number of episodes of the data set. Run the same command again to continue, also with more episodes."""
    format: Literal["lerobot", "hdf5"] = "lerobot"
    """Format: lerobot (a LeRobot data set, version 3) or hdf5 (one file in robomimic's layout)."""
    task: Literal["piece", "merge"] = "piece"
    """Task of an episode: to assemble the piece, or one merge of it."""
    merge: int | None = None
    """Number of the merge, from 0, with --task merge. Without it, each episode draws one."""
    control: Literal["joint_position", "joint_delta", "end_effector_delta"] = "joint_delta"
    """Mode of control of the actions."""
    cameras: Annotated[tuple[CameraName, ...], tyro.conf.arg(metavar="[CAMERA [...]]")] = ()
    """Cameras whose pictures are recorded: wrist_a, wrist_b, overview, overview_back. Without it, none."""
    width: int = 128
    """Width of the pictures in pixels, even."""
    height: int = 128
    """Height of the pictures in pixels, even."""
    depth: bool = False
    """Record the distances of the pictures, too."""
    randomize: float = 0.0
    """Strength of the randomization of looks, physics, sensors and starts, from 0 to 1."""
    layout: int | None = None
    """Seed of one layout for all episodes: parts stand on the same posts, and the planner has the same seed, so that
    demonstrations are alike. Without it, each episode has a layout of its own."""
    part_position: float | None = None
    """Largest shift of each part along each axis at the start, in m, at most 0.02; without it, as --randomize says."""
    part_angle: float | None = None
    """Largest turn of each part about the vertical at the start, in rad, at most 0.2. Without it, as --randomize
    says."""
    seed: int = 0
    """Random seed of all starts and of the planner."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    out: Path = Path("demos")
    """Folder of the data set."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(0, seed=self.seed, merge=self.merge, layout=self.layout)
        require_at_least(1, episodes=self.episodes, jobs=self.jobs, width=self.width, height=self.height)
        if self.furniture is not None and self.set is not None:
            raise InputError("a piece of furniture and --set exclude each other; give only one of them")
        check_writable(self.out)
        refuse_furniture_folder(self.out)
        from roboassembly.demonstrations.collect import Collection
        from roboassembly.demonstrations.config import DemoConfig
        from roboassembly.demonstrations.extras import check_format

        check_format(self.format)
        config = DemoConfig(
            self.task, self.merge, self.control, self.cameras, self.width, self.height, self.depth, self.randomize,
            self.layout, self.part_position, self.part_angle, self.seed,
        )  # fmt: skip
        pieces, fingerprint, max_parts = self._pieces(config)
        collection = Collection(self.out, self.format, pieces, fingerprint, config, max_parts)
        with workers(self.ray, self.jobs) as jobs:
            bar = progress_bar(collection.record(self.episodes, jobs), total=self.episodes, unit="episode")
            added = list(bar)
        self._report(added)
        return DONE

    def _pieces(self, config: DemoConfig) -> tuple[list[DemoPiece], str, int]:
        """Return the pieces, their hash, and the largest number of parts."""
        from roboassembly.datasets import catalogue
        from roboassembly.datasets.sets import furniture_hash, set_hash
        from roboassembly.demonstrations.recording import DemoPiece

        if self.set is None:
            name = self.furniture or _DEFAULT
            piece = catalogue.find(name)
            config.check_merge(piece)
            return [DemoPiece(name)], furniture_hash(piece), len(piece.parts)
        refs = selected_furniture(self.set, None, None, 0)
        parts = [ref.furniture().parts if ref.entry is None else range(ref.entry.parts) for ref in refs]
        return [DemoPiece(ref.argument, ref) for ref in refs], set_hash(refs), max(map(len, parts))

    def _report(self, added: Sequence[EpisodeRecord | None]) -> None:
        from roboassembly.demonstrations.recording import NO_PLAN, UNSUITABLE

        new = [record for record in added if record is not None]
        failures = Counter(failure for record in new for failure in record.failures)
        planned = len(new) + sum(n for failure, n in failures.items() if failure not in (NO_PLAN, UNSUITABLE))
        frames = sum(record.frames for record in new)
        if self.json:
            print_json(
                {
                    "out": str(self.out), "format": self.format, "episodes": len(added), "recorded": len(new),
                    "frames": frames, "planned": planned, "failures": dict(failures),
                }
            )  # fmt: skip
            return
        show(
            f"{self.out}: {len(added)} episode{'s' * (len(added) > 1)}; recorded now: {len(new)}, with {frames} frames"
        )
        if new:
            show(f"planned episodes that succeeded in physics: {len(new)} of {planned}")
        for failure, n in failures.most_common():
            show(f"not kept: {n:4} {failure}")
