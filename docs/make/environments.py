"""``docs/environment.png``: what ``render()`` shows of an environment.

    python docs/make/environments.py

A servo cuts the corner of ``edmsim/Corner-v1``, on the machine that seed 1 draws, past its turn.
"""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
from PIL import Image

import edmsim  # registers the environments

DOCS = Path(__file__).parents[1]
PAST_UM = 200.0
"""How far before the end of the path the picture is taken."""


def main() -> None:
    """Cut, and write the picture."""
    env = gymnasium.make("edmsim/Corner-v1", action="servo", render_mode="rgb_array")
    _, info = env.reset(seed=1)
    end_um, over = info["total_um"], False
    while not over and info.get("path_um", 0.0) < end_um - PAST_UM:
        *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
        over = terminated or truncated
    Image.fromarray(np.asarray(env.render())).save(DOCS / "environment.png", optimize=True)
    print(f"edmsim {edmsim.__version__}: {info['path_um']:.0f} um cut in {info['time_s']:.1f} s")


if __name__ == "__main__":
    main()
