"""Train with the paper's method on two small chairs, in about a minute on one core.

    python -m pip install '.[learn]'
    python examples/04_paper_method_small.py

The four steps are those of the paper: an auto-encoder of part shapes, one Double DQN expert per chair, samples from the
experts' episodes, and one policy that imitates their Q-values. The paper uses 220 chairs and 40,000 environment steps
each; `roboassembly train` and `roboassembly benchmark` do that. The last lines show how far two chairs of one family
go: to a third one, and to another family. Stop the script at any moment; the same command continues it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import furniture_refs
from roboassembly.evaluation.rollout import run_episode
from roboassembly.furniture import storage
from roboassembly.learning.paper.autoencoder import AutoencoderTraining
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.pipeline import (
    PipelineConfig,
    autoencoder_file,
    expert_results,
    samples_folder,
    train_autoencoder,
    train_experts,
    train_policy,
)
from roboassembly.learning.progress import Progress
from roboassembly.learning.registry import load_policy

TRAINED_ON = ("three_legged:3", "three_legged:20")
UNSEEN = ("three_legged:24", "stool")


def follow(progress: Iterable[Progress]) -> None:
    """Do the work of a stage, and print how far it is, once per stage and at its end."""
    for p in progress:
        if p.done == p.total:
            print(f"{p.stage}: " + ", ".join(f"{name} {value:.3g}" for name, value in p.scalars.items()), flush=True)


def main() -> None:
    """Train on two chairs, and measure the policy on them and on others."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/small"), help="folder of the run")
    parser.add_argument("--updates", type=int, default=600, help="gradient steps of the last network")
    args = parser.parse_args()

    # A folder of furniture is a data set.
    for name in TRAINED_ON:
        storage.save(catalogue.find(name), args.out / "chairs" / name.replace(":", "-"))
    chairs = furniture_refs(f"folder:{args.out / 'chairs'}")

    config = PipelineConfig(
        autoencoder=AutoencoderTraining(steps=300),
        extra_clouds=0,
        experts=ExpertTraining(steps=8_000),
        episodes=6,
    )
    # 1. The auto-encoder: the shape of a part in 44 numbers.
    follow(train_autoencoder(chairs, args.out, config, {}, jobs=1))
    # 2. and 3. An expert for each chair, and samples from its episodes.
    follow(train_experts(chairs, args.out, config, {}, jobs=1))
    for result in expert_results(chairs, args.out):
        print(f"{result.name}: solved {result.mastered} after {result.steps} environment steps")
    # 4. One policy for all chairs, by imitation.
    training = PaperTraining(steps=args.updates)
    follow(train_policy([samples_folder(args.out)], autoencoder_file(args.out), args.out, training))

    policy = load_policy(str(args.out / "policy.npz"))
    episodes = [run_episode(policy, chair.furniture(), seed=100) for chair in chairs]
    print(f"the policy solves {sum(e.success for e in episodes)} of {len(episodes)} chairs from new starts")
    for name in UNSEEN:
        episode = run_episode(policy, catalogue.find(name), seed=100)
        print(f"{name}, not seen in training: {episode.merges} of {episode.parts - 1} merges ({episode.verdict})")


if __name__ == "__main__":
    main()
