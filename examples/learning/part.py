"""Train a policy for the passes of a part with stable-baselines3's PPO, and cut your own part with the model.

python examples/learning/part.py --steps 2000 --program examples/punch.ngc

There are few decisions, and each takes seconds to cut: PPO learns from batches of sixteen per sub-environment.
"""

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import edmsim


def main() -> None:
    """Train, then cut."""
    parser = argparse.ArgumentParser(description="Train who decides on the passes of a part, and cut one.")
    parser.add_argument("--steps", type=int, default=2000, help="decisions of the training")
    parser.add_argument("--num-envs", type=int, default=8, help="parts side by side")
    parser.add_argument("--passes", type=int, default=4, help="of every part")
    parser.add_argument("--program", help="part to cut at the end; default: that of the training")
    parser.add_argument("--tab-mm", type=float, default=0.6, help="its tab")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    env = gymnasium.make("edmsim/Part-v0", program=args.program, passes=args.passes, tab_mm=args.tab_mm)
    vec_env = edmsim.envs.make_sb3_vec_env("edmsim/Part-v0", args.num_envs, seed=args.seed, passes=args.passes)
    learnt_on = VecNormalize(vec_env, gamma=1.0)
    model = PPO("MlpPolicy", learnt_on, n_steps=16, batch_size=64, gamma=1.0, learning_rate=1e-3, seed=args.seed,
                policy_kwargs={"log_std_init": -1.0, "net_arch": [32, 32]}, device="cpu")  # fmt: skip
    model.learn(args.steps)

    observation, _ = env.reset(seed=args.seed)
    over = False
    while not over:
        action, _ = model.predict(learnt_on.normalize_obs(observation), deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        print(f"pass {info['pass']}: {info['dt_s']:.0f} s, action {np.round(action, 2)}, reward {reward:.2f}")
    made = f"error {info['error_um']:.1f} um, Ra {info['ra_um']:.2f} um, {info['wires_lost']} wires lost"
    print(f"{info['cause'] or 'out of time'}: {made}")


if __name__ == "__main__":
    main()
