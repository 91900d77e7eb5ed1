"""Prints how many solved episodes of a benchmark consist of pairs that the paper's own test accepts, in Markdown.

    python tools/paper_pairs.py runs/benchmark-chairs-880/episodes/*-chairs-880-test.jsonl

The environments judge pairs by `task/rules/pairs.py`, and the paper by numbers of parts and points alone
(`task/rules/paper_pair_rule.py`). Each episode is replayed without motion planning. The last column also accepts a pair
whose test holds with the roles of its two groups swapped: the paper lets equal parts stand for u alone.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from roboassembly.datasets.sets import FurnitureRef, furniture_refs
from roboassembly.geometry.poses import SE3
from roboassembly.statistics import success
from roboassembly.task.rules.connections import Rules
from roboassembly.task.rules.groups import Group, TaskState


def accepted(ref: FurnitureRef, actions: list[list[int]]) -> tuple[bool, bool]:
    """Return whether the paper's test accepts all pairs of an episode: as they are, and with roles swapped or not."""
    furniture = ref.furniture(with_grasps=False)
    rules = Rules(furniture)
    state = TaskState(tuple(Group((p,), (p,), (slot,), SE3.Identity()) for p, slot in enumerate(furniture.assembled)))
    as_is = either = True
    for u, v, k, m, *_ in actions:
        passed = rules.paper_accepts(state, u, v, k, m)
        as_is &= passed
        either &= passed or rules.paper_accepts(state, v, u, m, k)
        groups = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = rules.pairs.judge(*groups, u, k, v, m)
        assert merge is not None, f"{furniture.name}: the episode merged a pair that is wrong today"
        state = TaskState((*(g for g in state.groups if g not in groups), merge.merged))
    return as_is, either


def percent(passed: list[bool]) -> str:
    """Return a share with its 95 % interval."""
    figures = success(passed)
    low, high = figures["ci95"]
    return f"{100 * figures['success_rate']:.1f} ({100 * low:.1f}–{100 * high:.1f})"


def main() -> None:
    """Print a row for each file of episodes."""
    print("| | n | solved, % | and all pairs pass the paper's test, % | in either role, % |\n|---|---|---|---|---|")
    for path in map(Path, sys.argv[1:]):
        about, *episodes = map(json.loads, path.read_text().splitlines())
        refs = {ref.furniture(with_grasps=False).name: ref for ref in furniture_refs(about["measurement"]["set"])}
        solved = [e["success"] for e in episodes]
        if not any(e["actions"] for e in episodes):
            continue
        found = [
            accepted(refs[e["furniture"]], e["actions"]) if e["success"] else (False, False) for e in episodes
        ]  # fmt: skip
        cells = [percent(solved), *(percent([f[i] for f in found]) for i in (0, 1))]
        print(f"| {about['measurement']['name']} | {len(episodes)} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
