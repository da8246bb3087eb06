"""Figures of docs/tasks/part.md: computing time of a part, and whether PPO learns on a small one.

python docs/make/part.py speed
python docs/make/part.py learn --steps 640

Each prints a line, and writes no file.
"""

import argparse
import tempfile
import time
from pathlib import Path

import gymnasium
import numpy as np

import edmsim
from edmsim.envs.part_task import ACTIONS
from edmsim.evaluation.episode import cut

ID = "edmsim/Part-v0"
USUAL = np.zeros(len(ACTIONS), np.float32)
SMALL = "G21 G90\nG92 X0.2 Y-0.42\nG41 D1 G1 X0.2 Y0\nG1 X0\nY0.3\nX0.4\nY0\nX0.2\nG40\nM2\n"
"""A punch of 0.4 x 0.3 mm, which is simulated in a second."""
MACHINE = {"passes": 2, "tab_mm": 0.0, "height_mm": 18.0, "tension_share": 1.0, "randomise": None}
PULSES = 255


def speed(episodes: int) -> str:
    """Cut parts with the technology's constants; return the text on their processor time."""
    env = gymnasium.make(ID)
    played(env, 0)  # compiles
    began, windows = time.process_time(), 0.0
    for seed in range(1, 1 + episodes):
        windows += played(env, seed)
    spent = time.process_time() - began
    return (
        f"{windows / spent:.0f} windows per second of processor time, {spent / episodes:.1f} s for an episode of "
        f"{windows / episodes:.0f} windows ({episodes} episodes)"
    )


def played(env: gymnasium.Env, seed: int) -> float:
    """Run an episode; return its number of windows."""
    env.reset(seed=seed)
    windows, over = 0.0, False
    while not over:
        *_, terminated, truncated, info = env.step(USUAL)
        windows += sum(info[kind] for kind in ("short", "open", "spark", "arc")) / PULSES
        over = terminated or truncated
    return windows


def learn(steps: int, seed: int) -> str:
    """Train PPO on a small part of one machine; return the text on returns of its first and last parts."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecNormalize

    class Returns(BaseCallback):
        """Stores the return of every part."""

        def __init__(self) -> None:
            super().__init__()
            self.made: list[float] = []

        def _on_step(self) -> bool:
            self.made += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
            return True

    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "small.ngc"
        program.write_text(SMALL, encoding="utf-8")
        options = {**MACHINE, "program": str(program)}
        vec_env = VecNormalize(edmsim.envs.make_sb3_vec_env(ID, 4, seed=seed, **options), gamma=1.0)
        model = PPO(
            "MlpPolicy", vec_env, n_steps=8, batch_size=32, n_epochs=10, gamma=1.0, learning_rate=2e-3, seed=seed,
            policy_kwargs={"log_std_init": -1.0, "net_arch": [32, 32]}, device="cpu",
        )  # fmt: skip
        returns = Returns()
        model.learn(steps, callback=returns)
        usual = np.mean([cut(ID, number, "technology", **options).total_return for number in range(8)])
    first, last = np.array(returns.made[:32]), np.array(returns.made[-32:])
    return (
        f"{len(returns.made)} parts: the first 32 earned {first.mean():.2f}, the last 32 {last.mean():.2f} "
        f"(standard error {last.std(ddof=1) / len(last) ** 0.5:.2f}); the technology's constants earn {usual:.2f}"
    )


def main() -> None:
    """Print the requested line."""
    parser = argparse.ArgumentParser(description="Figures of docs/tasks/part.md.")
    parser.add_argument("what", choices=["speed", "learn"])
    parser.add_argument("--episodes", type=int, default=6)
    parser.add_argument("--steps", type=int, default=640)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(speed(arguments.episodes) if arguments.what == "speed" else learn(arguments.steps, arguments.seed))


if __name__ == "__main__":
    main()
