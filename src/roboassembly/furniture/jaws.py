"""How the hand opens and closes at one place of a part: between flat sides, or wherever its pads meet the part.

`EvenJaw` closes from the fully open hand until both pads lie on flat sides. `UnevenJaw` opens only as far as robots do
and closes each finger by itself until it touches, so that it also holds by curved sides, leaning sides, sheets and
the sides of grooves. Both promise the same: the hand comes and closes without a collision, and its pads hold the part.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import GraspRegion
from roboassembly.furniture.opposite_sides import ANGLES, FRICTION, LEAST_COSINE, Places, directions_around
from roboassembly.furniture.rays import Rays
from roboassembly.robots.gripper import MAX_OPENING, WIDER, HandAgainst

APPROACHES = 4
"""Approach directions per region, as in the paper."""
CLEARANCE = 2e-4
"""Distance between pad and part in tests of the closed hand, where touching counts as collision [m]."""
_EASED = (0.0, 0.0006, 0.0013, 0.0022, 0.003)
"""Allowances for sides that lean or bend and touch a pad's rim before its middle [m]."""
_OPENINGS = (0.25, 0.5, 0.75)
"""Fractions of the opening at which the moving fingers are tested: fingers are thicker than the steps."""
_FINE_ANGLES = 72
"""Number of directions around the closing axis of an uneven place: at a rim or in a hollow the fan is narrow."""
_MOST_UNEVEN = 0.0035
"""Distance of a pad from the side before its middle, at most, as something else of the pad touches [m]."""
_BISECTIONS = 5
"""Number of bisections of this distance; they leave 0.1 mm."""
_UNLIKE = 0.0015
"""Difference of the closed widths of two directions of one region at most [m]."""
_SIDEWAYS = 0.002
"""Distance that the coming hand is tested wider than robots open it: they stray a little [m]."""
_HALF_PAD = (0.0087, 0.0092)
"""Half the size of a pad, across the approach and along it [m]."""
_PAD_GRID = np.stack(np.meshgrid(*(np.linspace(-h, h, 7) for h in _HALF_PAD)), axis=-1).reshape(-1, 2)
"""Places of a pad under which rays find the part, as `_HALF_PAD` [m]."""
_TOWARD = np.stack([np.cos(np.arange(32) * np.pi / 16.0), np.sin(np.arange(32) * np.pi / 16.0)], axis=-1)
"""Directions in the plane of a pad, all around."""
_TOUCHING = 5e-4
"""Height below the highest point under a pad from which on the part touches it, as pads are of rubber [m]."""
_BY_PAD = 6e-4
"""Distance that a finger may stop before the highest point under its pad: more, and not the pad touches [m]."""


class Jaw(ABC):
    """Way of the hand to open and close at places of a part.

    Args:
        hand: collisions of the hand with the part.
        others: collisions of the hand with surroundings of the part, which decide between directions.
    """

    attempts: ClassVar[float]
    """Number of places at which the hand closes before there is no grasp."""
    angles: ClassVar[int]
    """Number of directions around the closing axis in which the hand may come."""

    def __init__(self, hand: HandAgainst, others: Sequence[HandAgainst]) -> None:
        self.hand, self.others = hand, others

    @abstractmethod
    def openings(self, widths: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the distance between the pads as the hand comes to places of given widths [m]."""

    @abstractmethod
    def closed_on(
        self, place: Places, directions: Float[np.ndarray, "a 3"], free: Bool[np.ndarray, "a"]
    ) -> GraspRegion | None:
        """Return the region at one place if the hand can close there in four `free` directions.

        Directions that most of the surroundings leave free come first.
        """

    def approaches(self, places: Places) -> tuple[Float[np.ndarray, "n a 3"], Bool[np.ndarray, "n a"]]:
        """Return directions in which the hand may come to each place, and whether the part leaves it free."""
        return self._approaches(places, self.angles)

    def _approaches(self, places: Places, angles: int) -> tuple[Float[np.ndarray, "n a 3"], Bool[np.ndarray, "n a"]]:
        directions = directions_around(places.closing, angles)
        return directions, ~touches(self.hand, places, directions, self.openings(places.width), coming=True)


class EvenJaw(Jaw):
    """Fingers that close evenly from the fully open hand."""

    attempts = np.inf
    angles = ANGLES

    def openings(self, widths: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the full opening for each place [m]."""
        return np.full(len(widths), MAX_OPENING)

    def closed_on(
        self, place: Places, directions: Float[np.ndarray, "a 3"], free: Bool[np.ndarray, "a"]
    ) -> GraspRegion | None:
        """Return the region at one place; see `Jaw.closed_on`."""
        for eased in _EASED:
            opening = float(place.width[0]) + eased + 2.0 * CLEARANCE
            closable = _closing_free(self.hand, place, directions, free, opening, MAX_OPENING)
            if closable.sum() >= APPROACHES:
                return _region(place, directions, closable, self.others, opening, MAX_OPENING)
        return None


class UnevenJaw(Jaw):
    """Fingers that each close until they touch, from as far as robots open the hand.

    Args:
        hand: collisions of the hand with the part.
        others: collisions of the hand with surroundings of the part.
        rays: of the part.
    """

    attempts = 150.0
    angles = _FINE_ANGLES

    def __init__(self, hand: HandAgainst, others: Sequence[HandAgainst], rays: Rays) -> None:
        super().__init__(hand, others)
        self._rays = rays

    def openings(self, widths: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the opening for each place, a little wider than robots open the hand there [m]."""
        return np.minimum(MAX_OPENING, widths + WIDER + _SIDEWAYS)

    def within_reach(self, places: Places) -> Bool[np.ndarray, "n"]:
        """Return whether the hand comes to a place from any of few directions: a cheap test before `approaches`."""
        return np.asarray(self._approaches(places, ANGLES)[1].any(axis=1))

    def closed_on(
        self, place: Places, directions: Float[np.ndarray, "a 3"], free: Bool[np.ndarray, "a"]
    ) -> GraspRegion | None:
        """Return the region at one place; see `Jaw.closed_on`."""
        gripped, highest = self._gripped_by_pads(place, directions, free)
        stops = np.full((2, len(directions)), np.inf)
        if gripped.sum() >= APPROACHES:
            stops[:, gripped] = self._stops(place, directions[gripped])
        # If a finger stops before its pad touches, something else of it does.
        gripped &= (stops < highest + _BY_PAD).all(axis=0)
        total = stops.sum(axis=0)
        for index in np.argsort(np.where(gripped, total, np.inf), kind="stable")[: gripped.sum()]:
            limit = stops[:, index]
            alike = gripped & (stops <= limit[:, None] + 1e-9).all(axis=0) & (total[index] - total < _UNLIKE)
            if alike.sum() < APPROACHES:
                continue
            # The hand is where both fingers touch at once.
            moved = place.middle + 0.5 * (limit[0] - limit[1]) * place.closing
            there = Places(moved, place.closing, place.width + limit.sum(), place.cover)
            closed, opened = float(there.width[0]) + 2.0 * CLEARANCE, float(self.openings(there.width)[0])
            # Robots open the hand to `closed + WIDER`; it is tested wider, too: a finger may be beside something thin.
            closable = _still_free(self.hand, there, directions, alike, opened, coming=True)
            closable = _still_free(
                self.hand, there, directions, closable, min(MAX_OPENING, closed + WIDER), coming=True
            )
            closable = _closing_free(self.hand, there, directions, closable, closed, opened)
            if closable.sum() >= APPROACHES:
                return _region(there, directions, closable, self.others, closed, opened)
        return None

    def _gripped_by_pads(
        self, place: Places, directions: Float[np.ndarray, "a 3"], free: Bool[np.ndarray, "a"]
    ) -> tuple[Bool[np.ndarray, "a"], Float[np.ndarray, "2 a"]]:
        """Return for which `free` directions the pads hold the part, and how far the part is highest under each pad.

        The contacts are within the cone of friction, and they oppose each other: some line from one to the other leans
        no more than friction allows.
        """
        tried = np.flatnonzero(free)
        closing, width = place.closing[0], float(place.width[0])
        across = np.cross(closing, directions[tried])
        spots = _PAD_GRID[:, 0, None] * across[:, None] + _PAD_GRID[:, 1, None] * directions[tried][:, None]
        pressed, highest = np.ones(len(tried), bool), np.full((2, len(directions)), -np.inf)
        least = np.zeros((2, len(tried), len(_TOWARD)))
        for finger, side in enumerate((1.0, -1.0)):
            starts = place.middle[0] + spots + side * (0.5 * width + 2.0 * _MOST_UNEVEN) * closing
            inward = np.tile(-side * closing, (starts.shape[0] * starts.shape[1], 1))
            reach, normals = self._rays.first_hits(starts.reshape(-1, 3), inward)
            height = (2.0 * _MOST_UNEVEN - reach).reshape(len(tried), -1)
            highest[finger, tried] = height.max(axis=1)
            touching = height > height.max(axis=1, keepdims=True) - _TOUCHING
            mean = np.einsum("tg,tgk->tk", touching, normals.reshape(*height.shape, 3))
            pressed &= side * (mean @ closing) > LEAST_COSINE * np.linalg.norm(mean, axis=1)
            least[finger] = np.where(touching[:, :, None], side * _PAD_GRID @ _TOWARD.T, np.inf).min(axis=1)
        # The distance between two convex sets is the largest one between parallel lines that part them.
        pressed &= least.sum(axis=0).max(axis=1) <= FRICTION * width
        gripped = np.zeros(len(directions), bool)
        gripped[tried] = pressed & (highest[:, tried] < _MOST_UNEVEN).all(axis=0)
        return gripped, highest

    def _stops(self, place: Places, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 n"]:
        """Return how far from the side each finger stops, the one along the closing axis first; infinity if it stops
        before `_MOST_UNEVEN` [m]."""
        n = len(directions)
        stops = np.full((2, n), np.inf)
        middle, closing = np.repeat(place.middle, n, axis=0), np.repeat(place.closing, n, axis=0)

        def free_at(near: Float[np.ndarray, "n"], finger: int) -> Bool[np.ndarray, "n"]:
            shift = (0.5 - finger) * (near - _MOST_UNEVEN)
            opening = float(place.width[0]) + near + _MOST_UNEVEN + 2.0 * CLEARANCE
            return ~self.hand.touches(middle + shift[:, None] * closing, closing, directions, opening)

        if (reached := free_at(np.full(n, _MOST_UNEVEN), 0)).sum() < APPROACHES:
            return stops
        for finger in (0, 1):
            low, high = np.zeros(n), np.full(n, _MOST_UNEVEN)
            high = np.where(free_at(low, finger), low, high)
            for _ in range(_BISECTIONS):
                mean = 0.5 * (low + high)
                fits = free_at(mean, finger)
                low, high = np.where(fits, low, mean), np.where(fits, mean, high)
            stops[finger, reached] = high[reached]
        return stops


def touches(
    hand: HandAgainst,
    places: Places,
    directions: Float[np.ndarray, "n a 3"],
    openings: float | Float[np.ndarray, "n"],
    *,
    coming: bool = False,
) -> Bool[np.ndarray, "n a"]:
    """Return whether the hand touches something at places, from each of their directions.

    Args:
        hand: collisions of the hand.
        places: where it is.
        directions: of each place.
        openings: distance between the pads, or one for each place [m].
        coming: whether to include the approach.
    """
    n, a = directions.shape[:2]
    middle, closing = np.repeat(places.middle, a, axis=0), np.repeat(places.closing, a, axis=0)
    each = np.repeat(np.broadcast_to(openings, n), a)
    return hand.touches(middle, closing, directions.reshape(-1, 3), each, coming=coming).reshape(n, a)


def _closing_free(
    hand: HandAgainst,
    place: Places,
    directions: Float[np.ndarray, "a 3"],
    free: Bool[np.ndarray, "a"],
    closed: float,
    opened: float,
) -> Bool[np.ndarray, "a"]:
    """Return the `free` directions in which the hand touches nothing closed, nor on the way there from `opened`."""
    closable = _still_free(hand, place, directions, free, closed)
    for share in _OPENINGS:
        if closable.sum() >= APPROACHES:
            closable = _still_free(hand, place, directions, closable, closed + share * (opened - closed))
    return closable


def _region(
    place: Places,
    directions: Float[np.ndarray, "a 3"],
    closable: Bool[np.ndarray, "a"],
    others: Sequence[HandAgainst],
    closed: float,
    opened: float,
) -> GraspRegion:
    """Return the region with four of the directions in which the hand can close."""
    liked = np.zeros(len(directions))
    for other in others:
        liked += _still_free(other, place, directions, closable, opened, coming=True)
    chosen = directions[_four_of(closable, liked)]
    return GraspRegion(place.middle[0], place.closing[0], chosen, closed - 2.0 * CLEARANCE)


def _still_free(
    hand: HandAgainst,
    place: Places,
    directions: Float[np.ndarray, "a 3"],
    free: Bool[np.ndarray, "a"],
    opening: float,
    *,
    coming: bool = False,
) -> Bool[np.ndarray, "a"]:
    """Return which of the `free` directions at one place leave the hand free of this collision, too."""
    out, tried = free.copy(), directions[None, free]
    out[free] = ~touches(hand, place, tried, opening, coming=coming)[0]
    return out


def _four_of(free: Bool[np.ndarray, "a"], liked: Float[np.ndarray, "a"]) -> list[int]:
    """Return four free directions.

    The first is the middle of the widest free fan among the most liked; each next one is the farthest from those
    chosen. A direction that all surroundings leave free gains as much as half a turn of distance.
    """
    n = len(free)
    separations = np.abs((np.arange(n)[:, None] - np.arange(n) + n // 2) % n - n // 2)
    blocked = np.flatnonzero(~free)
    fan = separations[:, blocked].min(axis=1) if len(blocked) else np.full(n, n)
    most = liked[free].max()
    preference = 0.5 * n * liked / most if most > 0 else np.zeros(n)
    chosen = [int(np.argmax(np.where(free, fan + 2.0 * preference, -1)))]
    while len(chosen) < APPROACHES:
        separation = separations[:, chosen].min(axis=1)
        chosen.append(int(np.argmax(np.where(free & (separation > 0), separation + preference, -1))))
    return chosen
