"""`roboassembly manual`: an assembly manual for people, from a plan."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from roboassembly.cli.output import (
    DONE,
    check_writable,
    print_json,
    refuse_furniture_folder,
    say,
    show,
    writable_folder,
)
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roboassembly.furniture.model import Furniture
    from roboassembly.task.setting import SettingName


@dataclass(frozen=True)
class ManualCommand:
    """Make an assembly manual for people from a plan: manual.pdf and manual.html."""

    plan: Annotated[Path, tyro.conf.Positional]
    """A plan.json that `roboassembly assemble` wrote, in either setting. Its furniture is `furniture/` beside it, or
    else a built-in piece."""
    out: Path | None = None
    """Folder for manual.pdf and manual.html; earlier ones are replaced. Without it: the folder of the plan."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        from roboassembly.simulation.windowless import import_mujoco
        from roboassembly.studio.sources import open_plan

        started = time.perf_counter()
        out = self.out or self.plan.parent
        script, furniture = open_plan(self.plan)
        check_writable(out)
        refuse_furniture_folder(out)
        if script.parts != tuple(part.name for part in furniture.parts):
            raise InputError(
                f"'{self.plan}' is a plan for '{script.furniture}', whose parts differ from those of the furniture "
                f"beside it"
            )
        import_mujoco()
        outputs, report = write_manual_of(
            furniture, script.actions, script.seed, out, script.setting, name=f"'{self.plan}'"
        )
        report = {
            "success": True,
            "furniture": furniture.name,
            "parts": len(furniture.parts),
            **report,
            "seconds": round(time.perf_counter() - started, 3),
            "outputs": outputs,
        }
        if self.json:
            print_json(report)
        else:
            show(*outputs.values())
        return DONE


def write_manual_of(
    furniture: Furniture,
    actions: Sequence[tuple[int, ...]],
    seed: int,
    out: Path,
    setting: SettingName,
    name: str = "the plan",
) -> tuple[dict[str, str], dict[str, Any]]:
    """Make a manual and write it; returns its files by name, and figures for the report.

    Args:
        furniture: the piece.
        actions: actions of a plan that assembles it.
        seed: seed of the planner.
        out: folder for the files.
        setting: of the plan.
        name: words for the plan in errors.

    Raises:
        InputError: the actions do not assemble the piece.
        ManualError: the planner finds no path for a step.
    """
    from roboassembly.manual.make import make_manual, write_manual
    from roboassembly.settings import SETTINGS

    say("drawing the manual ...")
    manual = make_manual(furniture, actions, seed, name)
    pdf, html, pages = write_manual(manual, writable_folder(out), SETTINGS[setting].on_manuals)
    report: dict[str, Any] = {"steps": len(manual.steps), "pages": pages}
    if furniture.fasteners:
        left = [furniture.fasteners[index].name for index, _ in manual.not_inserted]
        report["not_inserted"] = left
        if left:
            say(f"the manual's order leaves {len(left)} of {len(furniture.fasteners)} fasteners without a free way in: "
                f"{', '.join(left[:5])}{', ...' * (len(left) > 5)}")  # fmt: skip
    return {"manual_pdf": str(pdf), "manual_html": str(html)}, report
