"""The training pipeline: samples, rounds, continuing, and the files that it leaves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from relational_cases import TINY

from roboassembly.datasets import catalogue
from roboassembly.datasets import sets as datasets
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import SampleSet, dataset_file
from roboassembly.learning.layers import Params
from roboassembly.learning.progress import Progress
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.pipeline import RelationalPipelineConfig, run_pipeline
from roboassembly.learning.relational.policy import RelationalPolicy

SMALL = RelationalPipelineConfig(
    set="chairs-24:train", extra=1, validation=1, episodes=1, rounds=1, steps=12, round_steps=6, batch=2, seed=3,
    network=TINY,
)  # fmt: skip


@pytest.fixture
def two_chairs(as_built, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A data set of two chairs of four parts; extra ones are of the same family."""
    monkeypatch.setattr("roboassembly.learning.generated.CHAIRS", ["cantilever"])
    return as_built(easy=[("cantilever", 1), ("cantilever", 5)])


def _flat(params: Params, above: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in params.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}/")
        else:
            yield above + name, value


@pytest.mark.slow
def test_the_full_pipeline_ends_in_one_policy_for_both_settings(
    two_chairs: list[str], tmp_path: Path
) -> None:  # fmt: skip
    with pytest.raises(InputError, match="--start relational"):
        next(run_pipeline(replace(SMALL, setting="full"), tmp_path / "none", 1))
    with pytest.raises(InputError, match="its network"):
        next(run_pipeline(replace(SMALL, setting="full", start="relational"), tmp_path / "none", 1))
    start = tmp_path / "start.npz"
    weights = relational.init(np.random.default_rng(0), TINY)
    config = {"network": asdict(TINY)}
    checkpoint.save(start, checkpoint.Checkpoint(relational.KIND, weights, config, {}), half=True)
    config = replace(SMALL, setting="full", start=str(start), rounds=1, limit=1, extra=0, validation=0, steps=5)
    folder = tmp_path / "run"
    stages = [p.stage for p in run_pipeline(config, folder, 1) if p.done == p.total]
    assert stages == ["grasp samples", "grasps", "on policy 1", "grasps"]
    assert all(dataset_file(folder / "grasps" / str(i), name).is_file() for i in (0, 1) for name in two_chairs[:1])
    policy = load_policy(str(folder / "policy.npz"))
    assert isinstance(policy, RelationalPolicy)
    assert policy.settings == ("object-centric", "full")
    started, made = (checkpoint.load(path, relational.KIND) for path in (start, folder / "policy.npz"))
    assert made.config["grasps"]["pipeline"]["setting"] == "full"
    assert set(made.config["grasps"]["made"]) == {"hours", "machine"}
    assert {name: made.config[name] for name in started.config} == started.config
    # The weights that value pairs are kept, and the trained grasp network is added.
    flat = dict(_flat(policy.params))
    assert all(np.array_equal(v, flat[k]) for k, v in _flat(started.params))
    trained = dict(_flat(checkpoint.load(folder / "grasps-1.npz").params))
    assert policy.grasp_params is not None
    for name, value in _flat(policy.grasp_params):
        np.testing.assert_allclose(value, trained[name], atol=2e-3)
    assert {p.stage for p in run_pipeline(config, folder, 1)} == set()


def test_a_pipeline_continues_where_it_was_stopped(two_chairs: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    stages: list[Progress] = []
    run = run_pipeline(SMALL, folder, 1)
    for progress in run:
        stages.append(progress)
        if progress.stage == "policy 0" and progress.done == 5:
            break
    run.close()
    before = dataset_file(folder / "samples" / "0", two_chairs[0]).stat().st_mtime_ns
    stages += list(run_pipeline(SMALL, folder, 1))
    assert dataset_file(folder / "samples" / "0", two_chairs[0]).stat().st_mtime_ns == before
    assert [s.stage for s in stages if s.done == s.total] == [
        "validation", "samples 0", "policy 0", "samples 1", "policy 1",
    ]  # fmt: skip
    assert 0.0 <= stages[-1].scalars["validation_own"] <= 1.0
    final = checkpoint.load(folder / "policy.npz", relational.KIND)
    assert final.config["set_hash"] == datasets.set_hash(datasets.furniture_refs("chairs-24:train"))
    assert final.config["pipeline"]["rounds"] == 1
    assert not final.extra
    # Nothing is left to do; other settings do not continue with these weights.
    assert list(run_pipeline(SMALL, folder, 1)) == []
    with pytest.raises(InputError, match="pipeline"):
        list(run_pipeline(replace(SMALL, round_steps=8), folder, 1))


def test_imported_pieces_are_trained_on_in_other_sizes_as_well(two_chairs: list[str], tmp_path: Path) -> None:
    real = catalogue.make("cantilever", 7, with_grasps=False)
    storage.save(real, tmp_path / "halves" / "real")
    config = replace(SMALL, limit=1, extra=0, rounds=0, steps=2, validation=0, imported_versions=2)
    config = replace(config, imported=str(tmp_path / "halves"), imported_episodes=1, version_episodes=1)
    folder = tmp_path / "run"
    stages = [p.stage for p in run_pipeline(config, folder, 1) if p.done == p.total]
    assert stages == ["versions", "samples 0", "imported samples 0", "samples of versions 0", "policy 0"]
    versions = {path.name: storage.load(path) for path in sorted((folder / "versions").iterdir())}
    assert list(versions) == ["real-v1", "real-v2"]
    sizes = [piece.parts[0].mesh.volume / real.parts[0].mesh.volume for piece in versions.values()]
    assert len({*np.round(sizes, 3), 1.0}) == 3
    for name in ("real", *versions):
        assert SampleSet.load(dataset_file(folder / "samples" / "0", name)).samples
    # A run that goes on makes neither again.
    assert list(run_pipeline(config, folder, 1)) == []


def test_a_run_that_continues_ends_in_a_mean_with_its_start(two_chairs: list[str], tmp_path: Path) -> None:
    start, folder = tmp_path / "start.npz", tmp_path / "run"
    weights = relational.init(np.random.default_rng(0), TINY)
    description = {"network": asdict(TINY), "made": "earlier"}
    checkpoint.save(start, checkpoint.Checkpoint(relational.KIND, weights, description, {}), half=True)
    config = replace(SMALL, limit=1, extra=0, rounds=0, steps=12, validation=0, start=str(start), start_share=0.25)
    # Nothing is imported, so there are no versions either.
    config = replace(config, imported_versions=5)
    assert [p.stage for p in run_pipeline(config, folder, 1) if p.done == p.total] == ["samples 0", "policy 0"]
    made = checkpoint.load(folder / "policy.npz", relational.KIND)
    assert made.config["start"]["made"] == "earlier"
    trained, first = (
        dict(_flat(checkpoint.load(path, relational.KIND).params)) for path in (folder / "policy-0.npz", start)
    )
    assert any(np.abs(trained[name] - first[name]).max() > 5e-3 for name in first)
    for name, value in _flat(made.params):
        np.testing.assert_allclose(value, 0.75 * trained[name] + 0.25 * first[name], atol=2e-3)


def test_the_command_takes_the_defaults_of_a_run_that_continues() -> None:
    """The help of `train multitask` names these numbers."""
    fresh, later, robots = (
        RelationalPipelineConfig.default(setting, continues=continues)
        for setting, continues in (("object-centric", False), ("object-centric", True), ("full", True))
    )
    assert (fresh.extra, fresh.steps, fresh.imported_versions) == (5_000, 16_000, 0)
    assert (later.extra, later.steps, later.imported_versions) == (700, 6_000, 5)
    assert (robots.extra, robots.steps, robots.imported_versions) == (110, 12_000, 0)


def test_an_unknown_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="labels generated furniture"):
        next(run_pipeline(replace(SMALL, set="folder:here"), tmp_path, 1))
