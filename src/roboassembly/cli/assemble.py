"""`roboassembly assemble`: plan the assembly of one piece, and write the plan, a web page, a film and a manual."""

from __future__ import annotations

import json as jsonlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from roboassembly.cli.fasteners import fastener_lines, fastener_report, fasteners_by_hand
from roboassembly.cli.options import CORES, Execution, Setting, require_at_least
from roboassembly.cli.output import (
    DONE,
    FAILED,
    check_writable,
    print_json,
    refuse_furniture_folder,
    say,
    show,
    writable_folder,
)
from roboassembly.cli.stability import stability_lines, stability_report
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.furniture.model import Furniture
    from roboassembly.solvers.search import SearchResult
    from roboassembly.task.plans.full_plan import FullPlan
    from roboassembly.task.plans.plan import UprightResult

FilmSize = Literal["640x360", "854x480", "960x540", "1280x720", "1920x1080"]
NO_POLICY = "none"
SHIPPED_POLICY = "relational"
MOST_GUIDED = 40
"""Number of parts above which the shipped policy does not guide the search. It was trained on up to 20, and a choice
takes it seconds where the search alone takes milliseconds."""


@dataclass(frozen=True)
class AssembleCommand:
    """Plan a collision-free assembly of furniture, and write the plan, a web page and a film."""

    furniture: Annotated[str, tyro.conf.Positional] = "ladder"
    """A built-in piece (`FAMILY` or `FAMILY:SEED`, such as `windsor:3`) or a furniture folder."""
    setting: Setting = "object-centric"
    execution: Execution = "kinematic"
    seed: int = 0
    """Random seed of the initial placement and of the planner."""
    out: Path = Path("assembly")
    """Folder for the results: plan.json, timings.json, assembly.html, assembly.mp4, furniture/ and the manual. The
    results of an earlier run are replaced."""
    policy: str = SHIPPED_POLICY
    """Policy that guides the search: `relational` (the trained policy of this package, for up to 40 parts), a
    checkpoint, your own Python file, which is executed (docs/your-own-policy.md), or `none`."""
    search: bool = True
    """Search for another action if the policy's action fails."""
    stable: bool = False
    """Prefer orders in which every group stands on its own, without a policy, and say which steps need a helping hand
    or a fixture."""
    manual: bool = False
    """Write an assembly manual for people, too: manual.pdf and manual.html."""
    film: bool = True
    """Render assembly.mp4."""
    film_size: FilmSize = "1280x720"
    """Width and height of the film in pixels. `960x540` takes half the time."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(0, seed=self.seed)
        if not self.search and self.policy == NO_POLICY:
            raise InputError("--no-search needs a policy, but --policy is none; use --policy relational")
        if self.stable and not self.search:
            raise InputError("--stable searches for an order, but --no-search forbids it; give one of them")
        from roboassembly.settings import SETTINGS, set_upright

        SETTINGS[self.setting].check_option(f"--execution {self.execution}")
        if self.stable:
            SETTINGS[self.setting].check_option("--stable")
        self._check_out()
        from roboassembly.datasets import catalogue
        from roboassembly.simulation.windowless import import_mujoco

        started = time.perf_counter()
        solve = self._solver()
        furniture = catalogue.find(self.furniture)
        say(f"{furniture.name}: {len(furniture.parts)} parts, {len(furniture.connections)} connections")
        import_mujoco()
        result = solve(furniture)
        solved = time.perf_counter() - started
        if result.plan.success:
            say(
                f"assembled in {len(result.plan.steps)} merges{self._policy_share(result)}: {result.planning_steps} "
                f"states checked, {result.planning_seconds:.2f} s of planning, {solved:.2f} s in total"
            )
        else:
            say(f"not assembled: {result.reason}")
        result = replace(result, plan=set_upright(result.plan))
        upright: UprightResult[Any] | None = result.plan.upright
        if upright is not None:
            say(_upright_line(upright))
        if self.stable:
            say(*stability_lines(result.plan))
        fastened: dict[str, Any] = {"count": len(furniture.fasteners)}
        if furniture.fasteners and result.plan.success:
            insert = SETTINGS[self.setting].insert_fasteners
            if insert is None:
                say(fasteners_by_hand(furniture))
            else:
                result = replace(result, plan=insert(result.plan))
                fastened = fastener_report(result.plan)
                say(*fastener_lines(result.plan))
        outputs = self._write(result, solved)
        executed = self._executed(result.plan) if self.execution == "dynamic" else {}
        success = result.plan.success and executed.get("success", True)
        stands, lying = _upright_end(upright, executed)
        report = {
            "success": success,
            "setting": self.setting,
            "furniture": furniture.name,
            "parts": len(furniture.parts),
            "policy": self._used_policy,
            "merges": len(result.plan.steps),
            "guided_merges": result.guided,
            "planning_steps": result.planning_steps,
            "planning_seconds": round(result.planning_seconds, 4),
            "seconds": round(time.perf_counter() - started, 3),
            "seed": self.seed,
            "reason": result.reason,
            "upright": stands,
            "upright_reason": lying,
            "outputs": outputs,
            **({"fasteners": fastened} if furniture.fasteners else {}),
            **({"stability": stability_report(result.plan)} if self.stable else {}),
            **({"execution": executed} if executed else {}),
        }
        if self.json:
            print_json(report)
        else:
            show(*outputs.values())
        return DONE if success else FAILED

    def _check_out(self) -> None:
        """Check that the results can be written and replace nothing but earlier results.

        Raises:
            InputError: the folder cannot be written, or contains files of other origin.
        """
        from roboassembly.task.plans import plan_file

        check_writable(self.out)
        refuse_furniture_folder(self.out)
        plan, furniture = self.out / "plan.json", self.out / "furniture"
        if plan.exists() and not plan_file.is_plan(plan):
            raise InputError(f"'{plan}' is not a plan of this program; choose another --out, or move the file")
        if furniture.exists() and not plan.exists():
            raise InputError(
                f"'{furniture}' is not a result of an earlier run and would be replaced; choose another --out"
            )

    def _solver(self) -> Callable[[Furniture], SearchResult[Any]]:
        """Return the function that finds the plan; a policy that cannot be used raises an error here."""
        from roboassembly.settings import SETTINGS
        from roboassembly.solvers.forward import SearchResult

        solver = SETTINGS[self.setting].solve
        if self.stable:
            return partial(solver, seed=self.seed, stable=True)
        if self.policy == NO_POLICY:
            return partial(solver, seed=self.seed)
        from roboassembly.learning.policy import check_setting, guide_of
        from roboassembly.learning.registry import load_policy

        policy = load_policy(self.policy, self.seed)
        check_setting(policy, self.setting, NO_POLICY)
        if self.search:
            guide = guide_of(policy)

            def search(furniture: Furniture) -> SearchResult[Any]:
                if self.policy == SHIPPED_POLICY and len(furniture.parts) > MOST_GUIDED:
                    say(f"the policy {self.policy} is for up to {MOST_GUIDED} parts; the search goes without it")
                    return solver(furniture, seed=self.seed)
                return solver(furniture, seed=self.seed, guide=guide)

            return search
        from roboassembly.evaluation.rollout import rollout_policy

        def run_policy(furniture: Furniture) -> SearchResult[Any]:
            done = rollout_policy(policy, furniture, self.seed, self.setting)
            failed = f"policy {self.policy} without search: merge {len(done.actions)} ended as {done.verdict}"
            return SearchResult(
                plan=done.plan,
                planning_steps=done.planning_steps,
                planning_seconds=done.planning_seconds,
                attempts=len(done.actions),
                backtracks=0,
                reason="" if done.plan.success else failed,
                guided=len(done.plan.steps),
                guide_seconds=done.policy_seconds,
            )

        return run_policy

    def _executed(self, plan: FullPlan) -> dict[str, Any]:
        """Execute a plan in physics and return the report."""
        from roboassembly.task.full.execution import execute_plan, execute_upright, summarize_execution

        say("executing the plan ...")
        merges = execute_plan(plan)
        done = summarize_execution(plan, merges, execute_upright(plan) if all(m.success for m in merges) else None)
        if not done.reason:
            say(f"executed in {done.simulated_seconds} s of simulated time: largest error of the fingers "
                f"{done.tracking_error_mm} mm, of the joints {done.joint_error_mm} mm")  # fmt: skip
        else:
            say(f"not executed: {done.reason}")
        if done.upright is not None:
            say("set upright in physics" if done.upright else f"not set upright in physics: {done.upright_reason}")
        return asdict(done)

    def _policy_share(self, result: SearchResult[Any]) -> str:
        used = self._used_policy
        return "" if used == NO_POLICY else f", {result.guided} of them chosen by {used}"

    @property
    def _used_policy(self) -> str:
        return NO_POLICY if self.stable else self.policy

    def _write(self, result: SearchResult[Any], solved: float) -> dict[str, str]:
        from roboassembly.furniture import storage
        from roboassembly.task.plans import plan_file
        from roboassembly.viewer.html import write_html

        folder = writable_folder(self.out)
        plan = result.plan
        outputs: dict[str, str] = {}

        def add_output(name: str, path: Path) -> None:
            outputs[name] = str(path)

        plan_file.write(plan, folder / "plan.json")
        add_output("plan", folder / "plan.json")
        timings = {
            "planning_seconds": result.planning_seconds,
            "solve_seconds": solved,
            "step_planning_seconds": [step.planning_seconds for step in plan.steps],
            "planning_steps": result.planning_steps,
            "merges_tried": result.attempts,
            "backtracks": result.backtracks,
            "guide_seconds": result.guide_seconds,
            "upright_seconds": 0.0 if plan.upright is None else plan.upright.planning_seconds,
        }
        (folder / "timings.json").write_text(jsonlib.dumps(timings, indent=1) + "\n")
        add_output("timings", folder / "timings.json")
        add_output("furniture", storage.save(plan.furniture, folder / "furniture"))
        write_html(plan, folder / "assembly.html")
        add_output("html", folder / "assembly.html")
        for name in ("manual.pdf", "manual.html"):
            (folder / name).unlink(missing_ok=True)
        if self.manual:
            outputs |= self._write_manual(plan, folder)
        # The film of an earlier run would show another plan; so it goes even if the new one is interrupted.
        (folder / "assembly.mp4").unlink(missing_ok=True)
        if self.film:
            from roboassembly.rendering.gl import RenderingUnavailableError
            from roboassembly.viewer.film import write_film

            say("rendering the film ...")
            try:
                width, height = map(int, self.film_size.split("x"))
                write_film(plan, folder / "assembly.mp4", width=width, height=height, jobs=CORES)
                add_output("film", folder / "assembly.mp4")
            except RenderingUnavailableError as error:
                say(f"no film: {error}")
        return outputs

    def _write_manual(self, plan: Any, folder: Path) -> dict[str, str]:
        """Write the manual and return its files by name; a plan that has none says why."""
        from roboassembly.cli.manual import write_manual_of
        from roboassembly.manual.arrangement import ManualError

        if not plan.success:
            say("no manual: the piece is not assembled")
            return {}
        actions = [step.action for step in plan.steps]
        try:
            outputs, _ = write_manual_of(plan.furniture, actions, self.seed, folder, self.setting)
        except ManualError as error:
            say(str(error))
            return {}
        return outputs


def _upright_line(result: UprightResult[Any]) -> str:
    """Return a line that says whether the piece stands on its feet."""
    if not result.success:
        return f"not set upright: {result.reason}"
    if result.motion is None:
        return "it stands upright"
    return f"set upright: {result.planning_steps} states checked, {result.planning_seconds:.2f} s"


def _upright_end(planned: UprightResult[Any] | None, executed: dict[str, Any]) -> tuple[bool, str]:
    """Return whether the piece stands on its feet at the end, in physics too if it was executed; and why not."""
    if planned is None:
        return False, "not assembled"
    if not planned.success or not executed or executed["upright"]:
        return planned.success, planned.reason
    why = executed["upright_reason"] or executed["reason"]
    return False, f"planned, but not executed: {why}"
