"""`roboassembly evaluate`: success rate and planning effort of a policy or a solver on a set of furniture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from roboassembly.cli.options import (
    CORES,
    Clouds,
    Execution,
    Frames,
    Jobs,
    Ray,
    Setting,
    require_at_least,
    selected_furniture,
    workers,
)
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, say, show
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef
    from roboassembly.evaluation.episodes import Episode
    from roboassembly.evaluation.evaluate import Evaluation
    from roboassembly.evaluation.rollout import RolloutConfig


@dataclass(frozen=True)
class EvaluateCommand:
    """Measure the success rate and the planning effort of a policy or a solver on a set of furniture."""

    policy: str = "search"
    """Policy or solver to evaluate. Policies: `relational`, `paper`, `random`, a checkpoint, or your own Python file,
    which is executed (docs/your-own-policy.md). Solvers: `search`, `joint-rrt` (the paper's RRT-Connect baseline),
    `right-pairs` (correct pairs in random order), `right-pairs-random-w` (the same with random `w`)."""
    search: bool = False
    """Let the policy guide the search. Without it, the policy acts alone."""
    setting: Setting = "object-centric"
    """Robots need the solver `search` or a policy that chooses grasps."""
    execution: Execution = "kinematic"
    audit: bool = False
    """Check each plan for collisions again with python-fcl, a library that the planner does not use."""
    frames: Frames = "aligned"
    """Frames in which observations describe the parts: parallel to the furniture's, or each part's own (policies that
    act alone)."""
    clouds: Clouds = "shared"
    """Whether equal parts have the same cloud, or points of their own (policies that act alone)."""
    noise_mm: float = 0.0
    """Standard deviation of the clouds' coordinates in mm (policies that act alone)."""
    tries: int = 1
    """Number of actions that a policy may try in a state: the environment refuses one, the policy picks another
    (policies that act alone)."""
    meshes: bool = True
    """Give the parts' meshes to a policy that acts alone and uses them; policies never get them with --clouds resampled
    or noise."""
    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:test"
    """Furniture: `NAME:SPLIT` of a data set, with the split train, easy, hard, test or all; or `folder:PATH`, a folder
    of furniture folders."""
    limit: int | None = None
    """Use the first LIMIT pieces of the set only."""
    sample: int | None = None
    """Use SAMPLE random pieces of the set only."""
    episodes: int = 1
    """Number of episodes per piece; each has a different initial placement."""
    seed: int = 0
    """Random seed of the initial placements, of the planner and of --sample."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    out: Path | None = None
    """File for the results of the episodes. Run the same command again to resume an interrupted run."""
    export: Path | None = None
    """Write the successful episodes as a Minari data set to this new folder, with a name such as `chairs-v0`."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(0, seed=self.seed)
        require_at_least(1, jobs=self.jobs, episodes=self.episodes, tries=self.tries)
        for path in (self.out, self.export):
            if path is not None:
                check_writable(path.parent)
        if self.out is not None and self.out.is_dir():
            raise InputError(f"cannot write to {self.out}: it is a folder; --out must be a file")
        from roboassembly.envs.observation import ObservationConfig
        from roboassembly.evaluation.evaluate import Evaluation
        from roboassembly.evaluation.rollout import SOLVERS, RolloutConfig
        from roboassembly.settings import SETTINGS

        observes = ObservationConfig(self.frames, self.clouds, self.noise_mm / 1000.0)
        if self.export is not None:
            from roboassembly.evaluation.export import check_target

            SETTINGS[self.setting].check_option("--export")
            if self.tries > 1 or not observes.is_default:
                raise InputError("--export writes episodes of the default environment with one try a step")
            if self.policy in SOLVERS and not SOLVERS[self.policy].has_actions:
                raise InputError(
                    f"--export does not support '{self.policy}', which has no actions; use a policy or 'search'"
                )
            check_target(self.export)
        refs = selected_furniture(self.set, self.limit, self.sample, self.seed)
        config = RolloutConfig(
            self.policy, self.search, self.setting, self.execution, self.audit, observes, self.tries, self.meshes
        )
        total = len(refs) * self.episodes
        with workers(self.ray, self.jobs) as jobs:
            episodes = tuple(progress_bar(self._episodes(config, refs, jobs), total=total, unit="episode"))
        evaluation = Evaluation(config, self.set, self.seed, episodes)
        report = evaluation.to_json()
        if self.export is not None:
            from roboassembly.evaluation.export import export

            say("writing the successful episodes ...")
            played = zip((p for p in refs for _ in range(self.episodes)), episodes, strict=True)
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

    def _episodes(self, config: RolloutConfig, refs: Sequence[FurnitureRef], jobs: int) -> Iterator[Episode]:
        """Yield all episodes; those that `out` contains are read from there."""
        from roboassembly.datasets.sets import set_hash
        from roboassembly.evaluation.episodes import read_episodes, record_episodes
        from roboassembly.evaluation.evaluate import evaluate
        from roboassembly.learning.policy_weights import weights_hash

        if self.out is None:
            return evaluate(config, refs, self.seed, jobs, episodes=self.episodes)
        about = {
            "config": asdict(config), "weights": weights_hash(self.policy), "set": self.set,
            "set_hash": set_hash(refs), "seed": self.seed, "episodes": self.episodes,
        }  # fmt: skip
        there = read_episodes(self.out, about)
        if there is None:
            raise InputError(
                f"--out {self.out} contains other data than episodes of this policy, set and seed; choose another file"
            )
        rest = partial(evaluate, config, refs, self.seed, jobs, episodes=self.episodes, done=len(there))
        return record_episodes(self.out, about, there, rest)


def _conditions(config: RolloutConfig) -> str:
    """Return in words under which conditions a policy acts, beginning with a blank; empty for the usual ones."""
    observes = config.observes
    parts = [] if observes.is_default else [f"{observes.frames} frames, {observes.clouds} clouds"]
    parts += [f"noise of {1000.0 * observes.noise:g} mm"] * (observes.noise > 0.0)
    parts += ["no meshes"] * (not config.meshes)
    parts += [f"{config.tries} tries a step"] * (config.tries > 1)
    return " with search" * config.search + "".join(f", {part}" for part in parts)


def summary(evaluation: Evaluation) -> list[str]:
    """Return lines with the success rates, in total and by family, and the verdicts of failed episodes."""
    from roboassembly.statistics import success

    def line(name: str, episodes: Sequence[Episode]) -> str:
        rates = success([e.success for e in episodes])
        low, high = rates["ci95"]
        steps = sum(e.planning_steps for e in episodes) / len(episodes)
        rate = f"{rates['success_rate']:7.1%}"
        return f"{name:24} {len(episodes):5} {rate}  {100 * low:5.1f}-{100 * high:5.1f} {steps:9,.0f}"

    episodes = evaluation.episodes
    report = evaluation.to_json()
    how = f"{report['policy']}{_conditions(evaluation.config)} on {evaluation.set}, seed {evaluation.seed}"
    lines = [how, f"{'':24} {'n':>5} {'success':>7}  {'95 %':>11} {'states':>9}", line("all", episodes)]
    families = sorted({e.family for e in episodes} - {""})
    if families:
        for name, unseen in (("of families in training", False), ("of other families", True)):
            some = [e for e in episodes if e.unseen is unseen]
            lines += [line(name, some)] if some else []
        lines += [line(f"  {f}", [e for e in episodes if e.family == f]) for f in families]
    if "planned" in report:
        lines.append(f"planned: {report['planned']['success_rate']:.1%}; all other figures are for the execution")
    if "violations" in report:
        lines.append(f"violations found by the audit: {report['violations']}")
    failed = Counter(e.verdict for e in episodes if not e.success)
    lines += [f"failed: {n:4} {verdict}" for verdict, n in failed.most_common()]
    return lines
