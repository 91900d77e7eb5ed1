"""Training logs: TensorBoard events, the same numbers as lines of JSON, and pictures of the curves."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from roboassembly.errors import InputError

LINES = "scalars.jsonl"
_WINDOW = 50
"""Number of steps that each point of a curve averages."""


class TrainingLog:
    """Writes means of scalars over a few steps, by stage.

    A continued run repeats the steps that it lost; the later values count.
    """

    def __init__(self, folder: Path) -> None:
        from tensorboardX import SummaryWriter

        folder.mkdir(parents=True, exist_ok=True)
        self._writer = SummaryWriter(str(folder / "tensorboard"))
        self._lines = (folder / LINES).open("a")
        self._pending: dict[str, list[float]] = {}

    def add(self, stage: str, step: int, scalars: Mapping[str, float], *, last: bool = False) -> None:
        """Add the scalars of a step; means are written with every fiftieth step, and with the last."""
        for name, value in scalars.items():
            self._pending.setdefault(name, []).append(value)
        if not self._pending or not (last or step % _WINDOW == 0):
            return
        means = {name: sum(values) / len(values) for name, values in self._pending.items()}
        self._pending.clear()
        for name, value in means.items():
            self._writer.add_scalar(f"{stage}/{name}", value, step)
        self._lines.write(json.dumps({"stage": stage, "step": step, **means}) + "\n")
        self._lines.flush()

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()
        self._lines.close()


def read(folder: Path) -> dict[str, dict[str, dict[int, float]]]:
    """Return the scalars of a run by name, stage and step.

    Raises:
        InputError: the folder holds no run.
    """
    path = folder / LINES
    if not path.is_file():
        raise InputError(f"'{folder}' holds no {LINES}; name the folder of a run of `roboassembly train`")
    out: dict[str, dict[str, dict[int, float]]] = {}
    for line in path.read_text().splitlines():
        try:
            point = json.loads(line)
        except json.JSONDecodeError:
            continue  # killed in the middle of a line
        stage, step = point.pop("stage"), point.pop("step")
        for name, value in point.items():
            out.setdefault(name, {}).setdefault(stage, {})[step] = value
    return out


def draw(folder: Path) -> Path:
    """Draw the learning curves of a run as `curves.png` in its folder: a panel for each scalar, a line for each stage.

    Raises:
        InputError: the folder holds no run.
    """
    from matplotlib.figure import Figure

    scalars = read(folder)
    columns = min(3, max(1, len(scalars)))
    rows = max(1, -(-len(scalars) // columns))
    figure = Figure(figsize=(4.2 * columns, 3.0 * rows), layout="constrained")
    for index, (name, stages) in enumerate(sorted(scalars.items())):
        axes = figure.add_subplot(rows, columns, index + 1)
        for stage, points in stages.items():
            steps = sorted(points)
            axes.plot(steps, [points[s] for s in steps], label=stage, linewidth=1.0)
        axes.set(title=name, xlabel="step")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    path = folder / "curves.png"
    figure.savefig(path, dpi=110)
    return path
