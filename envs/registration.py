"""Registers the environments by name; nothing of them is loaded before one is made."""

from __future__ import annotations

from gymnasium.envs.registration import register

EPISODE_STEPS = {"GapFeed": 1000, "HeightStep": 1000, "Corner": 3000, "Contour": 20_000}
"""Windows after which an episode is truncated: 25 s of machine time, where time is to end it; else about twice what a
cut takes at the reference rate (ours)."""


def register_all() -> None:
    """Register ``edmsim/GapFeed-v0`` and the others."""
    for name, steps in EPISODE_STEPS.items():
        register(
            id=f"edmsim/{name}-v0",
            entry_point="edmsim.envs.single:EdmEnv",
            vector_entry_point="edmsim.envs.vector:EdmVectorEnv",
            max_episode_steps=steps,
            kwargs={"task": name},
        )
