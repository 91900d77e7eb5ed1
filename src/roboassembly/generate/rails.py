"""Straight bars between two faces, a tongue at either end: aprons, stretchers, cross rails."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.solids import Solid, circle, rectangle, sweep, unit
from roboassembly.geometry.poses import SE3


def mouths(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> tuple[SE3, SE3]:
    """Joint frames on the two faces that a bar from `start` to `end` runs between; tenon width along `up`."""
    run = unit(end - start)
    return joint_frame(start, run, up), joint_frame(end, -run, up)


def rail(
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
    height: float,
    thickness: float,
    tenon: Tenon,
    chamfer: float = 0.003,
) -> Solid:
    """A bar between two faces that stand square to it, `height` along `up`, shouldered, with a tenon at either end."""
    run = unit(end - start)
    ends = [start + CLEARANCE * run, end - CLEARANCE * run]
    body = sweep(ends, np.cross(up, run), up, rectangle(thickness, height, chamfer))
    for frame in mouths(start, end, up):
        body += tenon.tongue(frame)
    return body


def spindle(
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
    belly: float,
    tenon: RoundTenon,
    free: float = 0.012,
) -> Solid:
    """A turned bar without shoulders: it goes into its holes at the tenon's radius and swells to `belly` between them.

    `free` metres before each mouth it still has the tenon's radius: for holes in round or slanted faces.
    """
    run = unit(end - start)
    length = float(np.linalg.norm(end - start))
    r = tenon.radius
    stations = [(-tenon.length, r), (free, r), (0.3 * length, belly), (0.7 * length, belly)]
    stations += [(length - free, r), (length + tenon.length, r)]
    path = np.array([start + d * run for d, _ in stations])
    return sweep(path, up, np.cross(run, up), [circle(radius, tenon.sides) for _, radius in stations])
