"""Batch: actions, observations, rewards and infos of parallel episodes, all lanes at once."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.random import key_of
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs import servo
from edmsim.envs.knobs import least_setting_us
from edmsim.envs.lanes import Lanes
from edmsim.envs.observation_builder import ObservationBuilder
from edmsim.envs.path_follower import RUNNING
from edmsim.envs.reward import TERMS, StepRewards
from edmsim.envs.task import EnvArguments, Family
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import OPEN, SHORT

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def action_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the action space, with one entry for each of `EnvArguments.action_names`."""
    return gym.spaces.Box(-1.0, 1.0, (len(family.action_names),), np.float32)


def observation_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the observation space."""
    entries = family.entries()
    low, high = (np.array([getattr(e, end) for e in entries], np.float32) for end in ("low", "high"))
    return gym.spaces.Box(low, high, dtype=np.float32)


def reward_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the space of rewards: as many as objectives, or one."""
    return gym.spaces.Box(-np.inf, np.inf, (len(family.objectives) or 1,), np.float32)


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
    account : StepRewards
        Rewards, their terms and costs of the last step.
    """

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family
        self.lanes = Lanes(family, count, threads)
        self.builder = ObservationBuilder(family, count, family.measured_by)
        self._servos: NDArray[np.void] = np.zeros(count, servo.SERVO)
        self._feed_um_s = np.zeros(count)
        self._episodes = np.zeros(count, np.int64)
        self._constants: list[dict[str, float | str]] = [{} for _ in range(count)]
        self._terms = [TERMS.index(name) for name in family.objectives]
        self.account = self._fresh_account()

    def _fresh_account(self) -> StepRewards:
        family = self.family
        return StepRewards(family.reward_weights, family.error_bound_um, family.energy_bound_mJ, self.lanes.count)

    def change(self, family: EnvArguments) -> None:
        """Let episodes begun from now on be of another family, with the same spaces and plants of the same kind."""
        assert isinstance(family, Family)
        self.family = self.lanes.family = self.builder.family = family
        self.builder.sensors = family.measured_by
        self._episodes[:] = 0
        self.account = self._fresh_account()

    def begin(
        self, lane: int, rng: np.random.Generator, machine: Machine | None, *, anew: bool
    ) -> dict[str, Any]:
        """Begin an episode; returns the info of the reset.

        Parameters
        ----------
        lane : int
        rng : numpy.random.Generator
            The episode is drawn from it.
        machine : Machine or None
            Cut with this one.
        anew : bool
            Whether a machine is drawn whatever `Family.machine_episodes` says.
        """
        family, before = self.family, self.lanes.scenarios[lane]
        chosen = machine
        if chosen is None and before is not None and not anew and 0 < self._episodes[lane] < family.machine_episodes:
            chosen = before.machine
        scenario = family.draw(rng, chosen)
        if chosen is None:
            self._constants[lane] = {name: scenario.drawn[name] for name in family.drawn_constants}
        self._episodes[lane] = 0 if machine is not None else (self._episodes[lane] if chosen is not None else 0) + 1
        self.lanes.begin(lane, scenario)
        self.builder.begin(lane, self.lanes.rows[lane], scenario.machine, key_of(scenario.plant_seed + 1))
        self._begin_wire(lane)
        constants = self._constants[lane] if machine is None else {}
        return {
            "drawn": {**constants, **scenario.drawn}, "plant_seed": scenario.plant_seed,
            "total_um": float(self.lanes.rows[lane]["total_um"]),
        }

    def _begin_wire(self, lane: int) -> None:
        self._feed_um_s[lane] = self.family.first_feed_um_s
        servo.begin(self._servos[lane], self.family.first_feed_um_s)

    def clear(self) -> None:
        """Forget what the last step earned and cost."""
        self.account.begin()

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""
        return np.asarray(self.lanes.rows["cause"] != RUNNING)

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which lanes (n,) have cut for as long as an episode lasts."""
        return self.lanes.out_of_time

    def close(self) -> None:
        """Shut down the threads."""
        self.lanes.fleet.close()

    def step(self, active: Ints, actions: NDArray[np.float32]) -> Floats:
        """Run a step in the active lanes; returns the rewards (n,), or (n, objectives), 0 in the others."""
        lanes = self.lanes
        clamped = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)  # np.clip takes four times as long
        self.account.begin()
        self.builder.begin_step(active)
        lanes.rows["step_ns"][active] = 0
        self._command(active, clamped)
        wait_ns = round(self.family.decision_s * 1e9) if self.family.decision_s is not None else 0
        left = active
        while len(left):
            self._window(left)
            left = left[(lanes.rows["step_ns"][left] < wait_ns) & (lanes.rows["cause"][left] == RUNNING)]
        self.builder.end_step(active)
        return self.account.terms[self._terms].T.copy() if self._terms else self.account.total.copy()

    def _command(self, active: Ints, clamped: Floats) -> None:
        """Turn the knobs, and set the offsets, and the feed or the servos' targets."""
        family, lanes = self.family, self.lanes
        if family.knobs:
            for lane in active:
                first_us = lanes.rows[lane]["first_setting_us"]
                self._set_generator(int(lane), *family.setting_us(first_us, clamped[lane, 1 : 1 + len(family.knobs)]))
        if family.offset_um is not None:
            lanes.rows["offset_um"][active] = clamped[active, -1] * family.offset_um
        if family.action == "servo":
            self._servos["target"][active] = servo.target_of(clamped[active, 0], family.servo_target_share)
            return
        limit = family.greatest_feed_um_s
        feed = np.minimum(np.maximum(family.next_feed_um_s(self._feed_um_s, clamped[:, 0]), -limit), limit)
        self._feed_um_s[active] = feed[active]

    def _window(self, left: Ints) -> None:
        """Run a window in some lanes."""
        family, lanes, lost = self.family, self.lanes, self.lanes.rows["wires_lost"].copy()
        by_servo, settings_us = family.action == "servo", lanes.rows["setting_us"].copy()
        lanes.advance(left, self._servos["feed_um_s"].copy() if by_servo else self._feed_um_s)
        windows = lanes.fleet.windows
        self.builder.add(left, lanes.rows, windows)
        self.account.add(left, lanes.rows, lanes.counted_um, windows)
        if by_servo:
            shares = windows["counts"] / np.maximum(windows["counts"].sum(axis=1), 1)[:, None]
            servo.respond(
                left, self._servos, shares[:, SHORT], shares[:, OPEN], windows["duration_ns"] * 1e-9,
                family.greatest_feed_um_s, *family.servo_gains,
            )
        for lane in np.flatnonzero(lanes.rows["wires_lost"] != lost):
            self.builder.lose_wire(int(lane), lanes.rows[lane], tuple(settings_us[lane].tolist()))
            self._begin_wire(int(lane))

    def _set_generator(self, lane: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator; in place of a period that it refuses, the shortest that it accepts for the on-time."""
        lanes = self.lanes
        lanes.set_generator(lane, t_on_us, t_period_us)
        refused = lanes.refused[lane]
        if refused is not None:
            machine = lanes.fleet.plants[lane].machine
            lanes.set_generator(lane, *least_setting_us(machine, t_on_us, self.family.detents_us))
            lanes.refused[lane] = refused
        self.builder.take_scale(lane, lanes.rows[lane])

    def observations(self) -> NDArray[np.float32]:
        """Return every lane's observation, in a fresh array."""
        lanes = self.lanes
        return self.builder.observations(lanes.rows, lanes.corner_um, lanes.corner_deg)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return what `info` tells at every step, in fresh arrays; much of it no real machine knows.

        Counts and area are of the step, gap, temperature, debris and error of its last window; ``gap_um`` is -1
        where nothing ignited, as checkers take no NaN for another.
        """
        lanes, rows, shown = self.lanes, self.lanes.rows, self.builder.sums
        states, windows = lanes.fleet.states, lanes.fleet.windows
        ignitions = windows["ignitions"]
        return {
            "time_s": states["time_ns"] * 1e-9,
            "dt_s": rows["step_ns"] * 1e-9,
            "path_um": lanes.path_um,
            "feed_um_s": rows["feed_um_s"].copy(),
            "offset_um": rows["offset_um"].copy(),
            "t_on_us": rows["setting_us"][:, 0].copy(),
            "t_period_us": rows["setting_us"][:, 1].copy(),
            "energy_mJ": rows["energy_mJ"].copy(),
            "short": shown["short"].copy(),
            "open": shown["open"].copy(),
            "spark": shown["ignited"] - shown["arc"],
            "arc": shown["arc"].copy(),
            "gap_um": np.where(ignitions > 0, windows["gap_um"] / np.maximum(ignitions, 1), -1.0),
            "wire_temperature_K": windows["temperature_max_K"].copy(),
            "debris": windows["debris"].copy(),
            "error_um": rows["error_um"].copy(),
            "area_mm2": self.account.area_mm2.copy(),
            "wires_lost": rows["wires_lost"].copy(),
            "cost": self.account.cost.copy(),
        }

    def reward_terms(self) -> dict[str, Floats]:
        """Return the terms of the last rewards by name, in fresh arrays (n,)."""
        return dict(zip(TERMS, self.account.terms.copy(), strict=True))

    def words(self) -> dict[str, NDArray[Any]]:
        """Return the texts of `info` (n,): why the episode ended, what the generator refused; empty where nothing."""
        causes, refused = self.lanes.rows["cause"], self.lanes.refused
        words = {name: np.full(len(refused), "", object) for name in ("cause", "refused")}
        for lane in np.flatnonzero(causes != RUNNING):
            words["cause"][lane] = WORDS[StopCause(int(causes[lane]))].info
        for k, why in enumerate(refused):
            if why is not None:
                words["refused"][k] = why
        return words
