"""Draws the learning curves of results.md.

    python docs/curves.py runs/benchmark runs/benchmark-full runs/hands PICTURE.png

The first two are runs of `roboassembly benchmark`, in both settings, the third is one of `roboassembly train multitask
--setting full`.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from roboassembly.furniture.datasets import pick
from roboassembly.learning.gather import file_of
from roboassembly.learning.logs import read
from roboassembly.learning.single_task import results

PANEL = 4.2, 3.0
"""Inches."""
GRASPS = {"take": "one hand takes its group", "room": "two hands have room", "meet": "arms reach the joint",
          "rest": "all else works out"}  # fmt: skip


def mastered(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each split steps, and the share of the chairs tried that is mastered after so many."""
    picks = [p for p in pick("chairs-412:train") if file_of(folder / "experts", p.name).is_file()]
    split = {p.name: p.entry.split for p in picks if p.entry is not None}
    tried = [r for r in results(picks, folder) if not r.refused]
    out = {}
    for name in ("easy", "hard"):
        some = [r for r in tried if split[r.name] == name]
        steps = np.sort([r.steps for r in some if r.mastered])
        if some:
            out[f"{name}, {len(some)} chairs"] = steps, np.arange(1, len(steps) + 1) / len(some)
    return out


def main(benchmark: Path, with_robots: Path, hands: Path, picture: Path) -> None:
    """One picture of four panels."""
    figure = Figure(figsize=(2 * PANEL[0], 2 * PANEL[1]), layout="constrained")
    panels = figure.subplots(2, 2)
    for setting, folder, style in (("", benchmark, "-"), (" with robots", with_robots, "--")):
        for name, (steps, share) in mastered(folder).items():
            panels[0, 0].step(steps, share, style, where="post", label=name + setting)
        chosen = read(folder).get("chosen", {}).get("paper", {})
        panels[0, 1].plot(list(chosen), list(chosen.values()), style, label="preset paper" + setting)
    panels[0, 0].set(title="experts: share mastered", xlabel="steps of the environment", ylim=(0.0, 1.02))
    scalars = read(hands)
    for stage, points in scalars["chosen"].items():
        panels[0, 1].plot(list(points), list(points.values()), label=f"relational with hands, {stage}")
    panels[0, 1].set(title="imitation: share of good choices", xlabel="update", ylim=(0.0, 1.02))
    for name, meaning in GRASPS.items():
        points = scalars[name]["grasps"]
        panels[1, 0].plot(list(points), list(points.values()), label=meaning)
    panels[1, 0].set(title="hands: cross-entropy of what is said of them", xlabel="update", yscale="log")
    for name in ("pairs", "choice"):
        for stage, points in scalars[name].items():
            panels[1, 1].plot(list(points), list(points.values()), label=f"{name}, {stage}")
    panels[1, 1].set(title="relational with hands: losses", xlabel="update", yscale="log")
    for axes in panels.flat:
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
