"""Table of the benchmark in Markdown, and its place in a document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError
from roboassembly.settings import SETTINGS
from roboassembly.task.setting import SettingName

END = "<!-- end of the benchmark -->"
UNSEEN = ", families in no training"
"""End of the name of a row's furniture if none of its families occurs in training."""


def begin(setting: SettingName, name: str) -> str:
    """Return the mark after which, up to `END`, `put_into` writes the table of a setting and a data set."""
    return f"<!-- roboassembly benchmark --setting {setting} --set {name} -->"


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    """Name of the policy, solver or stage that is measured."""
    on: str
    """Furniture."""
    figures: dict[str, Any]
    """`n`, `success_rate`, `ci95`, `planning_steps_mean`, ..."""
    command: str
    """Command that measures this row alone."""
    paper: float | None = None
    """Success in the paper [%]; None if the paper has no such row."""
    paper_steps: str = ""
    """Planning steps in the paper."""


def table(report: dict[str, Any]) -> list[str]:
    """Return the lines of Markdown of a run's report."""
    lines = [
        f"On {report['date']}, {report['machine']}, seed {report['seed']}.",
        "",
        "| | on | paper, % | here, % | 95 % | n | planning steps, paper | here | of the solved |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in report["rows"]:
        f = row["figures"]
        low, high = f["ci95"]
        steps = [_count(f.get(name)) for name in ("planning_steps_mean", "planning_steps_mean_solved")]
        cells = [
            row["name"], row["on"], "" if row["paper"] is None else f"{row['paper']:.1f}",
            f"{100 * f['success_rate']:.1f}", f"{100 * low:.1f}–{100 * high:.1f}", str(f["n"]), row["paper_steps"],
            *steps,
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    if any(row["figures"].get("refused") for row in report["rows"]):
        counts = {row["on"]: row["figures"]["refused"] for row in report["rows"] if row["figures"].get("refused")}
        lines += ["", "Left out because no two grippers can hold and join all their parts: "
                  + ", ".join(f"{count} of {on}" for on, count in counts.items()) + "."]  # fmt: skip
    fresh = {r["on"]: f["test_success_rate"] for r in report["rows"] if "test_success_rate" in (f := r["figures"])}
    note = SETTINGS[report["setting"]].experts_note
    if note and fresh:
        shares = ", ".join(f"{100 * rate:.1f} % of {on}" for on, rate in fresh.items())
        lines += ["", f"{note} From other starts they finish {shares}."]
    ended = [(row["name"], row["on"], row["figures"].get("failures")) for row in report["rows"]]
    if any(failures for _, _, failures in ended):
        lines += ["", "What ended those that failed:", ""]
        lines += [
            f"- {name}, {on}: {', '.join(f'{count} {kind}' for kind, count in failures.items())}"
            for name, on, failures in ended
            if failures and not on.endswith(UNSEEN)
        ]
    commands = list(dict.fromkeys(row["command"] for row in report["rows"]))
    lines += ["", "Each row alone:", "", *(f"- `{command}`" for command in commands)]
    if report["seconds"]:
        lines += ["", "Wall time: " + ", ".join(f"{k} {v / 60:.0f} min" for k, v in report["seconds"].items()) + "."]
    return lines


def _count(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}"


def check_marks(document: Path, setting: SettingName, name: str) -> tuple[str, str, str]:
    """Return a document up to the table of a setting and a data set, the first mark, and the rest from the end of it.

    Raises:
        InputError: the document cannot be read, or has no marks.
    """
    try:
        text = document.read_text()
    except OSError as error:
        raise InputError(f"cannot read {document}: {error.strerror or error}") from None
    before, mark, rest = text.partition(begin(setting, name))
    _, end, after = rest.partition(END)
    if not mark or not end:
        raise InputError(f"{document} has no lines '{begin(setting, name)}' and '{END}' to write between")
    return before, mark, end + after


def put_into(document: Path, lines: Sequence[str], setting: SettingName, name: str) -> None:
    """Replace the text between the marks of a setting and a data set in a document.

    Raises:
        InputError: the document cannot be read, or has no marks.
    """
    before, mark, after = check_marks(document, setting, name)
    with atomic_write(document) as unfinished:
        unfinished.write_text(f"{before}{mark}\n\n" + "\n".join(lines) + f"\n\n{after}")
