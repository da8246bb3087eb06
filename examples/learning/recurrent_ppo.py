"""Recurrent PPO of sb3-contrib: a policy with memory sees one window at a time.

python examples/learning/recurrent_ppo.py --seed 1 --out recurrent.csv

With ``history=1`` an observation has only the last window; an LSTM (Hochreiter and Schmidhuber 1997) must remember
properties of the machine and trends, such as more shorts. Its episodes in GapFeed have 8 s; the output table is that
of ppo.py. Needs the extra `rl`.
"""

import argparse
import csv
from collections import deque
from pathlib import Path

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from edmsim.envs import make_sb3_vec_env

NUM_ENVS, STEPS = 8, 128


class Curve(BaseCallback):
    """Mean return and cost of the last twenty episodes, after every rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple] = [("decisions", "return", "cost")]
        self._costs = [0.0] * NUM_ENVS
        self._last: deque[tuple[float, float]] = deque(maxlen=20)

    def _on_step(self) -> bool:
        for index, info in enumerate(self.locals["infos"]):
            self._costs[index] += info["cost"]
            if "episode" in info:  # of the monitor within make_sb3_vec_env
                self._last.append((info["episode"]["r"], self._costs[index]))
                self._costs[index] = 0.0
        return True

    def _on_rollout_end(self) -> None:
        if not self._last:
            return
        means = np.mean(self._last, axis=0).round(3).tolist()
        self.rows.append((self.num_timesteps, *means))
        print("{:8} decisions, return {:8.1f}, cost {:.2f}".format(*self.rows[-1]), flush=True)


def main() -> None:
    """Train, and write the learning curve."""
    parser = argparse.ArgumentParser(description="Recurrent PPO in edmsim/GapFeed-v2.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=20_480, help="decisions, all sub-environments together")
    parser.add_argument("--out", type=Path, required=True, help="table of the learning curve, .csv")
    arguments = parser.parse_args()
    if arguments.steps < NUM_ENVS * STEPS:
        parser.error(f"--steps {arguments.steps}: one rollout has {NUM_ENVS * STEPS} decisions; give as many or more")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # more threads do not help such small networks
    vec_env = make_sb3_vec_env(
        "edmsim/GapFeed-v2", NUM_ENVS, action="servo", servo_target_share=[0.0, 0.9], episode_s=8.0, history=1,
    )
    model = RecurrentPPO(
        "MlpLstmPolicy", VecNormalize(vec_env, gamma=0.99), seed=1000 * arguments.seed, device="cpu", n_steps=STEPS,
        batch_size=256, n_epochs=5, gamma=0.99, learning_rate=1e-3,
        policy_kwargs={"lstm_hidden_size": 32, "net_arch": [32], "log_std_init": -0.5},
    )
    curve = Curve()
    model.learn(arguments.steps // (NUM_ENVS * STEPS) * NUM_ENVS * STEPS, callback=curve)
    with arguments.out.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(curve.rows)


if __name__ == "__main__":
    main()
