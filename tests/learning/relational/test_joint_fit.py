"""Fit of joints, on a tenon and a pocket whose sizes are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from roboassembly.learning.relational.joint_fit import CLEARANCES, PartJoints, decoded, exchanged, joint_fit

LENGTH, WIDTH, DEPTH = 0.030, 0.012, 0.020
"""Sides of the tenon and its length beyond the plane [m]."""
GAP, TIP_GAP = 0.0004, 0.002
"""Clearance of the tenon's sides and of its tip [m]."""
LEAST, LONG, SHORT, TIP, INSIDE = 1, slice(2, 4), slice(4, 6), 6, 7
"""Places of a tenon's features."""


def faces(low: Sequence[float], high: Sequence[float], axes: str = "xyz", count: int = 400) -> Float[np.ndarray, "n 3"]:
    """Points on the faces of a box that are across the given axes."""
    rng = np.random.default_rng(0)
    out: list[Float[np.ndarray, "m 3"]] = []
    for axis in ("xyz".index(a) for a in axes):
        for end in (low[axis], high[axis]):
            points = rng.uniform(low, high, (count, 3))
            points[:, axis] = end
            out.append(points)
    return np.concatenate(out)


def tenon(length: float = LENGTH, width: float = WIDTH) -> Float[np.ndarray, "n 3"]:
    """A tenon along z, its plane half way in."""
    return faces((-length / 2, -width / 2, -DEPTH), (length / 2, width / 2, DEPTH))


def pocket() -> Float[np.ndarray, "n 3"]:
    """A block with a pocket, in the tenon's frame."""
    half = np.array([LENGTH, WIDTH]) / 2 + GAP
    walls = faces((*-half, -DEPTH), (*half, DEPTH + TIP_GAP), "xy")
    floor = faces((*-half, DEPTH + TIP_GAP), (*half, DEPTH + TIP_GAP), "z")
    return np.concatenate([walls, floor, faces((-0.04, -0.04, -DEPTH), (0.04, 0.04, 0.045), "xy")])


def joints(cloud: Float[np.ndarray, "n 3"], *, waits: bool, angle: float = 0.0) -> PartJoints:
    """Joints of a part with one connection point, whose joint is turned about its normal.

    Args:
        cloud: the surface in the frame of the tenon's point [m].
        waits: whether the part is the one with the pocket; its normal is opposite.
        angle: angle of the joint in the frames of the points [rad].
    """
    c, s = np.cos(angle), np.sin(angle)
    frame = np.diag([1.0, -1.0, -1.0]) if waits else np.eye(3)
    turned = cloud @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    return PartJoints.of_part(turned, np.zeros((1, 3)), frame[None])


def fit_of(moving: PartJoints, waiting: PartJoints) -> Float[np.ndarray, "f"]:
    """Numbers of the one pair of points."""
    return decoded(joint_fit(moving, waiting)[0, 0].astype(float))


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4, -0.3])
def test_clearances_are_those_of_the_joint(angle: float) -> None:
    fit = fit_of(joints(tenon(), waits=False, angle=angle), joints(pocket(), waits=True, angle=angle))
    assert fit[0] == pytest.approx(1.0, abs=0.03)
    assert fit[LONG] == pytest.approx(1e3 * GAP, abs=0.02)
    assert fit[SHORT] == pytest.approx(1e3 * GAP, abs=0.02)
    assert fit[LEAST] == pytest.approx(1e3 * GAP, abs=0.02)
    assert fit[TIP] == pytest.approx(1e3 * TIP_GAP, abs=0.1)
    assert fit[INSIDE] == 0.0


def test_a_pocket_of_another_size_shows() -> None:
    fit = fit_of(joints(tenon(LENGTH + 0.0014), waits=False), joints(pocket(), waits=True))
    assert fit[LONG] == pytest.approx(1e3 * (GAP - 0.0007), abs=0.02)
    assert fit[LEAST] == pytest.approx(1e3 * (GAP - 0.0007), abs=0.02)


def test_a_face_without_a_pocket_is_inside_the_tenon() -> None:
    board = faces((-0.04, -0.04, 0.0), (0.04, 0.04, 0.03), count=4_000)
    fit = fit_of(joints(tenon(), waits=False), joints(board, waits=True))
    assert fit[TIP] == pytest.approx(-10.0, abs=0.01)
    assert fit[INSIDE] > 1.0


def test_exchanged_codes_are_those_of_the_other_part_moving() -> None:
    a, b = joints(tenon(), waits=False), joints(pocket(), waits=True)
    assert (exchanged(joint_fit(a, b)) == joint_fit(b, a)).all()
    assert (exchanged(exchanged(joint_fit(a, b))) == joint_fit(a, b)).all()


def test_mirrored_parts_fit_as_well() -> None:
    mirror = np.array([1.0, -1.0, 1.0])
    codes = [
        joint_fit(
            joints(tenon() * m, waits=False, angle=m[1] * 0.2), joints(pocket() * m, waits=True, angle=m[1] * 0.2)
        )
        for m in (np.ones(3), mirror)
    ]
    assert (np.abs(codes[0].astype(int) - codes[1])[..., slice(*CLEARANCES[0].indices(23))] <= 1).all()


def test_a_part_without_points_near_its_joint_has_no_tenon() -> None:
    far = joints(np.full((10, 3), 0.2), waits=False)
    fit = fit_of(far, joints(pocket(), waits=True))
    assert fit[0] == 0.0
    assert np.isfinite(fit).all()


def test_codes_are_exact_where_it_matters() -> None:
    a, b = joints(tenon(), waits=False), joints(pocket(), waits=True)
    for gap in (0.0001, 0.0004, 0.001):
        wider = replace(a, offset=a.offset + GAP - gap)
        assert fit_of(wider, b)[LEAST] == pytest.approx(1e3 * gap, rel=0.06)
