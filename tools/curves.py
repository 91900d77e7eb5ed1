"""Draws the learning curves of results.md.

    python tools/curves.py PICTURE.png RUN [RUN ...]

Each run is a folder of `roboassembly benchmark`, `train expert` or `train multitask`, in either setting.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from roboassembly.datasets.sets import furniture_refs
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.logs import read
from roboassembly.learning.paper.pipeline import expert_results

PANEL = 4.2, 3.0
"""Width and height of the picture [inch]."""
GRASPS = {"pick": "one gripper picks its group", "fit": "two grippers fit", "reach": "arms reach the mate",
          "finish": "all else works"}  # fmt: skip


def mastered(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return, for each split, the steps and the share of the tried chairs that are solved after them."""
    picks = [p for p in furniture_refs("chairs-412:train") if dataset_file(folder / "experts", p.name).is_file()]
    split = {p.name: p.entry.split for p in picks if p.entry is not None}
    tried = [r for r in expert_results(picks, folder) if not r.refused]
    out = {}
    for name in ("easy", "hard"):
        some = [r for r in tried if split[r.name] == name]
        steps = np.sort([r.steps for r in some if r.mastered])
        if some:
            out[f"{name}, {len(some)} chairs"] = steps, np.arange(1, len(steps) + 1) / len(some)
    return out


def main(picture: Path, runs: Sequence[Path]) -> None:
    """Draw one picture of four panels with the scalars of all runs."""
    figure = Figure(figsize=(2 * PANEL[0], 2 * PANEL[1]), layout="constrained")
    (experts, choices), (hands, losses) = figure.subplots(2, 2)
    for run in runs:
        if (run / "experts").is_dir():
            for name, (steps, share) in mastered(run).items():
                experts.step(steps, share, where="post", label=f"{run.name}: {name}")
        scalars = read(run)
        for axes, names in ((choices, ("chosen",)), (losses, ("pairs", "choice"))):
            for name in names:
                for stage, points in scalars.get(name, {}).items():
                    axes.plot(list(points), list(points.values()), label=f"{run.name}: {stage}, {name}")
        for name, meaning in GRASPS.items():
            points = scalars.get(name, {}).get("grasps", {})
            if points:
                hands.plot(list(points), list(points.values()), label=f"{run.name}: {meaning}")
    experts.set(title="experts: share mastered", xlabel="steps of the environment", ylim=(0.0, 1.02))
    choices.set(title="imitation: share of good choices", xlabel="update", ylim=(0.0, 1.02))
    hands.set(title="hands: cross-entropy of what is said of them", xlabel="update", yscale="log")
    losses.set(title="relational: losses", xlabel="update", yscale="log")
    for axes in (experts, choices, hands, losses):
        axes.grid(alpha=0.3)
        if axes.has_data():
            axes.legend(fontsize=7)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(run) for run in sys.argv[2:]])
