"""Train a policy with PyTorch and the MaskablePPO of sb3-contrib; network, training and `policy` in one file.

    python -m pip install '.[rl]'                                # in the source folder
    python examples/05_masked_ppo.py                                # a few minutes on one core
    python examples/05_masked_ppo.py --setting full --steps 4000    # continues from there: grasps
    roboassembly generate three_legged --seed 3 --out stools/three_legged-3
    roboassembly evaluate --policy examples/05_masked_ppo.py --set folder:stools --episodes 50
    roboassembly evaluate --policy examples/05_masked_ppo.py --set folder:stools --episodes 10 --setting full

It learns to assemble one small stool by trial and error; docs/your-own-policy.md says what it cannot do.
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
"""Training furniture: five parts, twelve connection points."""
CLOUD, GRASPS, AXES = 64, 8, 6
TOKEN, HAND = 16, 10
"""Number of features of a connection point, and of a hand at it."""


# Features: one row for each free connection point.


def rows_of(observation: dict[str, np.ndarray], mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the features of free connection points, their `(part, point)`, and which actions exist between them.

    Poses of parts are left out, so that all starts look alike. The one exception is how steeply a hand would come down.
    """
    first, second = np.nonzero(mask.any(axis=(1, 3, *range(4, mask.ndim))))
    parts = int(observation["shapes"].any(axis=(1, 2)).sum())
    joined = observation["connections"].any(axis=2) | np.eye(len(mask), dtype=bool)
    size = joined.sum(axis=1)
    groups = np.full(len(first), (1.0 / size[:parts]).sum() / parts)
    reach = np.abs(observation["shapes"]).max(axis=1)
    points = observation["connection_points"][first, second]
    state = np.stack([np.ones(len(first)), groups, size[first] / parts, size[first] > 1], axis=1)
    hands = observation["grasp_regions"].reshape(len(mask), GRASPS, 6)[first]
    turn, part_turn = rotation(hands[..., 3:]), rotation(observation["poses"][first, 3:])
    away = 10.0 * (hands[..., :3] - points[:, None, :3])
    down = np.einsum("ni,nhi->nh", part_turn[:, 2], turn[..., 2])[..., None]
    hand = np.concatenate([away, turn[..., 1], turn[..., 2], down], axis=-1).reshape(len(first), GRASPS * HAND)
    rows = np.concatenate([state, points * np.repeat([3.0, 1.0, 1.0], 3), 3.0 * reach[first], hand], axis=1).astype(
        np.float32
    )
    exists = mask[first[:, None], first, second[:, None], second]
    return rows, np.stack([first, second], axis=1), exists


def rotation(euler: np.ndarray) -> np.ndarray:
    """Return the matrices of roll, pitch and yaw: `Rz(yaw) Ry(pitch) Rx(roll)`."""
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(euler), -1, 0), np.moveaxis(np.sin(euler), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


# The network.


class Points(nn.Module):
    """Encodes each free point, given the mean of all points."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.alone = nn.Sequential(nn.Linear(TOKEN, width), nn.Tanh(), nn.Linear(width, width))
        self.together = nn.Linear(width, width)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Encode rows `(batch, n, features)`; rows of zeros are padding."""
        there, each = rows[..., :1], self.alone(rows[..., :TOKEN])
        mean = (each * there).sum(1, keepdim=True) / there.sum(1, keepdim=True).clamp(min=1.0)
        return torch.tanh(each + self.together(mean)) * there


class Scores(nn.Module):
    """Scores every action: the pair of points, and the axis or the two hands given the pair."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.points = Points(width)
        self.moves, self.waits = nn.Linear(width, width), nn.Linear(width, width)
        self.pair, self.axis = nn.Linear(width, 1), nn.Linear(width, AXES)
        self.hand = nn.Sequential(nn.Linear(width + HAND, width), nn.Tanh(), nn.Linear(width, 2))

    def forward(self, rows: torch.Tensor, robots: bool) -> torch.Tensor:
        """Return scores `(batch, n, n, 6)`, or `(batch, n, n, 8, 8)` with robots."""
        points = self.points(rows)
        pairs = torch.relu(self.moves(points)[:, :, None] + self.waits(points)[:, None])
        score = self.pair(pairs)
        if not robots:
            return score + self.axis(pairs).log_softmax(-1)
        hands = rows[..., TOKEN:].unflatten(-1, (GRASPS, HAND))
        held = self.hand(torch.cat([points[:, :, None].expand(-1, -1, GRASPS, -1), hands], -1)).log_softmax(2)
        return score[..., None] + held[:, :, None, :, None, 0] + held[:, None, :, None, :, 1]


# The policy for `roboassembly evaluate --policy examples/05_masked_ppo.py`.


class PairPolicy:
    """Chooses the action with the best score."""

    name = "masked-ppo"
    cloud_points = CLOUD
    settings = SETTINGS

    def __init__(self, networks: dict[str, Scores]) -> None:
        self.networks = networks

    def act(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """Return the best action."""
        return surest(self.values(observation, mask))

    def values(self, observation: dict[str, np.ndarray], mask: np.ndarray) -> np.ndarray:
        """Return a score for every action, -inf where none exists; this lets a policy guide the search."""
        robots = mask.ndim == 6
        rows, points, exists = rows_of(observation, mask)
        with torch.no_grad():
            scores = self.networks[SETTINGS[robots]](torch.from_numpy(rows)[None], robots)[0].numpy()
        part, point = points.T
        values = np.full(mask.shape, -np.inf, np.float32)
        values[part[:, None], part, point[:, None], point] = np.where(exists, scores, -np.inf)
        return values


def weights(setting: str) -> Path:
    """Return the path of the trained weights, beside this file."""
    return Path(__file__).with_name(f"masked_ppo-{setting}.pt")


@cache
def trained(setting: str) -> Scores:
    """Load the network once. Without weights for the full setting, those of the other one score the pairs only."""
    path = next((p for p in (weights(setting), weights(SETTINGS[0])) if p.is_file()), None)
    if path is None:
        raise FileNotFoundError(f"no weights at {weights(setting)}; train them first: python {__file__}")
    scores = Scores()
    # weights_only: the file holds tensors, and nothing in it is executed.
    scores.load_state_dict(torch.load(path, weights_only=True))
    return scores


def policy(seed: int) -> PairPolicy:
    """Make the policy; the commands call this once per episode. It uses no random numbers."""
    return PairPolicy({setting: trained(setting) for setting in SETTINGS})


# Training.


class Pairs(gymnasium.Wrapper):
    """Wraps the environment for learners of `Box` and `Discrete`: features in, the number of an action out.

    With 12 free points there are 864 actions; the padded space has 240,000.
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
        """Reset the wrapped environment."""
        observation, info = self.env.reset(**options)
        return self._features(observation, info), info

    def step(self, number: int) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Execute the action with a number in the wrapped environment."""
        i, j, *choice = np.unravel_index(int(number), self.shape)
        (u, k), (v, l) = self.points[i], self.points[j]  # noqa: E741
        observation, reward, terminated, truncated, info = self.env.step(np.array([u, v, k, l, *choice]))
        return self._features(observation, info), float(reward), terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Return which numbers are actions that exist; finished furniture has none."""
        return self.exists.ravel()

    def _features(self, observation: dict[str, np.ndarray], info: dict) -> np.ndarray:
        rows, self.points, exists = rows_of(observation, info["action_mask"])
        n = len(rows)
        self.exists = np.zeros(self.shape, bool)
        self.exists[:n, :n] = exists
        return np.pad(rows, ((0, self.most - n), (0, 0)))


def learner(env: Pairs, scores: Scores, robots: bool, seed: int):
    """Return a MaskablePPO with `Scores` as its actor and a small critic."""
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
            self.points, self.value = Points(64), nn.Linear(64, 1)

        def forward(self, flat: torch.Tensor) -> torch.Tensor:
            return self.value(self.points(flat.unflatten(-1, env.observation_space.shape)).mean(1))

    class ActorCritic(MaskableActorCriticPolicy):
        def _build(self, lr_schedule) -> None:
            # sb3 flattens the features; both networks take them as they are.
            self.mlp_extractor = MlpExtractor(self.features_dim, [], nn.Identity)
            self.action_net, self.value_net = Actor(), Critic()
            self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    # Steps with robots are slow, so each one is used more often.
    rollout, epochs = (256, 10) if robots else (512, 6)
    return MaskablePPO(
        ActorCritic, env, learning_rate=1e-3, n_steps=rollout, batch_size=rollout // 4, n_epochs=epochs, gamma=0.95,
        ent_coef=0.01, seed=seed, verbose=1,
    )  # fmt: skip


def main() -> None:
    """Train, starting from existing weights if there are any, and save the weights."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--furniture", default=STOOL, help="a built-in piece or a furniture folder")
    parser.add_argument("--setting", choices=SETTINGS, default=SETTINGS[0])
    parser.add_argument("--steps", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    robots = args.setting == "full"
    name = roboassembly.envs.FULL if robots else roboassembly.envs.OBJECT_CENTRIC
    env = Pairs(gymnasium.make(name, furniture=args.furniture, cloud_points=CLOUD))
    torch.manual_seed(args.seed)
    scores = trained(args.setting) if weights(SETTINGS[0]).is_file() else Scores()
    model = learner(env, scores, robots, args.seed)
    while model.num_timesteps < args.steps:
        model.learn(model.n_steps, reset_num_timesteps=False)
        torch.save(scores.state_dict(), weights(args.setting))
    print(weights(args.setting))


if __name__ == "__main__":
    main()
