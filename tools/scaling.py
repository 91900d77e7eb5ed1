"""Draws the cost against the number of parts in results.md.

roboassembly bench scaling --json > scaling.json
python tools/scaling.py PICTURE.svg scaling.json
"""

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib import rcParams
from matplotlib.figure import Figure

SIZE = 5.6, 3.6
"""Width and height of the picture [inch]."""


def main(picture: Path, report: Path) -> None:
    """Draw the seconds of each series, and the power of the number of parts that fits them best."""
    results = json.loads(report.read_text())
    # The same results give the same file.
    rcParams["svg.hashsalt"] = "scaling"
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots()
    for (name, power), marker in zip(results["exponents"].items(), "os", strict=True):
        rows = [row for row in results["rows"] if row["series"] == name and row["solved"]]
        parts, seconds = (np.array([row[key] for row in rows], dtype=float) for key in ("parts", "seconds"))
        level = np.exp(np.mean(np.log(seconds) - power * np.log(parts)))
        (line,) = axes.plot(parts, level * parts**power, linewidth=1)
        label = f"{name}, exponent {power:.2f}"
        axes.plot(parts, seconds, marker, color=line.get_color(), label=label)
    axes.set(xscale="log", yscale="log", xlabel="parts", ylabel="processor time of the search [s]")
    first = next(iter(results["exponents"]))
    ticks = [row["parts"] for row in results["rows"] if row["series"] == first]
    axes.set_xticks(ticks, [f"{n}" for n in ticks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(picture, metadata={"Date": None} if picture.suffix == ".svg" else None)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
