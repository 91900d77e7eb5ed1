"""Tests of work on a Ray cluster: two nodes on this machine, one of which dies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import furniture_refs
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.evaluation.evaluate import evaluate
from roboassembly.evaluation.rollout import RolloutConfig
from roboassembly.furniture import storage
from roboassembly.parallel.processes import map_ordered, map_unordered, use_cluster, worker_pool

ray_cluster = pytest.importorskip("ray.cluster_utils", reason="make test-all installs Ray")

pytestmark = pytest.mark.slow


@pytest.fixture
def two_nodes(monkeypatch) -> Iterator[Any]:
    """Start a head without CPUs and two nodes with two CPUs each."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    cluster = ray_cluster.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        cluster.add_node(num_cpus=2)
    yield cluster
    cluster.shutdown()


def where(seconds: float) -> str:
    """Return the node that runs this, after some time."""
    import ray

    time.sleep(seconds)
    return ray.get_runtime_context().get_node_id()


def counted(item: int, folder: Path) -> int:
    """Record each start in a file."""
    with (folder / str(item)).open("a") as file:
        file.write("begun\n")
    time.sleep(3.0)
    return item * item


def refusing(item: int) -> int:
    if item == 2:
        raise InputError("two is no good")
    return item


_greeting: list[str] = []


def greet(word: str) -> None:
    _greeting.append(word)


def greeting(_: int) -> list[str]:
    return list(_greeting)


def test_work_goes_to_all_nodes_and_comes_back_in_order(two_nodes):
    with use_cluster(two_nodes.address, 1) as jobs:
        assert jobs == 4
        assert len(set(map_unordered(where, [1.0] * 8, jobs))) == 2
        assert list(map_ordered(refusing, [3, 1, 4, 1, 5], jobs, chunk=1)) == [3, 1, 4, 1, 5]
        with pytest.raises(InputError, match=r"^two is no good$"):
            list(map_unordered(refusing, [1, 2, 3], jobs))
        with worker_pool(jobs, greet, ("hello",)) as pool:
            assert list(pool.map(greeting, range(6))) == [["hello"]] * 6


def test_a_node_that_dies_loses_nothing(two_nodes, tmp_path):
    with use_cluster(two_nodes.address, 1) as jobs:
        results = []
        for result in map_unordered(partial(counted, folder=tmp_path), list(range(12)), jobs):
            results.append(result)
            if len(results) == 2:
                two_nodes.remove_node(next(iter(two_nodes.worker_nodes)), allow_graceful=False)
        assert sorted(results) == [k * k for k in range(12)]
    begun = [len((tmp_path / str(k)).read_text().splitlines()) for k in range(12)]
    assert max(begun) > 1, "nothing ran on the node that died"


def test_evaluation_on_a_cluster_gives_the_same_episodes(two_nodes, tmp_path):
    for family in ("stool", "shell"):
        storage.save(catalogue.make(family, 1, with_grasps=False), tmp_path / family)
    here = furniture_refs(f"folder:{tmp_path}")
    way = RolloutConfig("search")
    alone = [e.planning_steps for e in evaluate(way, here, 0, 1)]
    with use_cluster(two_nodes.address, 1) as jobs:
        assert [e.planning_steps for e in evaluate(way, here, 0, jobs)] == alone


def test_missing_cluster_gives_a_one_line_error():
    with (
        pytest.raises(InputError, match=r"^--ray 127.0.0.1:1: no cluster answers there"),
        use_cluster("127.0.0.1:1", 1),
    ):
        raise AssertionError


def test_error_without_ray_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"roboassembly\[ray\]"), use_cluster("auto", 1):
        raise AssertionError
