"""`roboassembly evaluate`: success and planning effort of a way of assembling on a set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from roboassembly.cli.options import CORES, Execution, Jobs, Ray, Setting, chosen
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, say, show
from roboassembly.errors import InputError
from roboassembly.parallel.processes import use_cluster

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef
    from roboassembly.evaluation.evaluate import Evaluation
    from roboassembly.evaluation.rollout import Episode, RolloutConfig


@dataclass(frozen=True)
class Evaluate:
    """Measure how often a policy or a solver assembles the pieces of a set, and with how much planning."""

    policy: str = "search"
    """What is measured. A policy: `relational`, `paper`, `random`, a checkpoint, or a Python file of your own, which is
    executed (docs/your-own-policy.md). Or a solver: `search`, `joint-rrt` (the paper's baseline), `right-pairs`,
    `right-pairs-random-w`."""
    search: bool = False
    """Let the policy guide the search. Without it the policy acts alone."""
    setting: Setting = "object-centric"
    """What moves the parts. object-centric: parts move by themselves. full: two mobile Franka robots move them; of the
    solvers only `search` can do that, and a policy has to choose grasps."""
    execution: Execution = "kinematic"
    """How the robots of --setting full move. kinematic: paths are planned and checked. dynamic: actuated robots carry
    the plan out in physics as well."""
    audit: bool = False
    """Check every plan for collisions once more with python-fcl, a library that planning does not use."""
    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:test"
    """The furniture: `chairs-412:test` (or `:train`, `:easy`, `:hard`), or `folder:PATH` of a folder of furniture
    folders."""
    limit: int | None = None
    """Take only the first LIMIT pieces of the set."""
    sample: int | None = None
    """Take only SAMPLE pieces of the set, drawn by the seed."""
    episodes: int = 1
    """Number of episodes for each piece; each begins with the parts lying in other places."""
    seed: int = 0
    """Random seed of the starts and the planner."""
    jobs: Jobs = CORES
    """Number of pieces to work on at the same time."""
    ray: Ray = None
    out: Path | None = None
    """File to which every episode is written as it ends. If the run is stopped, the same command continues it."""
    export: Path | None = None
    """Write the successful episodes as a Minari data set into this new folder, named like `chairs-v0`."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.seed < 0 or min(self.jobs, self.episodes) < 1:
            raise InputError("--seed takes 0 or more, --jobs and --episodes take 1 or more")
        for path in (self.out, self.export):
            if path is not None:
                check_writable(path.parent)
        if self.out is not None and self.out.is_dir():
            raise InputError(f"cannot write to {self.out}: it is a folder; name a file")
        from roboassembly.evaluation.evaluate import Evaluation
        from roboassembly.evaluation.rollout import EXPORTABLE, SOLVERS, RolloutConfig

        if self.export is not None:
            from roboassembly.evaluation.export import check_target

            if self.setting == "full":
                raise InputError("--export takes episodes of --setting object-centric")

            if self.policy in SOLVERS and self.policy not in EXPORTABLE:
                raise InputError(f"--export: '{self.policy}' tells no actions; a policy or 'search' would do")
            check_target(self.export)
        picks = chosen(self.set, self.limit, self.sample, self.seed)
        way = RolloutConfig(self.policy, self.search, self.setting, self.execution, self.audit)
        total = len(picks) * self.episodes
        with use_cluster(self.ray, self.jobs) as jobs:
            episodes = tuple(progress_bar(self._played(way, picks, jobs), total=total, unit="episode"))
        evaluation = Evaluation(way, self.set, self.seed, episodes)
        report = evaluation.to_json()
        if self.export is not None:
            from roboassembly.evaluation.export import export

            say("writing the successful episodes ...")
            played = zip((p for p in picks for _ in range(self.episodes)), episodes, strict=True)
            done = export(self.export, played, self.policy + " with search" * self.search)
            report["exported"] = {
                "path": str(done.path), "episodes": done.episodes, "steps": done.steps, "refused": done.refused,
            }  # fmt: skip
        if self.json:
            print_json(report)
        else:
            show(*summary(evaluation))
            if self.export is not None:
                show(self.export)
        return DONE

    def _played(self, way: RolloutConfig, picks: Sequence[FurnitureRef], jobs: int) -> Iterator[Episode]:
        """All episodes; those that `out` holds are not played again."""
        from roboassembly.datasets.sets import set_hash
        from roboassembly.evaluation.episodes import read_episodes, record_episodes
        from roboassembly.evaluation.evaluate import evaluate
        from roboassembly.learning.policy_weights import weights_hash

        if self.out is None:
            return evaluate(way, picks, self.seed, jobs, episodes=self.episodes)
        about = {
            "way": asdict(way), "weights": weights_hash(self.policy), "set": self.set, "set_hash": set_hash(picks),
            "seed": self.seed, "episodes": self.episodes,
        }  # fmt: skip
        there = read_episodes(self.out, about)
        if there is None:
            raise InputError(
                f"--out {self.out}: holds something else than episodes of this policy, set and seed; another name "
                "would do"
            )
        rest = partial(evaluate, way, picks, self.seed, jobs, episodes=self.episodes, played=len(there))
        return record_episodes(self.out, about, there, rest)


def summary(evaluation: Evaluation) -> list[str]:
    """Lines: success in all, by family, and how failures ended."""
    from roboassembly.statistics import success

    def line(name: str, episodes: Sequence[Episode]) -> str:
        told = success([e.success for e in episodes])
        low, high = told["ci95"]
        steps = sum(e.planning_steps for e in episodes) / len(episodes)
        rate = f"{told['success_rate']:7.1%}"
        return f"{name:24} {len(episodes):5} {rate}  {100 * low:5.1f}-{100 * high:5.1f} {steps:9,.0f}"

    every = evaluation.episodes
    told, way = evaluation.to_json(), evaluation.way
    how = f"{told['policy']}{' guiding the search' * way.search} on {evaluation.set}, seed {evaluation.seed}"
    lines = [how, f"{'':24} {'n':>5} {'success':>7}  {'95 %':>11} {'states':>9}", line("all", every)]
    families = sorted({e.family for e in every} - {""})
    if families:
        for name, wanted in (("of families in training", False), ("of other families", True)):
            some = [e for e in every if e.unseen is wanted]
            lines += [line(name, some)] if some else []
        lines += [line(f"  {f}", [e for e in every if e.family == f]) for f in families]
    if "planned" in told:
        lines.append(f"planned: {told['planned']['success_rate']:.1%}; all else counts what was carried out")
    if "violations" in told:
        lines.append(f"found by the audit: {told['violations']}")
    failed = Counter(e.verdict for e in every if not e.success)
    lines += [f"failed: {n:4} {verdict}" for verdict, n in failed.most_common()]
    return lines
