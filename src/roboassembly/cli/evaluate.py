"""`roboassembly evaluate`: success and planning effort of a way of assembling on a set."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated

import tyro
from tqdm import tqdm

from roboassembly.cli.output import DONE, print_json
from roboassembly.errors import InputError


@dataclass(frozen=True)
class Evaluate:
    """Measure a way of assembling on a set of furniture."""

    policy: str = "search"
    """`search`, `joint-rrt` (the paper's baseline), `right-pairs` or `right-pairs-random-w`."""
    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:test"
    """`chairs-412:test` (or `:train`, `:easy`, `:hard`), or `folder:PATH` of furniture folders."""
    limit: int | None = None
    """The first so many pieces only."""
    seed: int = 0
    """Of the starts and the planner."""
    jobs: int = os.cpu_count() or 1
    """Pieces at a time."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.seed < 0 or self.jobs < 1 or (self.limit is not None and self.limit < 1):
            raise InputError("--seed takes 0 or more, --jobs and --limit take 1 or more")
        from roboassembly.furniture.datasets import pick
        from roboassembly.solvers.evaluate import Evaluation, evaluate

        picks = pick(self.set)[: self.limit]
        episodes = tuple(tqdm(evaluate(self.policy, picks, self.seed, self.jobs), total=len(picks), unit="piece"))
        report = {**Evaluation(self.policy, episodes).to_json(), "set": self.set, "seed": self.seed}
        if self.json:
            print_json(report)
        else:
            print(
                f"{self.policy} on {self.set}: {report['success_rate']:.1%} of {report['n']} "
                f"(95 % {report['ci95']}), {report['planning_steps_mean']:.0f} states each"
            )
        return DONE
