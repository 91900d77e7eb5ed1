"""Teaches the relational policy, from nothing to a checkpoint: lessons, imitation, and rounds of aggregation.

In each round after the first the student plays the chairs itself, its mistakes are corrected, and it goes on learning
from all lessons so far (DAgger, Ross et al. 2011). Everything is kept in one folder; whatever is there already is not
done again, so that a run that was stopped goes on where it was.

    lessons/0/…        of random good moves       policy-0.npz   taught with them
    lessons/1/…        of policy-0's plays        policy-1.npz   taught with both
    …                                             policy.npz     the last one, to be shipped

In the full setting this begins with the weights of a policy that knows the object-centric one, and ends with the first
round; lessons of grasps teach a second network, and the rounds are its own:

    lessons/0/hands/…  of random hands            grasping-0.npz  taught with them
    practice/1/…       of player-1's plays        grasping-1.npz  taught with both

`policy.npz` holds all three then, so that one file plays in both settings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from roboassembly.datasets.sets import RECIPES, furniture_refs, set_hash
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.generated import EXTRA_SEEDS, extra_names
from roboassembly.learning.layers import Params
from roboassembly.learning.policy_weights import load_weights
from roboassembly.learning.progress import Progress
from roboassembly.learning.relational import imitation
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import collect, grasp_folder
from roboassembly.learning.relational.grasps import imitation as grasp_imitation
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.on_policy import collect_on_policy
from roboassembly.learning.relational.imitation import Example, Training
from roboassembly.learning.relational.network import RelationalConfig
from roboassembly.learning.relational.policy import FULL_PARAMS, GRASP_PARAMS, RelationalPolicy
from roboassembly.task.setting import SettingName

_VALIDATION_SEEDS = EXTRA_SEEDS + 1_000_000


@dataclass(frozen=True)
class Curriculum:
    """What the policy is taught, and for how long."""

    set: str = "chairs-412:train"
    """Its chairs are all taught."""
    limit: int | None = None
    """The first so many of them only."""
    extra: int = 6_000
    """Generated pieces besides: chairs of the set's training families, and others to collect_on_policy on."""
    validation: int = 60
    """Pieces of neither on which progress is told."""
    plays: int = 1
    """Of each piece, in each round; with hands, of lessons of pairs, the first of them its own."""
    rounds: int = 0
    """Of aggregation, after the first; with hands, of what its own plays tell of them."""
    steps: int = 16_000
    """Updates in the first round."""
    round_steps: int = 8_000
    """Updates in each later one."""
    learning_rate: float = 2e-3
    batch: int = 16
    seed: int = 0
    network: RelationalConfig = field(default_factory=RelationalConfig)
    setting: SettingName = "object-centric"
    start: str = ""
    """Policy to begin with, by name or path; needed in the full setting, where it is kept for the other one."""
    grasp_steps: int = 12_000
    """Updates of the network that chooses grasps (full)."""

    @staticmethod
    def with_hands() -> Curriculum:
        """What the shipped policy learns besides to play with robots."""
        return Curriculum(
            extra=1_500, validation=24, plays=3, rounds=1, steps=3_000, learning_rate=1e-3, setting="full",
            start="relational",
        )  # fmt: skip


def teach(curriculum: Curriculum, folder: Path, jobs: int) -> Iterator[Progress]:
    """Run the whole curriculum in `folder`, from where it was left.

    Args:
        curriculum: what to do.
        folder: of the run.
        jobs: chairs at a time.

    Raises:
        InputError: the set is not built, or the folder holds another curriculum's run.
    """
    if curriculum.set.partition(":")[0] not in RECIPES:
        raise InputError(f"--set {curriculum.set}: lessons are made of generated chairs; one of {', '.join(RECIPES)}")
    started = _start_of(curriculum, folder)
    picks = furniture_refs(curriculum.set)[: curriculum.limit]
    unseen = RECIPES[curriculum.set.partition(":")[0]].unseen_families
    names = [p.name for p in picks] + extra_names(curriculum.extra, unseen)
    held_out = extra_names(curriculum.validation, unseen, first=_VALIDATION_SEEDS)
    notes = {"curriculum": asdict(curriculum), "set_hash": set_hash(picks)}
    yield from _gathered("validation", held_out, folder / "lessons" / "validation", curriculum, jobs, None)
    validation = imitation.load_examples(folder / "lessons" / "validation", held_out, jobs)
    examples: list[Example] = []
    last = started
    full = curriculum.setting == "full"
    for round_ in range(1 if full else curriculum.rounds + 1):
        lessons = folder / "lessons" / str(round_)
        with_grasps = [p.name for p in picks] if full else []
        yield from _gathered(f"lessons {round_}", names, lessons, curriculum, jobs, last, with_grasps)
        path = folder / f"policy-{round_}.npz"
        steps = curriculum.round_steps if round_ else curriculum.steps
        examples += imitation.load_examples(lessons, names, jobs)
        if not finished(path, steps):
            rate = curriculum.learning_rate * (0.5 if round_ else 1.0)
            training = Training(steps, rate, batch=curriculum.batch, seed=curriculum.seed + round_)
            yield from _taught(
                f"policy {round_}", examples, validation, path, training, curriculum.network, notes, last
            )
        last = path
    assert last is not None
    final = checkpoint.load(last, relational.KIND)
    if full:
        assert started is not None
        learnt = {**checkpoint.load(started, relational.KIND).params, FULL_PARAMS: final.params}
        yield from _taught_hands(learnt, final.config, names, folder, curriculum, notes, jobs)
    else:
        _write(folder / "policy.npz", final.params, final.config)


def _taught_hands(
    learnt: Params, config: dict[str, Any], names: Sequence[str], folder: Path, c: Curriculum, notes: dict[str, Any],
    jobs: int,
) -> Iterator[Progress]:  # fmt: skip
    """The network that chooses grasps: taught once, and again after each round of its own plays."""
    lessons = [grasp_folder(folder / "lessons" / "0")]
    for round_ in range(c.rounds + 1):
        if round_:
            lessons.append(folder / "practice" / str(round_))
            there = sum(dataset_file(lessons[-1], name).is_file() for name in names)
            mistakes = tried = 0
            player = folder / f"player-{round_}.npz"
            practice = collect_on_policy(names, lessons[-1], player, episodes=1, seed=c.seed + round_, jobs=jobs)
            for done, g in enumerate(practice, 1):
                mistakes, tried = mistakes + g.mistakes, tried + g.choices
                scalars = {"mistakes": mistakes / max(tried, 1)}
                yield Progress(f"practice {round_}", there + done, len(names), scalars)
        grasps = folder / f"grasping-{round_}.npz"
        yield from _taught_grasps(lessons, names, grasps, c, notes, jobs)
        taught = {**learnt, GRASP_PARAMS: checkpoint.load(grasps, grasping.KIND).params}
        last = round_ == c.rounds
        _write(folder / ("policy.npz" if last else f"player-{round_ + 1}.npz"), taught, config)


def _write(path: Path, params: Params, config: dict[str, Any]) -> None:
    """A policy to play with."""
    checkpoint.save(path, checkpoint.Checkpoint(relational.KIND, params, config, {}), half=True)


def _start_of(c: Curriculum, folder: Path) -> Path | None:
    """The weights to begin with, by themselves; None where there are none.

    Raises:
        InputError: there is no such policy, it is of another network, or none is named in the full setting.
    """
    if not c.start:
        if c.setting == "full":
            raise InputError("--setting full goes on from a policy that knows the pairs: --start relational would do")
        return None
    loaded = load_weights(c.start)
    policy = RelationalPolicy.from_checkpoint(loaded, c.start) if loaded.kind == relational.KIND else None
    if policy is None or loaded.config.get("network") != asdict(c.network):
        raise InputError(f"--start {c.start}: its network is not the one to be taught; --start relational would do")
    path = folder / "start.npz"
    checkpoint.save(path, checkpoint.Checkpoint(loaded.kind, policy.params, loaded.config, {}))
    return path


def _taught_grasps(
    folders: Sequence[Path], names: Sequence[str], path: Path, c: Curriculum, notes: dict[str, Any], jobs: int
) -> Iterator[Progress]:
    training = grasp_imitation.Training(steps=c.grasp_steps, seed=c.seed)
    files = [file for folder in folders for name in names if (file := dataset_file(folder, name)).is_file()]
    if finished(path, training.steps, grasping.KIND):
        return
    examples = grasp_imitation.examples_of(files, jobs)
    for step, terms in grasp_imitation.train(examples, path, training, notes):
        yield Progress("grasps", step, training.steps, terms)


def _gathered(
    stage: str, names: Sequence[str], folder: Path, c: Curriculum, jobs: int, student: Path | None,
    with_grasps: Sequence[str] = (),
) -> Iterator[Progress]:  # fmt: skip
    there = sum(dataset_file(folder, name).is_file() for name in names)
    mistakes = choices = 0
    gathering = collect(
        names, folder, episodes=c.plays, seed=c.seed, jobs=jobs, policy=student, setting=c.setting,
        with_grasps=with_grasps,
    )  # fmt: skip
    for done, g in enumerate(gathering, 1):
        mistakes, choices = mistakes + g.mistakes, choices + g.choices
        scalars = {"mistakes": mistakes / max(choices, 1)} if student else {}
        yield Progress(stage, there + done, len(names), scalars)


def _taught(
    stage: str, examples: list[Example], validation: list[Example], path: Path, training: Training,
    network: RelationalConfig, notes: dict[str, Any], initial: Path | None,
) -> Iterator[Progress]:  # fmt: skip
    for step, terms in imitation.train(examples, path, training, network, notes, initial):
        scalars = dict(terms)
        if validation and (step % 1_000 == 0 or step == training.steps):
            scalars["validation"] = imitation.share_good(checkpoint.load(path, relational.KIND).params, validation)
        yield Progress(stage, step, training.steps, scalars)


def finished(path: Path, steps: int, kind: str = relational.KIND) -> bool:
    """Whether the checkpoint at `path`, of a kind of network, has had its steps."""
    return path.is_file() and int(checkpoint.load(path, kind).extra["step"]) >= steps
