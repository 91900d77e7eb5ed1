"""Write a policy, and measure it alone and as the guide of a search.

    python examples/03_custom_policy.py
    roboassembly assemble stool --policy examples/03_custom_policy.py --no-film

The commands take this file as it is, because it defines `policy`. docs/your-own-policy.md explains the interface.
"""

from __future__ import annotations

import argparse

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.evaluation.rollout import run_episode
from roboassembly.learning.policy import guide_of
from roboassembly.solvers.search import solve


class Facing:
    """Prefers pairs of connection points that face each other in the furniture's frame.

    Part frames are parallel to the furniture's frame, so the two normals of a right pair are opposed and the two
    tangents equal. Many wrong pairs look the same; this policy is simple, not good.
    """

    name = "facing"
    cloud_points = 1
    settings = ("object-centric", "full")

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def values(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """Return a score for every action, -inf where none exists; this lets a policy guide the search."""
        _, normal, tangent = np.split(observation["connection_points"], 3, axis=-1)
        fit = np.einsum("ukc,vlc->uvkl", tangent, tangent) - np.einsum("ukc,vlc->uvkl", normal, normal)
        rest = mask.shape[4:]  # `w`, or two grasps
        values = 3.0 * fit.reshape(*fit.shape, *(1 for _ in rest)) + self.rng.random(rest)
        return np.where(mask, values, -np.inf)

    def act(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """Return the action with the best score."""
        return np.array(np.unravel_index(self.values(observation, mask).argmax(), mask.shape))


policy = Facing
"""The commands call this with a seed, once per episode."""


def main() -> None:
    """Run the policy on a few pieces, alone and guiding the search."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--furniture", nargs="+", default=["stool", "three_legged:3", "ladder"])
    args = parser.parse_args()
    for name in args.furniture:
        furniture = catalogue.find(name)
        episode = run_episode(policy(0), furniture, seed=0)
        alone = f"{episode.merges} of {len(furniture.parts) - 1} merges alone ({episode.verdict})"
        plain, guided = solve(furniture, seed=0), solve(furniture, seed=0, guide=guide_of(policy(0)))
        effort = f"{guided.planning_steps} states checked with it as guide, {plain.planning_steps} without"
        print(f"{furniture.name}: {alone}; {effort}")


if __name__ == "__main__":
    main()
