"""Cost of recording an episode: processor time of a step of GapFeed, recorded and not, for docs/environments.md.

python docs/make/recording_cost.py
"""

import statistics
import time

import gymnasium
import numpy as np

import edmsim

STEPS, PAIRS = 300, 60
STILL = np.zeros(1, np.float32)


def step_us(env: edmsim.envs.EdmEnv, recorded: bool) -> float:
    """Return the processor time of a step in us, as mean over an episode's first steps."""
    env.reset(seed=1)
    recorder = env.recorder() if recorded else None
    start_s = time.process_time()
    for _ in range(STEPS):
        *_, info = env.step(STILL)
        if recorder is not None:
            recorder.step([0.0], info["reward_terms"], info["cost"], info["error_um"], info["area_mm2"])
    spent_s = time.process_time() - start_s
    if recorder is not None:
        recorder.stop()
    return 1e6 * spent_s / STEPS


def main() -> None:
    """Measure in pairs, because the computer's speed varies, and print."""
    env = gymnasium.make("edmsim/GapFeed-v2", disable_env_checker=True).unwrapped
    step_us(env, False)
    plain, recorded = zip(*((step_us(env, False), step_us(env, True)) for _ in range(PAIRS)), strict=True)
    ratio = statistics.median(b / a for a, b in zip(plain, recorded, strict=True))
    print(f"{min(plain):.0f} us, recorded {min(recorded):.0f} us; median of {PAIRS} ratios {ratio:.3f}")


if __name__ == "__main__":
    main()
