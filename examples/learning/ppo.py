"""PPO in one file, with torch and Gymnasium only: it learns the target of a servo and further actions of a task.

python examples/learning/ppo.py --seed 1 --out ppo.csv                            # edmsim/GapFeed-v2
python examples/learning/ppo.py --env edmsim/MaxRate-v1 --seed 1 --out rate.csv

Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) with generalised advantages (arXiv:1506.02438).
Every row of the output table has the decisions so far, and the mean return and cost of the last twenty episodes.
"""

import argparse
import csv
from collections import deque
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn

import edmsim  # noqa: F401 - registers the environments

NUM_ENVS, STEPS, EPOCHS, BATCH = 8, 128, 5, 256
GAMMA, LAMBDA, CLIP = 0.99, 0.95, 0.2
LEARNING_RATE, GREATEST_GRADIENT = 1e-3, 0.5


class Running:
    """Mean and variance of all observations, merged batch by batch (Chan et al. 1979)."""

    def __init__(self, width: int) -> None:
        self.mean, self.variance, self.count = np.zeros(width), np.ones(width), 1e-4

    def see(self, values: np.ndarray) -> None:
        """Add rows (n, width)."""
        count, mean, variance = len(values), values.mean(axis=0), values.var(axis=0)
        total, delta = self.count + count, mean - self.mean
        self.variance = (
            self.variance * self.count + variance * count + delta**2 * self.count * count / total
        ) / total
        self.mean, self.count = self.mean + delta * count / total, total

    def scaled(self, values: np.ndarray) -> torch.Tensor:
        """Return rows with mean 0 and variance 1, clipped to -10..10."""
        scaled = (values - self.mean) / np.sqrt(self.variance + 1e-8)
        return torch.as_tensor(np.clip(scaled, -10, 10), dtype=torch.float32)


def _network(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


class Agent(nn.Module):
    """Two networks: the mean of the actions, and the value; the noise on actions is a learned parameter."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.mean = _network(inputs, actions)
        self.value = _network(inputs, 1)
        self.log_std = nn.Parameter(torch.full((actions,), -0.5))
        with torch.no_grad():
            self.mean[-1].weight.mul_(0.01)  # the first actions are those around 0

    def chosen(self, observations: torch.Tensor) -> torch.distributions.Normal:
        """Return the distribution of the actions."""
        return torch.distributions.Normal(self.mean(observations), self.log_std.exp())


def advantages(rewards: np.ndarray, values: np.ndarray, ended: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return generalised advantages (steps, num_envs); `ended` is 1 where an episode ended with the step."""
    found, ahead, following = np.zeros_like(rewards), np.zeros(rewards.shape[1]), last
    for step in reversed(range(len(rewards))):
        on = 1.0 - ended[step]
        ahead = rewards[step] + GAMMA * following * on - values[step] + GAMMA * LAMBDA * on * ahead
        found[step], following = ahead, values[step]
    return found


def update(agent: Agent, optimiser: torch.optim.Optimizer, rows: tuple[torch.Tensor, ...]) -> None:
    """Update the networks with a rollout: observations, actions, log probabilities, advantages, returns."""
    for _ in range(EPOCHS):
        for chosen in torch.randperm(len(rows[0])).split(BATCH):
            observations, actions, before, gain, returns = (row[chosen] for row in rows)
            distribution = agent.chosen(observations)
            ratio = (distribution.log_prob(actions).sum(1) - before).exp()
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            value_loss = (agent.value(observations).squeeze(1) - returns).square().mean()
            optimiser.zero_grad()
            (policy_loss + 0.5 * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), GREATEST_GRADIENT)
            optimiser.step()


def main() -> None:
    """Train, and write the learning curve."""
    parser = argparse.ArgumentParser(description="PPO in an environment of edmsim.")
    parser.add_argument("--env", default="edmsim/GapFeed-v2", help="id of the environment")
    parser.add_argument("--action", default="servo", help="servo: its target; speed: the feed itself")
    parser.add_argument("--decision-s", type=float, help="machine time of a decision; default: the environment's")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=204_800, help="decisions, all sub-environments together")
    parser.add_argument("--out", type=Path, required=True, help="table of the learning curve, .csv")
    args = parser.parse_args()
    if args.steps < NUM_ENVS * STEPS:
        parser.error(f"--steps {args.steps}: one rollout has {NUM_ENVS * STEPS} decisions; give as many or more")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # more threads do not help such small networks
    torch.manual_seed(args.seed)
    options = {} if args.decision_s is None else {"decision_s": args.decision_s}
    envs = gymnasium.make_vec(
        args.env, num_envs=NUM_ENVS, vectorization_mode="vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP,
        action=args.action, servo_target_share=[0.0, 0.9], **options,
    )
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE, eps=1e-5)
    inputs_so_far, returns_so_far = Running(envs.single_observation_space.shape[0]), Running(1)
    observation, _ = envs.reset(seed=1000 * args.seed)  # seeds count up from here: no two trainings share machines
    last_twenty: deque[tuple[float, float]] = deque(maxlen=20)
    discounted, episode, cost = np.zeros(NUM_ENVS), np.zeros(NUM_ENVS), np.zeros(NUM_ENVS)
    curve = [("decisions", "return", "cost")]
    for done in range(NUM_ENVS * STEPS, args.steps + 1, NUM_ENVS * STEPS):
        rollout: list[tuple] = []
        over: list[tuple[float, float]] = []
        for _ in range(STEPS):
            inputs_so_far.see(observation)
            inputs = inputs_so_far.scaled(observation)
            with torch.no_grad():
                distribution = agent.chosen(inputs)
                action = distribution.sample()
                step = inputs, action, distribution.log_prob(action).sum(1), agent.value(inputs).squeeze(1).numpy()
            observation, reward, terminated, truncated, info = envs.step(action.numpy())
            ended = terminated | truncated
            step_cost = info["cost"].copy()
            if ended.any():
                step_cost[ended] = info["final_info"]["cost"][ended]
            episode, cost = episode + reward, cost + step_cost
            over += [(episode[index], cost[index]) for index in np.flatnonzero(ended)]
            discounted = discounted * GAMMA + reward
            returns_so_far.see(discounted[:, None])
            scaled = np.clip(reward / np.sqrt(returns_so_far.variance[0] + 1e-8), -10, 10)
            if truncated.any():  # a time limit is no end of the task: add the value of the last state
                last = np.stack([info["final_obs"][index] for index in np.flatnonzero(truncated)])
                with torch.no_grad():
                    scaled[truncated] += GAMMA * agent.value(inputs_so_far.scaled(last)).squeeze(1).numpy()
            episode[ended] = cost[ended] = discounted[ended] = 0.0
            rollout.append((*step, scaled, ended.astype(float)))
        inputs, action, log_probability, values, rewards, ended = zip(*rollout, strict=True)
        with torch.no_grad():
            last = agent.value(inputs_so_far.scaled(observation)).squeeze(1).numpy()
        gain = advantages(np.array(rewards), np.array(values), np.array(ended), last)
        rows = torch.cat(inputs), torch.cat(action), torch.cat(log_probability), *(
            torch.as_tensor(values.reshape(-1), dtype=torch.float32) for values in (gain, gain + np.array(values))
        )
        update(agent, optimiser, rows)
        last_twenty += over
        if last_twenty:
            curve.append((done, *np.mean(last_twenty, axis=0).round(3).tolist()))
            print(f"{done:8} decisions, return {curve[-1][1]:8.1f}, cost {curve[-1][2]:.2f}", flush=True)
    with args.out.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(curve)


if __name__ == "__main__":
    main()
