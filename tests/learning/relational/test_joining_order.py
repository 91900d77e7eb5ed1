"""Which merges lock a group out, by hand and against a search through all ways to take a layout apart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from roboassembly.learning.relational.joining_order import JoiningOrder

BACK, SEAT, FRONT = 0, 1, 2


def _order(blocked: dict[tuple[int, int], set[int]], near: list[set[int]], directions: int) -> JoiningOrder:
    """Return the order in which `blocked[d, g]` are in the way of group g along direction d."""
    arcs = [[sum(1 << other for other in blocked.get((d, g), ())) for g in range(len(near))] for d in range(directions)]
    return JoiningOrder(arcs, [sum(1 << g for g in others) for others in near])


@pytest.fixture
def chair() -> JoiningOrder:
    """A seat between a back and a front: along direction 0 the back is in its way, along 1 the front.

    Once front and back are one, the seat can neither get in between them nor out.
    """
    blocked = {(0, SEAT): {BACK}, (1, SEAT): {FRONT}, (0, FRONT): {SEAT}, (1, BACK): {SEAT}}
    return _order(blocked, [{SEAT, FRONT}, {BACK, FRONT}, {BACK, SEAT}], directions=2)


def test_a_merge_that_locks_a_group_out_is_not_allowed(chair: JoiningOrder) -> None:
    assert chair.allows(BACK, SEAT)
    assert chair.allows(SEAT, FRONT)
    assert not chair.allows(BACK, FRONT)


def test_groups_that_lock_each_other_cannot_be_joined() -> None:
    order = _order({(0, 0): {1}, (0, 1): {0}}, [{1}, {0}], directions=1)
    assert not order.separable(0, 1)
    assert not order.allows(0, 1)


def _solvable(order: JoiningOrder, units: frozenset[int]) -> bool:
    """Whether any sequence of halves takes the units apart; each half is tried."""
    if len(units) == 1:
        return True
    for size in range(1, len(units)):
        for half in map(frozenset, itertools.combinations(sorted(units), size)):
            rest = sum(units - half)
            leaves = any(
                all(not arcs[g] & rest for g in range(len(order.near)) if sum(half) >> g & 1) for arcs in order.arcs
            )
            if leaves and _solvable(order, half) and _solvable(order, units - half):
                return True
    return False


def test_the_first_halves_decide_as_all_do() -> None:
    rng, answers = np.random.default_rng(0), set[bool]()
    for _ in range(200):
        groups = int(rng.integers(3, 6))
        blocked = {
            (d, g): {h for h in range(groups) if h != g and rng.random() < 0.45}
            for d in range(2)
            for g in range(groups)
        }
        # What blocks along a direction is blocked against it.
        blocked |= {
            (d + 2, g): {h for h in range(groups) if g in blocked[d, h]} for d in range(2) for g in range(groups)
        }
        order = _order(blocked, [set(range(groups)) - {g} for g in range(groups)], directions=4)
        units = frozenset(1 << g for g in range(groups))
        expected = _solvable(order, units)
        assert order.solvable(units) == expected
        answers.add(expected)
    assert answers == {True, False}


def test_the_exit_with_the_fewest_blocked_pixels_opens_what_is_locked() -> None:
    # Two groups that block each other along both directions.
    locked = JoiningOrder([[0b10, 0b01], [0b10, 0b01]], [0b10, 0b01])
    assert not locked.whole_is_solvable()
    opened = locked.with_likely_exits({(0, 0, 1): 0.6, (1, 1, 0): 0.3, (1, 0, 1): 0.7})
    assert opened.arcs == [[0b10, 0b01], [0b10, 0b00]]
    assert opened.whole_is_solvable()
    assert locked.arcs == [[0b10, 0b01], [0b10, 0b01]]


def test_where_no_exit_is_likely_the_likeliest_that_are_needed_open() -> None:
    """Three groups in a row, all locked: an exit at either joint is needed, and no more than these open."""
    locked = JoiningOrder([[0b010, 0b101, 0b010]], [0b010, 0b101, 0b010])
    shares = {(0, 0, 1): 0.85, (0, 1, 0): 0.9, (0, 1, 2): 1.0, (0, 2, 1): 0.95}
    opened = locked.with_likely_exits(shares)
    assert opened.whole_is_solvable()
    assert opened.arcs == [[0b000, 0b100, 0b000]]
    assert locked.arcs == [[0b010, 0b101, 0b010]]
