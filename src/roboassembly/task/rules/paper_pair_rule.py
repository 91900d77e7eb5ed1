"""The paper's own test of a pair, to the letter; the environments use `pairs.PairRule` instead.

The paper (section "Step Function and Rewards") tests a pair `(u, v, k, l)` by part and connection numbers alone:

1. `Set(P_u)` is the set of parts that are geometrically equivalent to `u`.
2. `u'` is the part that is connected to `v` through connection `l` of `v` in the assembled chair.
3. `v'` is the part that is connected to `u'` through connection `k` of `u'`.
4. The pair is right if `u'` is in `Set(P_u)` and `v'` is `v`.

The test sees two parts and not their groups, so it accepts pairs whose groups do not fit each other. It lets equivalent
parts stand for `u` but not for `v`, so it rejects a top whose corner is brought onto another leg than its own, and
accepts that leg brought onto the corner. `PairRule` tests whether the merged group is congruent to a sub-assembly.
"""

from __future__ import annotations

from roboassembly.furniture.model import Furniture
from roboassembly.task.rules.groups import TaskState


def paper_pair_rule(furniture: Furniture, u: int, v: int, k: int, l: int) -> bool:  # noqa: E741
    """Whether point `k` of part `u` may meet point `l` of part `v` by the paper's test.

    Args:
        furniture: furniture whose parts they are.
        u: part.
        v: part.
        k: point of `u`.
        l: point of `v`.
    """
    met = furniture.mate_of.get((v, l))
    if met is None:
        return False
    u_prime = met[0]
    back = furniture.mate_of.get((u_prime, k))
    equivalent = furniture.classes[furniture.class_of[u]].members
    return u_prime in equivalent and back is not None and back[0] == v


def paper_accepts(furniture: Furniture, state: TaskState, u: int, v: int, k: int, l: int) -> bool:  # noqa: E741
    """Whether the paper's test accepts a pair of a state.

    A joined part counts as the part whose slot it takes: its points have the numbers of that part's points.

    Args:
        furniture: furniture of the state.
        state: state in which both points are free.
        u: part.
        v: part.
        k: point of `u`.
        l: point of `v`.
    """
    u_slot, v_slot = (state.groups[state.group_of[part]].slot_of_points(part) for part in (u, v))
    return paper_pair_rule(furniture, u_slot, v_slot, k, l)
