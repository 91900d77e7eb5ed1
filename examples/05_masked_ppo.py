"""A policy learnt with PyTorch and the MaskablePPO of sb3-contrib, in one file: network, training, `policy(seed)`.

    python -m pip install '.[rl]'                                # in the source folder
    python examples/05_masked_ppo.py                                # some minutes on one core
    python examples/05_masked_ppo.py --setting full --steps 4000    # goes on from there: which hands
    roboassembly generate three_legged --seed 3 --out stools/three_legged-3
    roboassembly evaluate --policy examples/05_masked_ppo.py --set folder:stools --episodes 50
    roboassembly evaluate --policy examples/05_masked_ppo.py --set folder:stools --episodes 10 --setting full

It learns one small stool by trial and error and nothing else; docs/your-own-policy.md says how far that goes.
"""

from __future__ import annotations

import argparse
from functools import cache
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import nn

import roboassembly.envs
from roboassembly.learning.policy import surest

SETTINGS = ("object-centric", "full")
STOOL = "three_legged:3"
"""What it trains on: five parts, twelve connection points."""
CLOUD, GRASPS, AXES = 64, 8, 6
TOKEN, HAND = 16, 10
"""Numbers that tell a connection point, and a hand at it."""


# What the network sees: a row for each free connection point.


def rows_of(observation: dict[str, np.ndarray], mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Free connection points: rows of numbers, their `(part, point)`, and which actions exist between them.

    Where parts lie is left out, so that one start is like another; only a hand is told how steeply it would come down.
    """
    first, second = np.nonzero(mask.any(axis=(1, 3, *range(4, mask.ndim))))
    parts = int(observation["shapes"].any(axis=(1, 2)).sum())
    joined = observation["connections"].any(axis=2) | np.eye(len(mask), dtype=bool)
    size = joined.sum(axis=1)
    groups = np.full(len(first), (1.0 / size[:parts]).sum() / parts)
    reach = np.abs(observation["shapes"]).max(axis=1)
    points = observation["connection_points"][first, second]
    told = np.stack([np.ones(len(first)), groups, size[first] / parts, size[first] > 1], axis=1)
    hands = observation["grasp_regions"].reshape(len(mask), GRASPS, 6)[first]
    turn, lies = rotation(hands[..., 3:]), rotation(observation["poses"][first, 3:])
    away = 10.0 * (hands[..., :3] - points[:, None, :3])
    down = np.einsum("ni,nhi->nh", lies[:, 2], turn[..., 2])[..., None]
    hand = np.concatenate([away, turn[..., 1], turn[..., 2], down], axis=-1).reshape(len(first), GRASPS * HAND)
    rows = np.concatenate([told, points * np.repeat([3.0, 1.0, 1.0], 3), 3.0 * reach[first], hand], axis=1).astype(
        np.float32
    )
    exists = mask[first[:, None], first, second[:, None], second]
    return rows, np.stack([first, second], axis=1), exists


def rotation(euler: np.ndarray) -> np.ndarray:
    """Matrices of roll, pitch and yaw: `Rz(yaw) Ry(pitch) Rx(roll)`."""
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(euler), -1, 0), np.moveaxis(np.sin(euler), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


# The network.


class Points(nn.Module):
    """Every free point in the light of all others."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.alone = nn.Sequential(nn.Linear(TOKEN, width), nn.Tanh(), nn.Linear(width, width))
        self.together = nn.Linear(width, width)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Rows `(batch, n, numbers)`; those of zeros are padding."""
        there, each = rows[..., :1], self.alone(rows[..., :TOKEN])
        mean = (each * there).sum(1, keepdim=True) / there.sum(1, keepdim=True).clamp(min=1.0)
        return torch.tanh(each + self.together(mean)) * there


class Scores(nn.Module):
    """A score for every action: of the pair of points, and of the axis or the two hands given the pair."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.points = Points(width)
        self.moves, self.waits = nn.Linear(width, width), nn.Linear(width, width)
        self.pair, self.axis = nn.Linear(width, 1), nn.Linear(width, AXES)
        self.hand = nn.Sequential(nn.Linear(width + HAND, width), nn.Tanh(), nn.Linear(width, 2))

    def forward(self, rows: torch.Tensor, robots: bool) -> torch.Tensor:
        """`(batch, n, n, 6)`, or `(batch, n, n, 8, 8)` with robots."""
        points = self.points(rows)
        pairs = torch.relu(self.moves(points)[:, :, None] + self.waits(points)[:, None])
        score = self.pair(pairs)
        if not robots:
            return score + self.axis(pairs).log_softmax(-1)
        hands = rows[..., TOKEN:].unflatten(-1, (GRASPS, HAND))
        held = self.hand(torch.cat([points[:, :, None].expand(-1, -1, GRASPS, -1), hands], -1)).log_softmax(2)
        return score[..., None] + held[:, :, None, :, None, 0] + held[:, None, :, None, :, 1]


# The policy that `roboassembly evaluate --policy examples/05_masked_ppo.py` plays.


class PairPolicy:
    """Takes the best action of the network."""

    name = "masked-ppo"
    cloud_points = CLOUD
    settings = SETTINGS

    def __init__(self, networks: dict[str, Scores]) -> None:
        self.networks = networks

    def act(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """The best of `values`."""
        return surest(self.values(observation, mask))

    def values(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """Scores of all actions, -inf where there is none: this is what lets a policy guide the search."""
        robots = mask.ndim == 6
        rows, points, exists = rows_of(observation, mask)
        with torch.no_grad():
            scores = self.networks[SETTINGS[robots]](torch.from_numpy(rows)[None], robots)[0].numpy()
        part, point = points.T
        values = np.full(mask.shape, -np.inf, np.float32)
        values[part[:, None], part, point[:, None], point] = np.where(exists, scores, -np.inf)
        return values


def weights(setting: str) -> Path:
    """Where training puts them: beside this file."""
    return Path(__file__).with_name(f"masked_ppo-{setting}.pt")


@cache
def trained(setting: str) -> Scores:
    """The network with its weights, read once. Without any of the full setting it knows pairs, and nothing of hands."""
    path = next((p for p in (weights(setting), weights(SETTINGS[0])) if p.is_file()), None)
    if path is None:
        raise FileNotFoundError(f"no weights at {weights(setting)}; train them first: python {__file__}")
    scores = Scores()
    # Tensors only: nothing in the file is executed.
    scores.load_state_dict(torch.load(path, weights_only=True))
    return scores


def policy(seed: int) -> PairPolicy:
    """What `evaluate` asks for, once an episode; this policy draws nothing."""
    return PairPolicy({setting: trained(setting) for setting in SETTINGS})


# Training.


class Pairs(gymnasium.Wrapper):
    """The environment as a learner for `Box` and `Discrete` wants it: rows in, the number of a pair and a way out.

    With 12 free points that are 864 numbers where the padded space has 240,000.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        _, info = env.reset(seed=0)
        mask = info["action_mask"]
        self.most = int(mask.any(axis=(1, 3, *range(4, mask.ndim))).sum())
        self.shape = (self.most, self.most, *mask.shape[4:])
        self.observation_space = spaces.Box(-np.inf, np.inf, (self.most, TOKEN + GRASPS * HAND), np.float32)
        self.action_space = spaces.Discrete(int(np.prod(self.shape)))

    def reset(self, **options: object) -> tuple[np.ndarray, dict]:
        """As the wrapped environment's."""
        observation, info = self.env.reset(**options)
        return self._seen(observation, info), info

    def step(self, number: int) -> tuple[np.ndarray, float, bool, bool, dict]:
        """As the wrapped environment's, by number."""
        i, j, *way = np.unravel_index(int(number), self.shape)
        (u, k), (v, l) = self.points[i], self.points[j]  # noqa: E741
        observation, reward, terminated, truncated, info = self.env.step(np.array([u, v, k, l, *way]))
        return self._seen(observation, info), float(reward), terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Which numbers are actions that exist; a furniture that stands has none, and PPO asks no more then."""
        return self.exists.ravel()

    def _seen(self, observation: dict[str, np.ndarray], info: dict) -> np.ndarray:
        rows, self.points, exists = rows_of(observation, info["action_mask"])
        n = len(rows)
        self.exists = np.zeros(self.shape, bool)
        self.exists[:n, :n] = exists
        return np.pad(rows, ((0, self.most - n), (0, 0)))


def learner(env: Pairs, scores: Scores, robots: bool, seed: int):
    """MaskablePPO with `Scores` as its actor and a small critic."""
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.torch_layers import MlpExtractor

    class Actor(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.scores = scores

        def forward(self, flat: torch.Tensor) -> torch.Tensor:
            return self.scores(flat.unflatten(-1, env.observation_space.shape), robots).flatten(1)

    class Critic(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.points, self.worth = Points(64), nn.Linear(64, 1)

        def forward(self, flat: torch.Tensor) -> torch.Tensor:
            return self.worth(self.points(flat.unflatten(-1, env.observation_space.shape)).mean(1))

    class ActorCritic(MaskableActorCriticPolicy):
        def _build(self, lr_schedule) -> None:
            # Nothing between the rows and the two networks: sb3 flattens them and hands them on.
            self.mlp_extractor = MlpExtractor(self.features_dim, [], nn.Identity)
            self.action_net, self.value_net = Actor(), Critic()
            self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    # Steps of robots are dear, so more is learnt of each.
    rollout, epochs = (256, 10) if robots else (512, 6)
    return MaskablePPO(
        ActorCritic, env, learning_rate=1e-3, n_steps=rollout, batch_size=rollout // 4, n_epochs=epochs, gamma=0.95,
        ent_coef=0.01, seed=seed, verbose=1,
    )  # fmt: skip


def main() -> None:
    """Train, from the weights that are there if there are any (the full setting from those of the other), and write."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--furniture", default=STOOL, help="a built-in piece or a furniture folder")
    parser.add_argument("--setting", choices=SETTINGS, default=SETTINGS[0])
    parser.add_argument("--steps", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    robots = told.setting == "full"
    name = roboassembly.envs.FULL if robots else roboassembly.envs.OBJECT_CENTRIC
    env = Pairs(gymnasium.make(name, furniture=told.furniture, cloud_points=CLOUD))
    torch.manual_seed(told.seed)
    scores = trained(told.setting) if weights(SETTINGS[0]).is_file() else Scores()
    model = learner(env, scores, robots, told.seed)
    while model.num_timesteps < told.steps:
        model.learn(model.n_steps, reset_num_timesteps=False)
        torch.save(scores.state_dict(), weights(told.setting))
    print(weights(told.setting))


if __name__ == "__main__":
    main()
