"""The paper's table, from nothing: experts, both multi-task policies, and how all of them do on unseen furniture.

One stage after another, each kept in the run's folder; whatever is there already is not done again.

    autoencoder.npz  experts/  lessons/     of the training chairs
    paper/policy.npz  relational/policy.npz
    episodes/<row>.jsonl                    every episode as it ends
    benchmark.json  table.md                what all of it says
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from roboassembly.datasets.sets import RECIPES, FurnitureRef, furniture_refs, manifest_path, sample_refs, set_hash
from roboassembly.errors import InputError
from roboassembly.evaluation.episodes import read_episodes, record_episodes
from roboassembly.evaluation.evaluate import Evaluation, evaluate
from roboassembly.evaluation.rollout import REFUSED, Episode, ExecutionName, RolloutConfig
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper import imitation as paper_imitation
from roboassembly.learning.paper.dqn.train import ExpertTraining, mastery
from roboassembly.learning.paper.pipeline import (
    Schooling,
    extractor_of,
    results,
    teach_experts,
    teach_features,
    teach_paper,
)
from roboassembly.learning.policy_weights import weights_hash
from roboassembly.learning.progress import Progress
from roboassembly.learning.relational.network import RelationalConfig
from roboassembly.learning.relational.pipeline import RelationalPipelineConfig, run_pipeline
from roboassembly.solvers.dataset_builder import build_dataset
from roboassembly.task.setting import SettingName

END = "<!-- end of the benchmark -->"
PAPER: dict[SettingName, dict[str, float]] = {
    "object-centric": {"easy": 79.4, "hard": 66.4, "test": 74.5},
    "full": {"easy": 59.3, "hard": 25.8, "test": 50.0},
}
"""Success in the paper, per cent: of experts on easy and hard training chairs, of the policy on unseen ones."""
_UNSEEN = ", families in no training"
_OFTEN = 5.0
"""Seconds after which the time that a stage has taken is written down again."""
_TINY = RelationalConfig(token=32, pair=16, layers=1, heads=2, conflict_inputs=8, conflicts=2)


def begin(setting: SettingName) -> str:
    """How the mark begins after which, up to `END`, `put_into` writes the table of a setting."""
    return f"<!-- roboassembly benchmark --setting {setting}"


@dataclass(frozen=True)
class Benchmark:
    """What is trained and measured, and for how long."""

    setting: SettingName = "object-centric"
    set: str = "chairs-412"
    train_limit: int | None = None
    """The first so many training chairs only, where the relational policy is trained."""
    taught: int | None = None
    """Training chairs that get an expert, drawn by the seed; all if None."""
    sample: int | None = None
    """Pieces of each set that are played, drawn by the seed; all if None."""
    real: tuple[str, ...] = ()
    """Sets of real furniture besides, `folder:PATH`, for the relational policy."""
    shipped: bool = True
    """Take the relational policy of the package; else train one."""
    schooling: Schooling = field(default_factory=Schooling)
    paper: paper_imitation.Training = field(default_factory=paper_imitation.Training)
    relational: RelationalPipelineConfig = field(default_factory=RelationalPipelineConfig)
    seed: int = 0

    @staticmethod
    def whole(setting: SettingName = "object-centric", seed: int = 0) -> Benchmark:
        """The paper's table."""
        plain = Benchmark(setting, seed=seed)
        if setting == "object-centric":
            return plain
        # With robots an update takes several times as long: any two points have 64 ways to be joined in place of six.
        paper = replace(plain.paper, steps=5_000)
        return replace(
            plain, schooling=Schooling.usual(setting), paper=paper, relational=RelationalPipelineConfig.full()
        )

    @staticmethod
    def quick(setting: SettingName = "object-centric", seed: int = 0) -> Benchmark:
        """All stages, tiny: to see that they work, not what they reach."""
        experts = ExpertTraining(steps=1_600, least_steps=400, setting=setting)
        relational = RelationalPipelineConfig(extra=0, validation=0, steps=40, network=_TINY)
        if setting == "full":
            relational = replace(
                RelationalPipelineConfig.full(), extra=0, validation=0, episodes=1, steps=2, grasp_steps=40
            )
        return Benchmark(
            setting, set="chairs-24", train_limit=3, taught=3, sample=2 if setting == "full" else 3, shipped=False,
            schooling=Schooling(autoencoder.Training(steps=40), 4, experts, plays=8 if setting == "full" else 2),
            paper=paper_imitation.Training(steps=40), relational=relational, seed=seed,
        )  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    """Of what is measured."""
    on: str
    """Furniture."""
    figures: dict[str, Any]
    """`n`, `success_rate`, `ci95`, `planning_steps_mean`, ..."""
    command: str
    """That measures it alone."""
    paper: float | None = None
    """Success in the paper, per cent; None where it has no such row."""
    paper_steps: str = ""
    """Planning steps in the paper."""


def run(b: Benchmark, folder: Path, jobs: int) -> Iterator[Progress]:
    """Do all stages that are not done yet; afterwards `rows` tells the table.

    Args:
        b: what.
        folder: of the run.
        jobs: processes.

    Raises:
        InputError: no such set, or the folder holds another benchmark's run.
    """
    if b.set not in RECIPES:
        raise InputError(f"--set {b.set}: the table is made on a generated set; one of {', '.join(RECIPES)}")
    folder.mkdir(parents=True, exist_ok=True)
    _same_run(b, folder)
    if not manifest_path(b.set).is_file():
        for done, of in build_dataset(RECIPES[b.set], 0, jobs):
            yield Progress(f"data set {b.set}", done, of, {})
    schooling, picks = b.schooling.seeded(b.seed), taught(b)
    features = teach_features(picks, folder, schooling, {"set": b.set, "sample": b.taught}, jobs)
    experts = teach_experts(picks, folder, schooling, {"set": b.set}, jobs)
    yield from _timed(folder, "experts", chain(features, experts))
    training = replace(b.paper, seed=b.seed)
    paper = teach_paper([folder / "lessons"], extractor_of(folder), folder / "paper", training)
    yield from _timed(folder, "paper", paper)
    if not b.shipped:
        lessons = replace(b.relational, set=f"{b.set}:train", limit=b.train_limit, seed=b.seed)
        yield from _timed(folder, "relational", run_pipeline(lessons, folder / "relational", jobs))
    played = chain.from_iterable(tried(trial, folder, jobs) for trial in trials(b, folder))
    yield from _timed(folder, "evaluation", played)


def taught(b: Benchmark) -> list[FurnitureRef]:
    """Chairs that get an expert."""
    return sample_refs(furniture_refs(f"{b.set}:train"), b.taught, b.seed)


@dataclass(frozen=True)
class Trial:
    """Episodes to play."""

    setting: SettingName
    name: str
    policy: str
    """As `roboassembly evaluate --policy` takes it."""
    search: bool
    set: str
    sample: int | None
    seed: int
    paper: float | None = None
    paper_steps: str = ""
    execution: ExecutionName = "kinematic"

    @property
    def way(self) -> RolloutConfig:
        """To assemble."""
        return RolloutConfig(self.policy, self.search, self.setting, self.execution)

    @property
    def file(self) -> str:
        """That keeps its episodes."""
        set_name = self.set.replace(":", "-").replace("/", "-").strip("-")
        return f"{self.name.replace(' ', '-')}-{set_name}.jsonl"

    @property
    def picks(self) -> list[FurnitureRef]:
        """The pieces."""
        return sample_refs(furniture_refs(self.set), self.sample, self.seed)

    @property
    def command(self) -> str:
        """That plays the same."""
        sample = "" if self.sample is None else f" --sample {self.sample}"
        how = " --search" if self.search else ""
        how += " --setting full" if self.setting == "full" else ""
        how += " --execution dynamic" if self.execution == "dynamic" else ""
        return f"roboassembly evaluate --policy {self.policy}{how} --set {self.set}{sample} --seed {self.seed} --json"


def trials(b: Benchmark, folder: Path) -> list[Trial]:
    """All that is played once the training is done, in the table's order."""
    test = f"{b.set}:test"
    relational = "relational" if b.shipped else str(folder / "relational" / "policy.npz")
    paper, of_paper = str(folder / "paper" / "policy.npz"), PAPER[b.setting]["test"]
    full = b.setting == "full"
    steps = "" if full else "37.8k"
    trial = partial(Trial, b.setting, sample=b.sample, seed=b.seed)
    every = [
        trial("random", "random", False, test),
        trial("preset paper", paper, False, test, paper=of_paper, paper_steps=steps),
        trial("relational", relational, False, test, paper=of_paper, paper_steps=steps),
        trial("relational with search", relational, True, test, execution="dynamic" if full else "kinematic"),
        trial("search alone", "search", False, test),
    ]
    if not full:
        tree = "RRT-Connect in 6M dimensions"
        every.insert(0, trial(tree, "joint-rrt", False, test, paper=18.8, paper_steps="91.7k"))
    for real in b.real:
        every += [trial("relational", relational, False, real), trial("relational with search", relational, True, real)]
    return every


def tried(trial: Trial, folder: Path, jobs: int) -> Iterator[Progress]:
    """Play what is not played yet."""
    picks = trial.picks
    path = folder / "episodes" / trial.file
    there = episodes_of(path, trial)
    if len(there) == len(picks):
        return
    rest = partial(evaluate, trial.way, picks, trial.seed, jobs, played=len(there))
    solved = 0
    for done, episode in enumerate(record_episodes(path, _about(trial), there, rest), 1):
        solved += episode.success
        if done > len(there):
            yield Progress(f"{trial.name}, {trial.set}", done, len(picks), {"success": solved / done})


def _about(trial: Trial) -> dict[str, Any]:
    """What episodes belong to; of other weights or another set they are played again."""
    return {
        "trial": asdict(trial),
        "weights": weights_hash(trial.policy),
        "set_hash": set_hash(trial.picks),
    }


def episodes_of(path: Path, trial: Trial) -> list[Episode]:
    """Those of a file, as far as they are the trial's."""
    return read_episodes(path, _about(trial)) or []


def rows(b: Benchmark, folder: Path) -> list[Row]:
    """The table of a run that is done."""
    out = []
    picks = taught(b)
    split_of = {p.name: p.entry.split for p in picks if p.entry is not None}
    trained = results(picks, folder)
    full = " --setting full" if b.setting == "full" else ""
    sample = "" if b.taught is None else f" --sample {b.taught}"
    told = f"roboassembly train expert{full} --set {b.set}:train{sample} --seed {b.seed} --json"
    for split in ("easy", "hard"):
        some = [r for r in trained if split_of[r.name] == split]
        figures = mastery(some)
        if figures["n"]:
            out.append(Row("experts", f"{split} training chairs", figures, told, PAPER[b.setting][split]))
    for trial in trials(b, folder):
        out += _rows_of(trial, episodes_of(folder / "episodes" / trial.file, trial))
    return out


def _rows_of(trial: Trial, every: Sequence[Episode]) -> Iterator[Row]:
    """All, those of unseen families, and what became of plans in physics."""
    played = [e for e in every if e.verdict != REFUSED]
    carried = [e for e in played if e.executed is not None]
    if trial.execution == "dynamic":
        played = [replace(e, success=e.executed is not None) for e in played]
    unseen = [e for e in played if e.unseen]

    def row(name: str, on: str, some: Sequence[Episode]) -> Row:
        figures = Evaluation(trial.way, trial.set, trial.seed, tuple(some)).to_json()
        return Row(name, on, figures, trial.command)

    if played:
        whole = row(trial.name, trial.set, played)
        figures = whole.figures | {"refused": len(every) - len(played)}
        yield replace(whole, figures=figures, paper=trial.paper, paper_steps=trial.paper_steps)
    if unseen and trial.policy not in ("joint-rrt", "random", "search"):
        yield row(trial.name, f"{trial.set}{_UNSEEN}", unseen)
    if carried:
        yield row(f"{trial.name}: its plans carried out in physics", trial.set, carried)


def report(b: Benchmark, folder: Path) -> dict[str, Any]:
    """All that the run says, as JSON."""
    seconds = folder / "seconds.json"
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return {
        "setting": b.setting,
        "set": b.set,
        "seed": b.seed,
        "date": time.strftime("%Y-%m-%d"),
        "machine": machine,
        "seconds": json.loads(seconds.read_text()) if seconds.is_file() else {},
        "rows": [asdict(row) for row in rows(b, folder)],
        "out": str(folder),
    }


def table(told: dict[str, Any]) -> list[str]:
    """Lines of Markdown, from `report`."""
    lines = [
        f"On {told['date']}, {told['machine']}, seed {told['seed']}.",
        "",
        "| | on | paper, % | here, % | 95 % | n | planning steps, paper | here | of the solved |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in told["rows"]:
        f = row["figures"]
        low, high = f["ci95"]
        steps = [_count(f.get(name)) for name in ("planning_steps_mean", "planning_steps_mean_solved")]
        cells = [
            row["name"], row["on"], "" if row["paper"] is None else f"{row['paper']:.1f}",
            f"{100 * f['success_rate']:.1f}", f"{100 * low:.1f}–{100 * high:.1f}", str(f["n"]), row["paper_steps"],
            *steps,
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    if any(row["figures"].get("refused") for row in told["rows"]):
        counts = {row["on"]: row["figures"]["refused"] for row in told["rows"] if row["figures"].get("refused")}
        lines += ["", "Left out because no two hands can hold and join all their parts: "
                  + ", ".join(f"{count} of {on}" for on, count in counts.items()) + "."]  # fmt: skip
    fresh = {r["on"]: f["trials_success_rate"] for r in told["rows"] if "trials_success_rate" in (f := r["figures"])}
    if told["setting"] == "full" and fresh:
        lines += ["", "Experts count as in the paper, where paths once found are kept: by plays from starts that they "
                  "were taught on. From starts that they were not taught on they finish "
                  + ", ".join(f"{100 * rate:.1f} % of {on}" for on, rate in fresh.items()) + "."]  # fmt: skip
    ended = [(row["name"], row["on"], row["figures"].get("failures")) for row in told["rows"]]
    if any(kinds for _, _, kinds in ended):
        lines += ["", "What ended those that failed:", ""]
        lines += [
            f"- {name}, {on}: {', '.join(f'{count} {kind}' for kind, count in kinds.items())}"
            for name, on, kinds in ended
            if kinds and not on.endswith(_UNSEEN)
        ]
    commands = list(dict.fromkeys(row["command"] for row in told["rows"]))
    lines += ["", "Each row alone:", "", *(f"- `{command}`" for command in commands)]
    if told["seconds"]:
        lines += ["", "Wall time: " + ", ".join(f"{k} {v / 60:.0f} min" for k, v in told["seconds"].items()) + "."]
    return lines


def _count(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}"


def check_marks(document: Path, setting: SettingName = "object-centric") -> tuple[str, str, str]:
    """A document up to the table of a setting, the first mark, and from the table on.

    Raises:
        InputError: it cannot be read, or has no marks.
    """
    try:
        text = document.read_text()
    except OSError as error:
        raise InputError(f"cannot read {document}: {error.strerror or error}") from None
    before, mark, rest = text.partition(begin(setting))
    inside, end, after = rest.partition(END)
    if not mark or not end:
        raise InputError(f"{document} has no lines '{begin(setting)} -->' and '{END}' to write between")
    return before, mark + inside.partition("\n")[0], end + after


def put_into(document: Path, lines: Sequence[str], setting: SettingName = "object-centric") -> None:
    """Replace what stands between the marks of a setting in a document.

    Raises:
        InputError: it cannot be read, or has no marks.
    """
    before, mark, after = check_marks(document, setting)
    scratch = document.with_name(f".{document.name}.part")
    scratch.write_text(f"{before}{mark}\n\n" + "\n".join(lines) + f"\n\n{after}")
    scratch.replace(document)


def _same_run(b: Benchmark, folder: Path) -> None:
    """Refuse a folder of another benchmark."""
    path, about = folder / "about.json", json.loads(json.dumps(asdict(b)))
    if path.is_file():
        before = json.loads(path.read_text())
        other = [name for name, value in about.items() if before.get(name) != value and name not in ("real",)]
        if other:
            raise InputError(f"{folder} holds a benchmark with another {', '.join(other)}; take a new folder")
    path.write_text(json.dumps(about, indent=1))


def _timed(folder: Path, stage: str, steps: Iterable[Progress]) -> Iterator[Progress]:
    """Add up the seconds of a stage over all the runs that it took; of one that is killed the last few are lost."""
    path = folder / "seconds.json"
    seconds = json.loads(path.read_text()) if path.is_file() else {}
    begun = written = time.monotonic()
    before = seconds.get(stage, 0.0)

    def write() -> None:
        seconds[stage] = round(before + time.monotonic() - begun, 1)
        path.write_text(json.dumps(seconds))

    try:
        for step in steps:
            if time.monotonic() - written > _OFTEN:
                write()
                written = time.monotonic()
            yield step
    finally:
        write()
