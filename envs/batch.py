"""Batch: actions, observations, rewards and infos of parallel episodes, all lanes at once."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs import observation
from edmsim.envs.lanes import Lanes, least_setting_us
from edmsim.envs.path_follower import RUNNING
from edmsim.envs.reward import TERMS, rewards
from edmsim.envs.task import Family
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

Floats = NDArray[np.float64]


def action_space_of(family: Family) -> gym.spaces.Box[np.float32]:
    """Return the action space, with one entry for each of `Family.action_names`."""
    return gym.spaces.Box(-1.0, 1.0, (len(family.action_names),), np.float32)


def observation_space_of(family: Family) -> gym.spaces.Box[np.float32]:
    """Return the observation space."""
    entries = observation.entries(family.history, family.knows_corners)
    low, high = (np.array([getattr(e, end) for e in entries], np.float32) for end in ("low", "high"))
    return gym.spaces.Box(low, high, dtype=np.float32)


class Batch:
    """Parallel episodes of one family, with what Gymnasium's environments show of them.

    Parameters
    ----------
    family : Family
    count : int
    threads : int

    Attributes
    ----------
    lanes : Lanes
    """

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family
        self.lanes = Lanes(family, count, threads)
        self._seen = np.zeros((count, family.history, len(observation.MEASURED)), np.float32)
        self._feed_um_s = np.zeros(count)
        self._weights = family.reward_weights.array()
        self._terms = np.zeros((len(TERMS), count))

    def begin(self, lane: int, rng: np.random.Generator, machine: Machine | None) -> dict[str, Any]:
        """Draw an episode and begin it; returns the info of the reset."""
        scenario = self.family.draw(rng, machine)
        self.lanes.begin(lane, scenario)
        self._seen[lane] = 0.0
        self._feed_um_s[lane] = self.family.first_feed_um_s
        return {
            "drawn": dict(scenario.drawn), "plant_seed": scenario.plant_seed,
            "total_um": float(self.lanes.rows[lane]["total_um"]),
        }

    def step(self, active: NDArray[np.int64], actions: NDArray[np.float32]) -> Floats:
        """Run a window in the active lanes; returns the rewards (n,), 0 in the others."""
        family, lanes = self.family, self.lanes
        wanted = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)  # np.clip takes four times as long
        limit = family.greatest_feed_um_s
        feed = np.minimum(np.maximum(family.next_feed_um_s(self._feed_um_s, wanted[:, 0]), -limit), limit)
        self._feed_um_s[active] = feed[active]
        if len(family.action_names) > 1:
            for lane in active:
                first_us = lanes.rows[lane]["first_setting_us"]
                self._set_generator(int(lane), *family.setting_us(first_us, wanted[lane, 1:]))
        lanes.advance(active, self._feed_um_s)
        windows = lanes.fleet.windows
        observation.see(active, lanes.rows, windows, family.max_feed_um_s, self._seen)
        reward, self._terms = rewards(active, lanes.rows, windows, self._weights)
        return reward

    def _set_generator(self, lane: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator; in place of a period that it refuses, the shortest that it accepts for the on-time."""
        lanes = self.lanes
        lanes.set_generator(lane, t_on_us, t_period_us)
        refused = lanes.refused[lane]
        if refused is not None:
            lanes.set_generator(lane, *least_setting_us(lanes.fleet.plants[lane].machine, t_on_us))
            lanes.refused[lane] = refused

    def observations(self) -> NDArray[np.float32]:
        """Return every lane's observation, in a fresh array."""
        flat = self._seen.reshape(len(self._seen), -1)
        if not self.family.knows_corners:
            return flat.copy()
        lanes = self.lanes
        place_um = lanes.rows["path_um"]
        return np.concatenate([flat, observation.corners(place_um, lanes.corner_um, lanes.corner_deg)], axis=1)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the numbers of `info`, in fresh arrays; no real machine knows gap, temperature, debris and error.

        ``gap_um`` has a meaning only where something ignited (see `ignited`).
        """
        lanes, rows = self.lanes, self.lanes.rows
        states, windows = lanes.fleet.states, lanes.fleet.windows
        counts, ignitions = windows["counts"], windows["ignitions"]
        return {
            "time_s": states["time_ns"] * 1e-9,
            "path_um": lanes.path_um,
            "feed_um_s": rows["feed_um_s"].copy(),
            "t_on_us": rows["setting_us"][:, 0].copy(),
            "t_period_us": rows["setting_us"][:, 1].copy(),
            "short": counts[:, SHORT].copy(),
            "open": counts[:, OPEN].copy(),
            "spark": counts[:, SPARK].copy(),
            "arc": counts[:, ARC].copy(),
            "gap_um": windows["gap_um"] / np.maximum(ignitions, 1),
            "wire_temperature_K": windows["temperature_max_K"].copy(),
            "debris": windows["debris"].copy(),
            "error_um": rows["error_um"].copy(),
            "area_mm2": rows["area_mm2"].copy(),
        }

    def reward_terms(self) -> dict[str, Floats]:
        """Return the terms of the last rewards by name, in fresh arrays (n,)."""
        return dict(zip(TERMS, self._terms.copy(), strict=True))

    def ignited(self) -> NDArray[np.bool_]:
        """Return for every lane (n,) whether a pulse of its last window ignited."""
        return np.asarray(self.lanes.fleet.windows["ignitions"] > 0)

    def words(self, lane: int) -> dict[str, str]:
        """Return the texts of one lane's `info`: why its episode ended, and what the generator refused."""
        words: dict[str, str] = {}
        cause = int(self.lanes.rows[lane]["cause"])
        if cause != RUNNING:
            words["cause"] = WORDS[StopCause(cause)].info
        refused = self.lanes.refused[lane]
        if refused is not None:
            words["refused"] = refused
        return words
