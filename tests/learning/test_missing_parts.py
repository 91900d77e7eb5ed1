"""States of furniture that lacks some parts, against the furniture that is built without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance
from roboassembly.generate import generate
from roboassembly.learning.datasets import LabeledState, SampleSet, Structure, structure_of
from roboassembly.learning.missing_parts import is_connected, reduced, without_some
from roboassembly.learning.relational.oracle_dataset import Labeler

SEED = 20_003
"""A plank chair with two keys that hold its stretcher."""


@pytest.fixture(scope="module")
def samples() -> SampleSet:
    chair = catalogue.make("plank", SEED, with_grasps=False)
    clouds = np.array([surface_points(p.mesh, 16) for p in chair.parts], np.float32)
    labeler = Labeler(chair, clouds)
    return labeler.sample_set(labeler.rollout(np.random.default_rng(0)).states)


def _chain() -> Structure:
    """Seat 0, posts 1 and 2 on it, slats 3 and 4 between the posts; posts are of one class, and so are slats."""
    connections = [(0, 0, 1, 0), (0, 1, 2, 0), (1, 1, 3, 0), (2, 1, 3, 1), (1, 2, 4, 0), (2, 2, 4, 1)]
    labels = ("seat_single_surface", "post", "post", "slat", "slat")
    optional = np.array([False, False, False, True, True])
    return Structure(np.array(connections), np.array([0, 1, 1, 2, 2]), labels, optional)


def test_parts_and_points_are_numbered_anew() -> None:
    structure = _chain()
    seen = set()
    for seed in range(40):
        left = without_some(structure, np.random.default_rng(seed))
        if left is None:
            continue
        seen.add(tuple(left.parts.tolist()))
        if left.parts.tolist() == [0, 1, 2, 4]:
            assert [p.tolist() for p in left.points] == [[0, 1], [0, 2], [0, 2], [0, 1]]
            expected = [[0, 0, 1, 0], [0, 1, 2, 0], [1, 1, 3, 0], [2, 1, 3, 1]]
            assert left.structure.connections.tolist() == expected
            assert left.structure.labels == ("seat_single_surface", "post", "post", "slat")
    # Seat and posts are needed; a slat or both may be missing.
    assert seen == {(0, 1, 2), (0, 1, 2, 3), (0, 1, 2, 4)}


def test_a_point_stays_as_long_as_an_equal_part_needs_its_own() -> None:
    structure = _chain()
    # The second slat hangs on the left post alone: its point stays on the right post, too, as equal parts have it.
    cut = Structure(structure.connections[:5], structure.classes, structure.labels, structure.optional)
    points = {
        tuple(left.parts.tolist()): [p.tolist() for p in left.points]
        for seed in range(40)
        if (left := without_some(cut, np.random.default_rng(seed))) is not None
    }
    assert points[0, 1, 2, 4] == [[0, 1], [0, 2], [0, 2], [0]]
    assert points[0, 1, 2, 3] == [[0, 1], [0, 1], [0, 1], [0, 1]]


def test_what_would_fall_apart_is_not_made() -> None:
    structure = _chain()
    assert is_connected(structure, [0, 1, 2, 3])
    assert not is_connected(structure, [0, 3, 4])
    labels = ("seat_single_surface", "post", "post", "slat", "slat")
    loose = Structure(structure.connections, structure.classes, labels, np.array([False, True, True, False, False]))
    for seed in range(30):
        left = without_some(loose, np.random.default_rng(seed))
        # Both posts carry the slats: one of them may be missing.
        assert left is None or len(left.parts) == 4
    nothing = Structure(structure.connections, structure.classes, labels, np.zeros(5, bool))
    assert without_some(nothing, np.random.default_rng(0)) is None


def _without_keys(chair: Furniture) -> Furniture:
    parts = [p for p in generate("plank", SEED) if not p.name.startswith("key")]
    assert len(parts) == len(chair.parts) - 2
    return annotate("plank", parts, Provenance("generated"), with_grasps=False)


def test_a_chair_without_its_keys_is_the_chair_that_is_built_without_them(samples: SampleSet) -> None:
    chair = catalogue.make("plank", SEED, with_grasps=False)
    assert samples.structure is not None
    built = structure_of(_without_keys(chair))
    keyless = None
    for seed in range(200):
        left = without_some(samples.structure, np.random.default_rng(seed))
        if left is not None and [chair.parts[p].name for p in left.parts if "key" in chair.parts[p].name] == []:
            keyless = left if len(left.parts) == len(chair.parts) - 2 else keyless
    assert keyless is not None
    assert keyless.structure.labels == built.labels
    ends = [{frozenset([(a, k), (b, l)]) for a, k, b, l in s.connections.tolist()} for s in (keyless.structure, built)]  # noqa: E741
    assert ends[0] == ends[1]
    start = samples.samples[0]
    smaller = reduced(start, keyless, samples.structure)
    assert smaller is not None
    # Where the points are, and which pairs fit, is as in the chair built without keys.
    observed = _start_of(_without_keys(chair))
    assert np.array_equal(smaller.free, observed.free)
    assert np.allclose(smaller.points[smaller.free][:, :6], observed.points[observed.free][:, :6], atol=2e-3)
    pairs = [{tuple(m[:4]) for m in s.mates.tolist()} for s in (smaller, observed)]
    assert pairs[0] == pairs[1]


def _start_of(furniture: Furniture) -> LabeledState:
    labeler = Labeler(furniture, np.zeros((len(furniture.parts), 1, 3), np.float32))
    return labeler.rollout(np.random.default_rng(0)).states[0]


def test_values_of_experts_keep_their_points(samples: SampleSet) -> None:
    assert samples.structure is not None
    sample = samples.samples[2]
    part, point = np.nonzero(sample.free)
    names = 100.0 * part + point  # a name for each point
    q = np.broadcast_to((names[:, None] * 0 + names[None])[..., None], (len(part), len(part), 6)).astype(np.float16)
    for seed in range(30):
        left = without_some(samples.structure, np.random.default_rng(seed))
        smaller = None if left is None else reduced(replace(sample, q_values=q), left, samples.structure)
        if left is None or smaller is None:
            continue
        assert smaller.q_values is not None
        rows, columns = np.nonzero(smaller.free)
        expected = [100.0 * left.parts[r] + left.points[r][c] for r, c in zip(rows, columns, strict=True)]
        assert smaller.q_values[0, :, 0].tolist() == expected
        assert len(smaller.q_values) == smaller.free.sum()
