"""Batch: lanes as a learner meets them, with actions, observations, rewards and infos, all lanes at once."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.envs import observation
from edmsim.envs.lanes import CAUSES, Lanes, least_setting_us
from edmsim.envs.path_follower import RUNNING
from edmsim.envs.reward import rewards
from edmsim.envs.scenarios import Corner, Family
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

Floats = NDArray[np.float64]


def action_space_of(family: Family) -> gym.spaces.Box[np.float32]:
    """Return the action space: feed, and on-time and period where the generator is set, too."""
    return gym.spaces.Box(-1.0, 1.0, (3 if family.sets_generator else 1,), np.float32)


def observation_space_of(family: Family) -> gym.spaces.Box[np.float32]:
    """Return the observation space."""
    entries = observation.entries(family.history, family.knows_corners)
    low, high = (np.array([getattr(e, end) for e in entries], np.float32) for end in ("low", "high"))
    return gym.spaces.Box(low, high, dtype=np.float32)


def first_feed_um_s(family: Family) -> float:
    """Return the feed before the first action."""
    return family.start_feed_um_s if family.action == "change" else 0.0


def next_feed_um_s(family: Family, before_um_s: Floats, wanted: Floats) -> Floats:
    """Return the feeds that actions (n,) within -1..1 ask for after others (n,)."""
    if family.action == "speed":
        return wanted * family.max_feed_um_s
    limit = family.max_feed_um_s
    return np.asarray(np.clip(before_um_s + wanted * family.max_change_um_s, -limit, limit))


def next_setting_us(family: Corner, first_us: Floats, wanted: Floats) -> tuple[float, float]:
    """Return on-time and period that an action (2,) within -1..1 asks for, from those of the start (2,).

    The second entry turns the duty factor: were it the period, half of all pairs would ask for more than the supply
    gives.
    """
    on_us, period_us = first_us
    on, pause = (2.0 ** (family.setting_octaves * float(a)) for a in wanted)
    return on_us * on, period_us * on * pause


class Batch:
    """Lanes of one family with a learner's eyes and hands.

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

    def begin(self, lane: int, rng: np.random.Generator, machine: Machine | None) -> dict[str, Any]:
        """Draw an episode and begin it; returns the info of the reset."""
        scenario = self.family.draw(rng, machine)
        self.lanes.begin(lane, scenario)
        self._seen[lane] = 0.0
        self._feed_um_s[lane] = first_feed_um_s(self.family)
        return {
            "drawn": dict(scenario.drawn), "plant_seed": scenario.plant_seed,
            "total_um": float(self.lanes.rows[lane]["total_um"]),
        }

    def step(self, active: NDArray[np.int64], actions: NDArray[np.float32]) -> Floats:
        """Run a window in the active lanes; returns the rewards (n,), 0 in the others."""
        family, lanes = self.family, self.lanes
        wanted = np.clip(actions.astype(np.float64), -1.0, 1.0)
        limit = family.greatest_feed_um_s
        feed = np.clip(next_feed_um_s(family, self._feed_um_s, wanted[:, 0]), -limit, limit)
        self._feed_um_s[active] = feed[active]
        if isinstance(family, Corner):
            for lane in active:
                self._set_generator(int(lane), *next_setting_us(
                    family, lanes.rows[lane]["first_setting_us"], wanted[lane, 1:]
                ))
        lanes.advance(active, self._feed_um_s)
        windows = lanes.fleet.windows
        observation.see(
            active, lanes.rows, windows, family.max_feed_um_s, observation.LOW, observation.HIGH, self._seen
        )
        return rewards(active, lanes.rows, windows, self._weights)

    def _set_generator(self, lane: int, t_on_us: float, t_period_us: float) -> None:
        """Turn the knobs; a period that is refused, to the shortest that is not, so that the on-time counts."""
        lanes = self.lanes
        lanes.set_generator(lane, t_on_us, t_period_us)
        refused = lanes.refused[lane]
        if refused is not None:
            lanes.set_generator(lane, *least_setting_us(lanes.fleet.plants[lane].machine, t_on_us))
            lanes.refused[lane] = refused

    def observations(self) -> NDArray[np.float32]:
        """Return what every lane's learner sees, in a fresh array."""
        flat = self._seen.reshape(len(self._seen), -1)
        if not self.family.knows_corners:
            return flat.copy()
        lanes = self.lanes
        place_um = lanes.rows["path_um"]
        return np.concatenate([flat, observation.corners(place_um, lanes.corner_um, lanes.corner_deg)], axis=1)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return what is told beside, in fresh arrays: gap, temperature, debris and error no real machine knows.

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

    def ignited(self) -> NDArray[np.bool_]:
        """Say of every lane whether a pulse of its last window ignited."""
        return np.asarray(self.lanes.fleet.windows["ignitions"] > 0)

    def told(self, lane: int) -> dict[str, str]:
        """Return what is told in words of one lane: why its episode ended, and what the generator refused."""
        words = {}
        cause = int(self.lanes.rows[lane]["cause"])
        if cause != RUNNING:
            words["cause"] = CAUSES[cause]
        refused = self.lanes.refused[lane]
        if refused is not None:
            words["refused"] = refused
        return words
