"""Which pairs are right: by brute force on furniture whose answers are plain."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest

import shapes
from roboassembly.furniture.model import Furniture
from roboassembly.generate import CHAIRS, FAMILIES, OTHERS
from roboassembly.geometry.meshes import distance_to
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.options import ends
from roboassembly.task.rules.groups import Group, TaskState, body, center_of_mass, hull_points
from roboassembly.task.rules.pairs import Merge, PairRule, mate
from shapes import pose


def alone(furniture: Furniture, part: int, where: SE3 | None = None) -> Group:
    slot = furniture.assembled[part]
    return Group((part,), (part,), (slot,), (where or SE3.Identity()) * slot.inverse())


def judge(furniture: Furniture, u: int, k: int, v: int, l: int) -> Merge | None:  # noqa: E741
    return PairRule(furniture).judge(alone(furniture, u), alone(furniture, v), u, k, v, l)


def congruent(furniture: Furniture, group: Group) -> bool:
    """Parts on distinct slots of like parts, each mesh lying on the surface where the slot's own part would."""
    for part, slot, where in zip(group.parts, group.slots, group.furniture_from_part, strict=True):
        if furniture.class_of[part] != furniture.class_of[slot]:
            return False
        own = furniture.assembled[slot].actInv(where)
        if any(
            distance_to(furniture.parts[slot].mesh.bvh, own.act(v)) > 2e-4 for v in furniture.parts[part].mesh.vertices
        ):
            return False
    return len(set(group.slots)) == len(group.slots)


def test_mate_by_hand(table: Furniture) -> None:
    """The leg's top meets the table's corner: 0.2 + gap below the top's underside, which is 0.015 below its middle."""
    top, leg = table.parts[0].points[2], table.parts[3].points[0]
    top_from_leg = mate(top, leg)
    x, y = shapes.LEGS[2]
    assert np.allclose(top_from_leg.translation, [x, y, -0.215 - shapes.GAP], atol=1e-6)
    back = mate(leg, top)
    assert np.allclose((back * top_from_leg).homogeneous, np.eye(4), atol=1e-9)


def test_any_leg_to_any_corner_both_ways(table: Furniture) -> None:
    for leg, corner in product(range(1, 5), range(4)):
        for merge in (judge(table, leg, 0, 0, corner), judge(table, 0, corner, leg, 0)):
            assert merge is not None
            assert merge.merged.parts == (0, leg)
            assert congruent(table, merge.merged)
            # The leg has to be in the corner's slot, or, with the top turned over by a symmetry, in that one's image.
            slot = merge.merged.slots[1]
            assert slot in range(1, 5)
            expected = table.assembled[0].actInv(table.assembled[corner + 1]).translation
            placed = merge.merged.furniture_from_part[0].actInv(merge.merged.furniture_from_part[1]).translation
            assert np.allclose(placed, expected, atol=1e-6)


def test_the_merge_says_where_both_groups_go(table: Furniture) -> None:
    u, v = alone(table, 2, pose(1, 2, 3)), alone(table, 0, pose(0, 0, 1, shapes.turn((1, 0, 0), 1.0)))
    merge = PairRule(table).judge(u, v, 2, 0, 0, 3)
    assert merge is not None
    assert np.allclose(merge.merged.world_from_furniture.homogeneous, np.eye(4))
    for group, motion in ((u, merge.furniture_from_u), (v, merge.furniture_from_v)):
        for part, own in zip(group.parts, group.furniture_from_part, strict=True):
            index = merge.merged.parts.index(part)
            assert np.allclose(
                (motion * own).homogeneous, merge.merged.furniture_from_part[index].homogeneous, atol=1e-6
            )


def test_two_legs_do_not_go_together(table: Furniture) -> None:
    for u, v in permutations(range(1, 5), 2):
        assert judge(table, u, 0, v, 0) is None


def test_the_wrong_end_is_wrong(stand: Furniture) -> None:
    """Tapered legs: each end has its own plate."""
    right = {(c.part_a, c.point_a, c.part_b, c.point_b) for c in stand.connections}
    for leg, k, plate, l in product((2, 3), range(2), (0, 1), range(2)):  # noqa: E741
        ends = {c[1]: c[3] for c in right if c[0] == plate and c[2] == leg}
        fits = k in ends.values() or any(
            np.allclose(stand.parts[leg].points[k].position, stand.parts[leg].points[e].position, atol=1e-3)
            for e in ends.values()
        )
        assert (judge(stand, leg, k, plate, l) is not None) == fits
        assert (judge(stand, plate, l, leg, k) is not None) == fits
    assert judge(stand, 0, 0, 1, 0) is None
    assert judge(stand, 2, 0, 3, 0) is None
    assert judge(stand, 2, 0, 3, 1) is None


def test_mirror_image_armrests_do_not_swap(armchair: Furniture) -> None:
    ends = {c.part_b: (c.point_a, c.point_b) for c in armchair.connections}
    assert set(ends) == {1, 2}
    for arm, place in product((1, 2), (1, 2)):
        merge = judge(armchair, arm, ends[arm][1], 0, ends[place][0])
        assert (merge is not None) == (arm == place), (arm, place)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_connection_of_a_chair_is_right_both_ways(chair, family: str) -> None:
    furniture = chair(family, 0)
    rule = PairRule(furniture)
    for c in furniture.connections:
        a, b = alone(furniture, c.part_a), alone(furniture, c.part_b)
        for merge in (
            rule.judge(a, b, c.part_a, c.point_a, c.part_b, c.point_b),
            rule.judge(b, a, c.part_b, c.point_b, c.part_a, c.point_a),
        ):
            assert merge is not None
            # What turns least is to leave everything where it belongs.
            assert merge.merged.slots == merge.merged.parts
            for part, where in zip(merge.merged.parts, merge.merged.furniture_from_part, strict=True):
                assert np.allclose(where.homogeneous, furniture.assembled[part].homogeneous, atol=1e-6)


@pytest.mark.parametrize("family", FAMILIES)
def test_like_parts_fit_each_others_places(chair, family: str) -> None:
    """For each connection, every part of one end's class goes onto the other end, by one of its points."""
    furniture = chair(family, 0)
    rule = PairRule(furniture)
    for c in furniture.connections:
        for here, k, there in ((c.part_a, c.point_a, c.part_b), (c.part_b, c.point_b, c.part_a)):
            for member in furniture.classes[furniture.class_of[there]].members:
                if member == here:
                    continue
                one, other = alone(furniture, member), alone(furniture, here)
                assert any(
                    rule.judge(one, other, member, m, here, k) is not None
                    for m in range(len(furniture.parts[member].points))
                ), (furniture.parts[here].name, furniture.parts[member].name)


def test_accepted_pairs_are_congruent_and_refused_ones_are_not_by_brute_force(chair) -> None:
    furniture = chair("stool", 0)
    rule = PairRule(furniture)
    accepted = refused = 0
    pairs = list(permutations(range(len(furniture.parts)), 2))
    for u, v in pairs:
        group_u, group_v = alone(furniture, u), alone(furniture, v)
        for k, l in product(range(len(furniture.parts[u].points)), range(len(furniture.parts[v].points))):  # noqa: E741
            merge = rule.judge(group_u, group_v, u, k, v, l)
            relative = mate(furniture.parts[v].points[l], furniture.parts[u].points[k])
            expected = any(
                furniture.class_of[a] == furniture.class_of[v]
                and furniture.class_of[b] == furniture.class_of[u]
                and near(furniture, a, v, b, u, relative)
                for a, b in pairs
            )
            assert (merge is not None) == expected
            accepted += expected
            refused += not expected
            if merge is not None:
                assert congruent(furniture, merge.merged)
    assert accepted > 50
    assert refused > 100


def near(furniture: Furniture, slot_v: int, v: int, slot_u: int, u: int, v_from_u: SE3) -> bool:
    """Whether v in one slot and u in another, each turned by some symmetry, have this relative pose."""
    del v, u
    turns_v = furniture.classes[furniture.class_of[slot_v]].symmetries
    turns_u = furniture.classes[furniture.class_of[slot_u]].symmetries
    relative = furniture.assembled[slot_v].actInv(furniture.assembled[slot_u])
    rotations = np.einsum("aji,jk,bkl->abil", turns_v, relative.rotation, turns_u)
    shifts = np.einsum("aji,j->ai", turns_v, relative.translation)
    turned = np.trace(np.einsum("abij,kj->abik", rotations, v_from_u.rotation), axis1=2, axis2=3)
    alike = turned > 1 + 2 * np.cos(0.01)
    placed = np.linalg.norm(shifts - v_from_u.translation, axis=1) < 1e-3
    return bool((alike & placed[:, None]).any())


def grown(furniture: Furniture, start: int, moves: list[tuple[int, int, int]]) -> Group:
    """`start` with parts added: `(u, k, l)` puts point k of u onto point l of `start`."""
    rule, group = PairRule(furniture), alone(furniture, start)
    for u, k, l in moves:  # noqa: E741
        merge = rule.judge(alone(furniture, u), group, u, k, start, l)
        assert merge is not None, (u, k, l)
        group = merge.merged
    return group


@pytest.mark.parametrize("order", list(permutations(range(4)))[::3])
def test_a_table_completes_with_its_legs_in_any_places(table: Furniture, order: tuple[int, ...]) -> None:
    group = grown(table, 0, [(leg + 1, 0, corner) for corner, leg in enumerate(order)])
    assert group.parts == (0, 1, 2, 3, 4)
    assert congruent(table, group)
    state = TaskState((group,))
    assert state.complete
    # Every corner and every leg's top is taken.
    assert state.occupied(table) == {(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (4, 0)}


def test_occupied_points_are_those_that_touch(table: Furniture) -> None:
    group = grown(table, 0, [(1, 0, 2)])
    others = tuple(alone(table, p) for p in (2, 3, 4))
    state = TaskState((group, *others))
    assert state.occupied(table) == {(0, 2), (1, 0)}
    assert not state.complete
    assert state.group_of == {0: 0, 1: 0, 2: 1, 3: 2, 4: 3}
    assert state.others(1, 3) == (others[0], others[2])
    assert state.others(0, 1) == others
    larger = grown(table, 0, [(1, 0, 2), (3, 0, 1)])
    assert state.after_merge(larger).groups == (others[0], others[2], larger)
    # The corner that is taken takes no second leg.
    assert PairRule(table).judge(others[0], group, 2, 0, 0, 2) is None
    for corner in (0, 1, 3):
        assert PairRule(table).judge(others[0], group, 2, 0, 0, corner) is not None


def test_one_merge_can_make_several_contacts(stand: Furniture) -> None:
    """Two legs on the lower plate; then the upper plate touches both of them at once."""
    ends = {(c.part_a, c.part_b): (c.point_a, c.point_b) for c in stand.connections}
    group = grown(stand, 1, [(2, ends[1, 2][1], ends[1, 2][0]), (3, ends[1, 3][1], ends[1, 3][0])])
    merge = PairRule(stand).judge(alone(stand, 0), group, 0, ends[0, 2][0], 2, ends[0, 2][1])
    assert merge is not None
    assert len(TaskState((merge.merged,)).occupied(stand)) == 8


@pytest.mark.parametrize("family", [*CHAIRS, *OTHERS])
def test_open_joints_are_right_pairs_after_swaps(chair, family: str) -> None:
    """Random right merges, parts turned about and in each other's slots; whatever the furniture still has to join can
    be joined by the points that `ends` names. A stretcher that was put in end for end is no worse than another."""
    furniture = chair(family, 0)
    rule, rng = PairRule(furniture), np.random.default_rng(8)
    swapped, elsewhere = 0, []
    for _ in range(3):
        state = TaskState(tuple(alone(furniture, p, pose(float(p))) for p in range(len(furniture.parts))))
        while not state.complete:
            told = next(rule.slot_assignments(state), None)
            if told is None:
                break
            joints = []
            for one, two in combinations(told.groups, 2):
                found = list(ends(furniture, state, told, frozenset(one.slots), frozenset(two.slots)))
                touching = sum(
                    (c.part_a in one.slots and c.part_b in two.slots)
                    or (c.part_b in one.slots and c.part_a in two.slots)
                    for c in furniture.connections
                )
                # Told in other slots than its own, a group may have its points elsewhere.
                moved = any(g not in state.groups for g in (one, two))
                assert len(found) == touching or (moved and len(found) < touching)
                joints.extend(found)
            for (u, k), (v, l) in joints:  # noqa: E741
                u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
                right = rule.judge(u_group, v_group, u, k, v, l) is not None
                own = all(g.slots == told.groups[state.group_of[g.parts[0]]].slots for g in (u_group, v_group))
                assert right or not own
                elsewhere.append(right)
            # Any right pair will do, not only what the slots would suggest.
            free = [
                (p, k) for g in state.groups for p in g.parts for k in range(len(g.points_of(furniture, p)))
                if (p, k) not in state.occupied(furniture)
            ]  # fmt: skip
            while True:
                (u, k), (v, l) = (free[i] for i in rng.integers(len(free), size=2))  # noqa: E741
                u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
                merge = rule.judge(u_group, v_group, u, k, v, l) if u_group is not v_group else None
                if merge is not None:
                    break
            swapped += merge.merged.slots != merge.merged.parts
            state = state.after_merge(merge.merged.moved_to(shapes.random_pose(rng, 2)))
    assert len(elsewhere) > 5
    # A group told in other slots than its own lies there to within the rule's tolerance only.
    assert np.mean(elsewhere) > 0.95
    assert swapped or len(furniture.classes) == len(furniture.parts)


def test_groups_that_would_share_a_slot_are_refused(table: Furniture) -> None:
    """A top with leg, and another leg: the tops' class has one slot only, and two tops there are not."""
    group = grown(table, 0, [(1, 0, 0), (2, 0, 1), (3, 0, 2)])
    last = alone(table, 4)
    rule = PairRule(table)
    assert rule.judge(last, group, 4, 0, 0, 3) is not None
    assert rule.judge(group, last, 0, 3, 4, 0) is not None
    for corner in range(3):
        assert rule.judge(last, group, 4, 0, 0, corner) is None


@pytest.mark.parametrize("seed", range(5))
def test_judgement_is_independent_of_poses(chair, seed: int) -> None:
    furniture = chair("windsor", 0)
    rng = np.random.default_rng(seed)
    rule = PairRule(furniture)
    for _ in range(30):
        u, v = rng.choice(len(furniture.parts), size=2, replace=False).tolist()
        k, l = (int(rng.integers(len(furniture.parts[p].points))) for p in (u, v))  # noqa: E741
        here = rule.judge(alone(furniture, u), alone(furniture, v), u, k, v, l)
        there = rule.judge(
            alone(furniture, u, shapes.random_pose(rng, 2)), alone(furniture, v, shapes.random_pose(rng, 2)), u, k, v, l
        )
        assert (here is None) == (there is None)
        if here is not None and there is not None:
            assert here.merged.slots == there.merged.slots
            for a, b in zip(here.merged.furniture_from_part, there.merged.furniture_from_part, strict=True):
                assert np.array_equal(a.homogeneous, b.homogeneous)


def test_group_bodies(table: Furniture) -> None:
    group = grown(table, 0, [(1, 0, 0)]).moved_to(pose(1, 2, 3, shapes.turn((0, 0, 1), 0.5)))
    points = hull_points(table, group)
    assert len(points) == 16
    top, leg = table.parts[0].mesh.volume, table.parts[1].mesh.volume
    expected = (top * group.furniture_from_part[0].translation + leg * group.furniture_from_part[1].translation) / (
        top + leg
    )
    center = center_of_mass(table, group)
    assert np.allclose(center, expected)
    made = body(table, group, "b", origin=center, moves=True)
    assert np.allclose(made.pose.translation, group.world_from_furniture.act(center))
    for shape, where in zip(made.shapes, group.part_poses(), strict=True):
        assert np.allclose((made.pose * shape.body_from_mesh).homogeneous, where.homogeneous)
    state = TaskState((group, *(alone(table, p, pose(p)) for p in (2, 3, 4))))
    assert np.allclose(state.part_poses[3].translation, [3, 0, 0])
    assert np.allclose(state.part_poses[1].homogeneous, group.part_poses()[1].homogeneous)


def growth(furniture: Furniture, rng: np.random.Generator) -> tuple[Group, set[int]]:
    """One group grown by random right pairs with single parts, until it is whole or no action is right any more."""
    rule = PairRule(furniture)
    parts = range(len(furniture.parts))
    group = alone(furniture, int(rng.integers(len(parts))))
    while True:
        loose = [p for p in parts if p not in group.parts]
        taken = TaskState((group, *(alone(furniture, p) for p in loose))).occupied(furniture)
        ends = [(p, k) for p in parts for k in range(len(furniture.parts[p].points)) if (p, k) not in taken]
        actions = [(a, b) for a in ends for b in ends if a[0] in loose and b[0] in group.parts]
        for index in rng.permutation(len(actions)):
            (u, k), (v, l) = actions[index]  # noqa: E741
            merge = rule.judge(alone(furniture, u), group, u, k, v, l)
            if merge is not None:
                group = merge.merged
                break
        else:
            return group, set(loose)


@pytest.mark.parametrize("family", FAMILIES)
def test_right_pairs_can_be_completed(chair, family: str) -> None:
    """A right sub-assembly lacks parts that fit somewhere: as far as pairs go, there always is a next right one."""
    furniture = chair(family, 0)
    rng = np.random.default_rng(5)
    for _ in range(4):
        group, loose = growth(furniture, rng)
        assert not loose, [furniture.parts[p].name for p in loose]
        assert congruent(furniture, group)


@pytest.mark.parametrize(("off", "others"), [(0.0, 1), (1e-3, 0)])
def test_joined_parts_keep_their_slots_within_tolerance(off: float, others: int) -> None:
    """A top with a leg could be turned over and the leg be told in the slot across; a millimetre off it is not."""
    top = shapes.box((-0.3, -0.1, 0.4 + shapes.GAP), (0.3, 0.1, 0.43 + shapes.GAP))
    legs = [shapes.box((x - 0.02, -0.02, 0.0), (x + 0.02, 0.02, 0.4)) for x in (-0.2, 0.2 + off)]
    bench = shapes.furniture("bench", {"top": top, "leg0": legs[0], "leg1": legs[1]})
    rule = PairRule(bench)
    merge = rule.judge(alone(bench, 1), alone(bench, 0), 1, 0, 0, 0)
    assert merge is not None
    told = {group.slots for group in rule.placements(merge.merged)}
    assert len(told) == 1 + others
    # Either leg still goes to either place: tolerance is for what is not joined yet.
    assert rule.judge(alone(bench, 2), alone(bench, 0), 2, 0, 0, 0) is not None


def two_sides(off: float = 0.0, twist: float = 0.0) -> Furniture:
    """A board (0) on two sides: posts 1 and 2, arms 3 and 4, bars 5 and 6.

    An arm meets its post at height 0.2, the second one `off` above it; the second arm and its bar are turned about the
    arm's axis by `twist`. The bar's centre is 0.2 m from that axis.
    """
    parts = {"board": shapes.box((-0.4, -0.02, 0.4 + shapes.GAP), (0.4, 0.02, 0.43 + shapes.GAP))}
    sides = ((-0.3, 0.0, 0.0), (0.3, off, twist))
    for name, low, high in (
        ("post", (-0.02, -0.02, 0.0), (0.02, 0.02, 0.4)),
        ("arm", (-0.01, 0.02 + shapes.GAP, -0.015), (0.01, 0.1, 0.015)),
        ("bar", (-0.01, 0.1 + shapes.GAP, -0.02), (0.41, 0.14, 0.02)),
    ):
        for i, (x, up, angle) in enumerate(sides):
            where = pose(x) if name == "post" else pose(x, 0.0, 0.2 + up, shapes.turn((0, 1, 0), angle))
            parts[f"{name}{i}"] = shapes.box(low, high).transformed(where)
    return shapes.furniture("two sides", parts)


def first_side_joined(furniture: Furniture) -> tuple[PairRule, list[Group], Group]:
    """The first side of `two_sides`, joined; alone, the parts of the second one would take the same slots."""
    rule, loose = PairRule(furniture), [alone(furniture, part) for part in range(7)]
    first = rule.judge(loose[1], loose[3], 1, 1, 3, 0)
    second = rule.judge(loose[2], loose[4], 2, 1, 4, 1)
    assert first is not None
    assert second is not None
    assert first.merged.slots == second.merged.slots == (1, 3)
    return rule, loose, first.merged


def test_second_of_two_equal_sides_takes_the_slots_that_the_first_left() -> None:
    """The slots differ by 1 mm: too much for a joined side to take the other ones later."""
    furniture = two_sides(off=1e-3)
    assert [c.members for c in furniture.classes] == [(0,), (1, 2), (3, 4), (5, 6)]
    rule, loose, first = first_side_joined(furniture)
    state = TaskState((first, *(loose[p] for p in (0, 2, 4, 5, 6))))
    other = rule.judge_in(state, 2, 1, 4, 1)
    assert other is not None
    assert other.merged.slots == (2, 4)
    assert rule.assign_slots(TaskState((first, other.merged, *(loose[p] for p in (0, 5, 6))))) is not None


def test_pair_without_slots_left_is_wrong() -> None:
    """Slots that differ by 4 mm: a second side like the first one belongs nowhere."""
    furniture = two_sides(off=4e-3)
    rule, loose, first = first_side_joined(furniture)
    state = TaskState((first, *(loose[p] for p in (0, 2, 4, 5, 6))))
    assert rule.judge_in(state, 2, 1, 4, 1) is None
    own = rule.judge_in(state, 2, 1, 4, 0)
    assert own is not None
    assert own.merged.slots == (2, 4)


def test_judgement_is_independent_of_roles() -> None:
    """A post and an arm with its bar, joined as on the first side where only the second is left: 1.1 degrees off.

    From the post, the bar misses its slot by 3.9 mm, more than the tolerance; from the arm, everything is within it.
    """
    furniture = two_sides(twist=0.0195)
    rule = PairRule(furniture)
    loose = [alone(furniture, part) for part in range(7)]
    first = rule.judge(loose[2], loose[4], 2, 1, 4, 1)
    arm = rule.judge(loose[3], loose[5], 3, 1, 5, 0)
    assert first is not None
    assert arm is not None
    assert first.merged.slots == (1, 3)
    post, arm_and_bar = loose[1], arm.merged
    for merge in (
        rule.judge(post, arm_and_bar, 1, 1, 3, 0, [first.merged]),
        rule.judge(arm_and_bar, post, 3, 0, 1, 1, [first.merged]),
    ):
        assert merge is not None
        assert merge.merged.slots == (2, 4, 6)
