"""Makes the paper's table: trains experts and both multi-task policies, and measures them on unseen furniture.

One stage after another, each kept in the run's folder; stages that are done are not done again.

    autoencoder.npz  experts/  samples/     of the training chairs
    paper/policy.npz  relational/policy.npz
    episodes/<row>.jsonl                    every episode as it ends
    benchmark.json  table.md                report and table
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
from roboassembly.evaluation.episodes import Episode, read_episodes, record_episodes
from roboassembly.evaluation.evaluate import Evaluation, evaluate
from roboassembly.evaluation.report import UNSEEN, Row
from roboassembly.evaluation.rollout import REFUSED, RolloutConfig
from roboassembly.learning.paper.autoencoder import AutoencoderTraining
from roboassembly.learning.paper.dqn.results import summary
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.pipeline import (
    AggregationConfig,
    PipelineConfig,
    autoencoder_file,
    expert_results,
    experts_folder,
    samples_folder,
    train_autoencoder,
    train_experts,
    train_policy,
)
from roboassembly.learning.policy_weights import weights_hash
from roboassembly.learning.progress import Progress
from roboassembly.learning.relational.network import RelationalConfig
from roboassembly.learning.relational.pipeline import RelationalPipelineConfig, run_pipeline
from roboassembly.settings import DEFAULT, SETTINGS, ExecutionName
from roboassembly.solvers.dataset_builder import build_dataset
from roboassembly.task.setting import SettingName

_WRITE_INTERVAL = 5.0
"""Time between two writes of a stage's duration [s]."""
_AGGREGATED = "aggregated.npz"
"""Name of the file of the preset `paper` after aggregation, beside that of the policy without."""
_TINY = RelationalConfig(token=32, pair=16, layers=1, heads=2, conflict_inputs=8, conflicts=2)


@dataclass(frozen=True)
class BenchmarkConfig:
    """Settings of a benchmark: what it trains and measures."""

    setting: SettingName = DEFAULT
    set: str = "chairs-412"
    train_limit: int | None = None
    """Number of training chairs, from the first, if the relational policy is trained; all if None."""
    experts: int | None = None
    """Number of training chairs that get an expert, drawn by the seed; all if None."""
    sample: int | None = None
    """Number of pieces of each set that are measured, drawn by the seed; all if None."""
    real: tuple[str, ...] = ()
    """Additional sets of real furniture for the relational policy, each `folder:PATH`."""
    train: bool = True
    """Train experts and the preset `paper`; otherwise their rows are left out."""
    shipped: bool = True
    """Use the relational policy of the package; otherwise train one."""
    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    paper: PaperTraining = field(default_factory=PaperTraining)
    rounds: int = 1
    """Number of rounds of aggregation of the preset `paper`, for a row of its own; none if 0."""
    round_steps: int = AggregationConfig.steps
    """Number of gradient steps in each of them."""
    relational: RelationalPipelineConfig = field(default_factory=RelationalPipelineConfig)
    seed: int = 0

    @staticmethod
    def whole(setting: SettingName = DEFAULT, seed: int = 0) -> BenchmarkConfig:
        """Return the configuration of the paper's table."""
        return replace(_WHOLE[setting], seed=seed)

    @staticmethod
    def quick(setting: SettingName = DEFAULT, seed: int = 0) -> BenchmarkConfig:
        """Return a tiny configuration that runs all stages, to see that they work."""
        return replace(_QUICK[setting], seed=seed)


def _by_setting(*configs: BenchmarkConfig) -> dict[SettingName, BenchmarkConfig]:
    return {config.setting: config for config in configs}


_WHOLE = _by_setting(
    BenchmarkConfig(),
    # An update takes several times as long: two points have 64 grasp pairs in place of six `w`.
    BenchmarkConfig(
        "full", pipeline=PipelineConfig.default("full"), paper=PaperTraining(steps=20_000), rounds=0,
        relational=RelationalPipelineConfig.default("full"),
    ),
)  # fmt: skip
_QUICK_BASE = BenchmarkConfig(
    set="chairs-24", train_limit=3, experts=3, shipped=False, paper=PaperTraining(steps=40), round_steps=20
)
_QUICK = _by_setting(
    replace(
        _QUICK_BASE, sample=3, relational=RelationalPipelineConfig(extra=0, validation=0, steps=40, network=_TINY),
        pipeline=PipelineConfig(
            AutoencoderTraining(steps=40), 4, ExpertTraining(steps=1_600), episodes=2
        ),
    ),
    replace(
        _QUICK_BASE, setting="full", sample=2, rounds=0,
        relational=replace(RelationalPipelineConfig.default("full"), extra=0, steps=40),
        pipeline=PipelineConfig(
            AutoencoderTraining(steps=40), 4, ExpertTraining(steps=1_600, setting="full"), episodes=8
        ),
    ),
)  # fmt: skip


def run(config: BenchmarkConfig, folder: Path, jobs: int) -> Iterator[Progress]:
    """Run all stages that are not done yet.

    Args:
        config: what is trained and measured.
        folder: folder of the run.
        jobs: number of processes.

    Raises:
        InputError: no such set, or the folder holds another benchmark's run.
    """
    if config.set not in RECIPES:
        raise InputError(f"--set {config.set}: the table is made on a generated set; one of {', '.join(RECIPES)}")
    folder.mkdir(parents=True, exist_ok=True)
    _check_same_run(config, folder)
    if not manifest_path(config.set).is_file():
        for done, total in build_dataset(RECIPES[config.set], 0, jobs):
            yield Progress(f"data set {config.set}", done, total, {})
    if config.train:
        yield from _paper_stages(config, folder, jobs)
    if not config.shipped:
        relational = replace(config.relational, set=f"{config.set}:train", limit=config.train_limit, seed=config.seed)
        yield from timed(folder, "relational", run_pipeline(relational, folder / "relational", jobs))
    measured = chain.from_iterable(measure(measurement, folder, jobs) for measurement in measurements(config, folder))
    yield from timed(folder, "evaluation", measured)


def _paper_stages(config: BenchmarkConfig, folder: Path, jobs: int) -> Iterator[Progress]:
    """Train the experts and the preset `paper`."""
    pipeline, chairs = config.pipeline.seeded(config.seed), expert_chairs(config)
    # `train expert` keeps the same notes, and so either command goes on with the other's run.
    notes = {"set": f"{config.set}:train"}
    features = train_autoencoder(chairs, folder, pipeline, {**notes, "limit": None, "sample": config.experts}, jobs)
    experts = train_experts(chairs, folder, pipeline, notes, jobs)
    yield from timed(folder, "experts", chain(features, experts))
    training = replace(config.paper, seed=config.seed)
    paper = train_policy([samples_folder(folder)], autoencoder_file(folder), folder / "paper", training)
    yield from timed(folder, "paper", paper)
    if config.rounds:
        aggregation = AggregationConfig(
            chairs, experts_folder(folder), config.rounds, config.round_steps, training=pipeline.experts
        )
        aggregated = train_policy(
            [samples_folder(folder)],
            autoencoder_file(folder),
            folder / "paper",
            training,
            aggregation,
            jobs,
            _AGGREGATED,
        )
        yield from timed(folder, "aggregation", aggregated)


def expert_chairs(config: BenchmarkConfig) -> list[FurnitureRef]:
    """Return the training chairs that get an expert."""
    return sample_refs(furniture_refs(f"{config.set}:train"), config.experts, config.seed)


@dataclass(frozen=True)
class Measurement:
    """Evaluation of one policy or solver on one set."""

    setting: SettingName
    name: str
    policy: str
    """Policy as `roboassembly evaluate --policy` takes it."""
    search: bool
    set: str
    sample: int | None
    seed: int
    paper: float | None = None
    """Success in the paper [%]; None if the paper has no such row."""
    paper_steps: str = ""
    """Planning steps in the paper."""
    execution: ExecutionName = "kinematic"

    @property
    def config(self) -> RolloutConfig:
        """Configuration of its episodes."""
        return RolloutConfig(self.policy, self.search, self.setting, self.execution, meshes=False)

    @property
    def file(self) -> str:
        """Name of the file that keeps its episodes."""
        set_name = self.set.replace(":", "-").replace("/", "-").strip("-")
        return f"{self.name.replace(' ', '-')}-{set_name}.jsonl"

    @property
    def refs(self) -> list[FurnitureRef]:
        """Pieces of furniture."""
        return sample_refs(furniture_refs(self.set), self.sample, self.seed)

    @property
    def command(self) -> str:
        """Command that measures the same."""
        sample = "" if self.sample is None else f" --sample {self.sample}"
        options = " --search" if self.search else ""
        options += SETTINGS[self.setting].option
        options += " --execution dynamic" if self.execution == "dynamic" else ""
        return (
            f"roboassembly evaluate --policy {self.policy}{options} --set {self.set}{sample} --seed {self.seed} --json"
        )

    @property
    def description(self) -> dict[str, Any]:
        """Description of its episodes; those of other weights or of another set do not count."""
        return {
            "measurement": asdict(self),
            "weights": weights_hash(self.policy),
            "set_hash": set_hash(self.refs),
        }

    def known_episodes(self, folder: Path) -> list[Episode]:
        """Return the episodes that a run's folder holds."""
        return read_episodes(folder / "episodes" / self.file, self.description) or []


def measurements(config: BenchmarkConfig, folder: Path) -> list[Measurement]:
    """Return all that is measured once the training is done, in the table's order."""
    test, figures = f"{config.set}:test", SETTINGS[config.setting].paper
    relational = "relational" if config.shipped else str(folder / "relational" / "policy.npz")
    paper, aggregated = (str(folder / "paper" / name) for name in ("policy.npz", _AGGREGATED))
    execution = SETTINGS[config.setting].execution
    measurement = partial(Measurement, config.setting, sample=config.sample, seed=config.seed)
    in_paper = partial(measurement, paper=figures.test, paper_steps=figures.steps)
    trained = [
        in_paper("preset paper", paper, False, test),
        *([in_paper("preset paper, aggregated", aggregated, False, test)] if config.rounds else []),
    ]
    rows = [
        measurement("random", "random", False, test),
        *(trained if config.train else []),
        in_paper("relational", relational, False, test),
        measurement("relational with search", relational, True, test, execution=execution),
        measurement("search alone", "search", False, test),
    ]
    if figures.rrt_connect is not None:
        baseline = partial(measurement, paper=figures.rrt_connect, paper_steps=figures.rrt_connect_steps)
        rows.insert(0, baseline("RRT-Connect in 6M dimensions", "joint-rrt", False, test))
    for real in config.real:
        rows.append(measurement("relational", relational, False, real))
        rows.append(measurement("relational with search", relational, True, real))
    return rows


def measure(measurement: Measurement, folder: Path, jobs: int) -> Iterator[Progress]:
    """Run the episodes that the folder does not hold yet."""
    refs = measurement.refs
    known = measurement.known_episodes(folder)
    if len(known) == len(refs):
        return
    rest = partial(evaluate, measurement.config, refs, measurement.seed, jobs, done=len(known))
    path, solved = folder / "episodes" / measurement.file, 0
    for done, episode in enumerate(record_episodes(path, measurement.description, known, rest), 1):
        solved += episode.success
        if done > len(known):
            yield Progress(f"{measurement.name}, {measurement.set}", done, len(refs), {"success": solved / done})


def rows(config: BenchmarkConfig, folder: Path) -> list[Row]:
    """Return the table's rows of a finished run."""
    out: list[Row] = []
    chairs, figures_of = expert_chairs(config), asdict(SETTINGS[config.setting].paper)
    split_of = {ref.name: ref.entry.split for ref in chairs if ref.entry is not None}
    trained = expert_results(chairs, folder) if config.train else []
    option = SETTINGS[config.setting].option
    sample = "" if config.experts is None else f" --sample {config.experts}"
    command = f"roboassembly train expert{option} --set {config.set}:train{sample} --seed {config.seed} --json"
    for split in ("easy", "hard"):
        figures = summary([r for r in trained if split_of[r.name] == split])
        if figures["n"]:
            out.append(Row("experts", f"{split} training chairs", figures, command, figures_of[split]))
    for measurement in measurements(config, folder):
        out += _rows_of(measurement, measurement.known_episodes(folder))
    return out


def _rows_of(measurement: Measurement, episodes: Sequence[Episode]) -> Iterator[Row]:
    """Yield the row of all episodes, of those of unseen families, and of plans carried out in physics."""
    accepted = [e for e in episodes if e.verdict != REFUSED]
    executed = [e for e in accepted if e.executed is not None]
    if measurement.execution == "dynamic":
        accepted = [replace(e, success=e.executed is not None) for e in accepted]
    unseen = [e for e in accepted if e.unseen]

    def row(name: str, on: str, some: Sequence[Episode]) -> Row:
        figures = Evaluation(measurement.config, measurement.set, measurement.seed, tuple(some)).to_json()
        return Row(name, on, figures, measurement.command)

    if accepted:
        whole = row(measurement.name, measurement.set, accepted)
        figures = whole.figures | {"refused": len(episodes) - len(accepted)}
        yield replace(whole, figures=figures, paper=measurement.paper, paper_steps=measurement.paper_steps)
    if unseen and measurement.policy not in ("joint-rrt", "random", "search"):
        yield row(measurement.name, f"{measurement.set}{UNSEEN}", unseen)
    if executed:
        yield row(f"{measurement.name}: its plans carried out in physics", measurement.set, executed)


def report(config: BenchmarkConfig, folder: Path) -> dict[str, Any]:
    """Return the report of a finished run as JSON."""
    seconds = folder / "seconds.json"
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return {
        "setting": config.setting,
        "set": config.set,
        "seed": config.seed,
        "date": time.strftime("%Y-%m-%d"),
        "machine": machine,
        "seconds": json.loads(seconds.read_text()) if seconds.is_file() else {},
        "rows": [asdict(row) for row in rows(config, folder)],
        "out": str(folder),
    }


def _check_same_run(config: BenchmarkConfig, folder: Path) -> None:
    """Refuse a folder of another benchmark."""
    path, about = folder / "about.json", json.loads(json.dumps(asdict(config)))
    if path.is_file():
        before = json.loads(path.read_text())
        other = [name for name, value in about.items() if before.get(name) != value and name not in ("real", "train")]
        if other:
            raise InputError(f"{folder} holds a benchmark with another {', '.join(other)}; take a new folder")
    path.write_text(json.dumps(about, indent=1))


def timed(folder: Path, stage: str, steps: Iterable[Progress]) -> Iterator[Progress]:
    """Add up the seconds of a stage over all its runs; a run that is killed loses the last few."""
    path = folder / "seconds.json"
    seconds: dict[str, float] = json.loads(path.read_text()) if path.is_file() else {}
    begun = written = time.monotonic()
    before = seconds.get(stage, 0.0)

    def write() -> None:
        seconds[stage] = round(before + time.monotonic() - begun, 1)
        path.write_text(json.dumps(seconds))

    try:
        for step in steps:
            if time.monotonic() - written > _WRITE_INTERVAL:
                write()
                written = time.monotonic()
            yield step
    finally:
        write()
