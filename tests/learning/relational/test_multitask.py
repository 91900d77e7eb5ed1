"""The curriculum of the relational policy: lessons, rounds of aggregation, resuming, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.datasets import sets as datasets
from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import run_episode
from roboassembly.learning import checkpoint, logs
from roboassembly.learning.datasets import dataset_file, load_samples
from roboassembly.learning.generated import EXTRA_SEEDS, extra_names
from roboassembly.learning.layers import Params
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.imitation import Training
from roboassembly.learning.paper.pipeline import teach_paper
from roboassembly.learning.progress import Progress
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational import imitation
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import collect, grasp_folder
from roboassembly.learning.relational.pipeline import Curriculum, teach
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.learning.relational.tokens import tokens_of_sample

TINY = relational.RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)
SMALL = Curriculum(
    set="chairs-24:train", extra=1, validation=1, plays=1, rounds=1, steps=12, round_steps=6, batch=2, seed=3,
    network=TINY,
)  # fmt: skip


@pytest.fixture
def two_chairs(as_built, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A data set of two chairs of four parts; extra ones are of the same family."""
    monkeypatch.setattr("roboassembly.learning.generated.CHAIRS", ["cantilever"])
    return as_built(easy=[("cantilever", 1), ("cantilever", 5)])


def test_extra_names_are_of_seen_families_and_of_no_data_set() -> None:
    names = extra_names(40, ("rocker", "splat"))
    assert len(set(names)) == 40
    assert names[:7] == extra_names(7, ("rocker", "splat"))
    families, seeds = zip(*(name.split(":") for name in names), strict=True)
    assert not {"rocker", "splat"} & set(families)
    assert min(map(int, seeds)) >= EXTRA_SEEDS


def test_lessons_are_gathered_once_and_by_the_student(tmp_path: Path) -> None:
    names = ["cantilever:1", "three_legged:1"]
    first = list(collect(names, tmp_path / "0", episodes=2, seed=0, jobs=1))
    assert [g.name for g in first] == names
    assert not list(collect(names, tmp_path / "0", episodes=2, seed=0, jobs=1))
    courses = load_samples(tmp_path / "0", names)
    assert [len(c.samples) for c in courses] == [g.states for g in first]
    # Another run gives the same; a student that knows nothing errs and is corrected: every play still ends well.
    again = list(collect(names, tmp_path / "again", episodes=2, seed=0, jobs=1))
    assert [g.states for g in again] == [g.states for g in first]
    fresh = relational.init(np.random.default_rng(0), TINY)
    student = tmp_path / "student.npz"
    checkpoint.save(student, checkpoint.Checkpoint(relational.KIND, fresh, {}, {}))
    taught = list(collect(names[:1], tmp_path / "1", episodes=1, seed=0, jobs=1, policy=student))
    assert taught[0].choices == 3  # four parts
    assert 0 < taught[0].mistakes <= 3


def test_a_student_that_knows_hands_plays_with_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    params = relational.init(rng, TINY) | relational.init_grasp_inputs(rng, TINY)
    student = tmp_path / "student.npz"
    checkpoint.save(student, checkpoint.Checkpoint(relational.KIND, params, {}, {}))
    (taught,) = collect(["cantilever:1"], tmp_path / "0", episodes=1, seed=0, jobs=1, policy=student, setting="full")
    assert taught.choices == 3
    (course,) = load_samples(tmp_path / "0", ["cantilever:1"])
    assert course.grasps is not None
    assert tokens_of_sample(course, course.samples[0]).grasps is not None


@pytest.mark.slow
def test_a_curriculum_with_robots_ends_in_one_policy_for_both_settings(
    two_chairs: list[str], tmp_path: Path
) -> None:  # fmt: skip
    with pytest.raises(InputError, match="--start relational"):
        next(teach(replace(SMALL, setting="full"), tmp_path / "none", 1))
    with pytest.raises(InputError, match="its network"):
        next(teach(replace(SMALL, setting="full", start="relational"), tmp_path / "none", 1))
    start = tmp_path / "start.npz"
    weights = relational.init(np.random.default_rng(0), TINY)
    config = {"network": asdict(TINY)}
    checkpoint.save(start, checkpoint.Checkpoint(relational.KIND, weights, config, {}), half=True)
    curriculum = replace(
        SMALL, setting="full", start=str(start), rounds=1, limit=1, extra=0, validation=0, grasp_steps=5
    )
    folder = tmp_path / "run"
    stages = {p.stage for p in teach(curriculum, folder, 1)}
    assert {"lessons 0", "policy 0", "grasps", "practice 1"} <= stages
    assert all(dataset_file(folder / "practice" / "1", name).is_file() for name in two_chairs[:1])
    assert all(dataset_file(grasp_folder(folder / "lessons" / "0"), name).is_file() for name in two_chairs[:1])
    policy = load_policy(str(folder / "policy.npz"))
    assert isinstance(policy, RelationalPolicy)
    assert policy.settings == ("object-centric", "full")
    assert policy.full_params is not None
    before = checkpoint.load(start, relational.KIND).params
    # The one setting is what it was; for the other both networks have learnt.
    flat = dict(_flat(policy.params))
    assert all(np.array_equal(v, flat[k]) for k, v in _flat(before))
    assert any(not np.array_equal(v, flat[k]) for k, v in _flat(policy.full_params))
    assert {p.stage for p in teach(curriculum, folder, 1)} == set()


def _flat(params: Params, above: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in params.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}/")
        else:
            yield above + name, value


def test_a_curriculum_goes_on_where_it_was_stopped(two_chairs: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    stages: list[Progress] = []
    run = teach(SMALL, folder, 1)
    for progress in run:
        stages.append(progress)
        if progress.stage == "policy 0" and progress.done == 5:
            break
    run.close()
    before = dataset_file(folder / "lessons" / "0", two_chairs[0]).stat().st_mtime_ns
    stages += list(teach(SMALL, folder, 1))
    assert dataset_file(folder / "lessons" / "0", two_chairs[0]).stat().st_mtime_ns == before
    assert [s.stage for s in stages if s.done == s.total] == [
        "validation", "lessons 0", "policy 0", "lessons 1", "policy 1",
    ]  # fmt: skip
    assert 0.0 <= stages[-1].scalars["validation"] <= 1.0
    final = checkpoint.load(folder / "policy.npz", relational.KIND)
    assert final.config["set_hash"] == datasets.set_hash(datasets.furniture_refs("chairs-24:train"))
    assert final.config["curriculum"]["rounds"] == 1
    assert not final.extra
    # Nothing is left to do; another curriculum does not go on with this one's weights.
    assert list(teach(SMALL, folder, 1)) == []
    with pytest.raises(InputError, match="curriculum"):
        list(teach(replace(SMALL, round_steps=8), folder, 1))


def test_the_papers_policy_is_taught_from_folders_of_lessons(tmp_path: Path) -> None:
    list(collect(["cantilever:1"], tmp_path / "lessons", episodes=1, seed=0, jobs=1))
    encoder = autoencoder.init(np.random.default_rng(0))
    extractor = tmp_path / "autoencoder.npz"
    checkpoint.save(extractor, checkpoint.Checkpoint(autoencoder.KIND, encoder, {}, {}))
    training = Training(steps=2, batch=4)
    said = list(teach_paper([tmp_path / "lessons"], extractor, tmp_path / "run", training))
    assert [p.done for p in said] == [1, 2]
    policy = load_policy(str(tmp_path / "run" / "policy.npz"))
    assert run_episode(policy, catalogue.make("cantilever", 1), 0).merges in range(4)
    # More lessons are another run's.
    list(collect(["cantilever:5"], tmp_path / "lessons", episodes=1, seed=0, jobs=1))
    with pytest.raises(InputError, match="other samples"):
        list(teach_paper([tmp_path / "lessons"], extractor, tmp_path / "run", training))
    with pytest.raises(InputError, match="no samples"):
        list(teach_paper([tmp_path / "empty"], extractor, tmp_path / "other", training))


def test_share_good_counts_states_whose_surest_action_leads_on(tmp_path: Path) -> None:
    list(collect(["cantilever:1"], tmp_path, episodes=1, seed=0, jobs=1))
    examples = imitation.load_examples(tmp_path, ["cantilever:1"], 1)
    params = relational.init(np.random.default_rng(1), TINY)
    good = []
    for e in examples:
        q = relational.values(params, e.tokens)
        if e.good.any():
            good.append(bool(e.good[np.unravel_index(np.argmax(q), q.shape)]))
    assert imitation.share_good(params, examples) == pytest.approx(np.mean(good))


def test_logs_average_and_survive_a_broken_line(tmp_path: Path) -> None:
    with logs.Log(tmp_path) as log:
        for step in range(1, 101):
            log.add("policy 0", step, {"loss": float(step)})
        log.add("policy 0", 103, {"loss": 1.0}, last=True)
    with (tmp_path / logs.LINES).open("a") as file:
        file.write('{"stage": "pol')
    assert logs.read(tmp_path) == {"loss": {"policy 0": {50: 25.5, 100: 75.5, 103: 1.0}}}
    assert logs.draw(tmp_path).stat().st_size > 5_000
    assert len(list((tmp_path / "tensorboard").iterdir())) == 1
    with pytest.raises(InputError, match="holds no"):
        logs.read(tmp_path / "nowhere")


def test_an_unknown_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="generated chairs"):
        next(teach(replace(SMALL, set="folder:here"), tmp_path, 1))
