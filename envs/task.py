"""Base of the environments: their common arguments, the initial state of an episode, and its random draws."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.planner.registry import kind_of, position_unit
from edmsim.envs import gap_servo, observation, reward
from edmsim.envs.arguments import Range, argument, check_kinds, ends_of, machine_of, record_of, record_of_arguments
from edmsim.errors import InputError, one_of, refuse_unknown
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import choose, values_of, with_constants
from edmsim.machine.setting import MOST_TIME_S, flushing_Pa, least_period_us, standoffs_mm
from edmsim.numeric import above_zero, whole_within, within
from edmsim.plant.plant import MECHANICS
from edmsim.plant.resolution import resolution
from edmsim.plant.workpiece.blanks import WallLine
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.program.path import WireContour

MOST_FEED_UM_S = 100_000.0
"""Greatest feed that is accepted, as in the files of machines."""
ENERGIES_MJ = 1e-6, 1e6  # range of ``energy_bound_mJ`` (ours: beyond all generators)
MAX_FEED_UM_S = 100.0
"""Feed for an action of 1 (ours: about twice the cutting rate of the standard set-up 10 mm high)."""
MOST_OFFSET_UM = 100.0
"""Greatest offset from the path that is accepted (ours: well beyond a wire's deflection)."""
ROOM_MM = 2.5  # length of table that a cut leaves free before the end switches (ours)
MOST_HISTORY = 10_000
"""Most steps in an observation (ours: those of a whole episode; they take some 600 kB)."""
MOST_DECISION_S = 3600.0
"""Longest time between two actions (ours: longer than any episode by far; its simulation takes some minutes)."""
KNOBS = {
    "on_time": "on-time over the first one",
    "period": "pulse period over the first one",
    "period_ratio": "period per on-time over the first ratio",
}
"""Knobs of the pulse generator with the ratio that an action sets, a power of 2 within `Family.setting_octaves`. Only
one of period and period ratio is possible, because it determines the other."""
MOST_OCTAVES = 4.0  # greatest reach of the knobs either way that is accepted (ours)
DETENTS_US = 1e-3, 1000.0  # least and greatest step of a knob (ours: a nanosecond, and the longest on-time)
LASTING = ("resolution", "mechanics", "planner", "action", "knobs", "offset_um", "sensors", "history", "objectives")
"""Arguments that determine spaces and plants, so they cannot change in an environment."""
Drawn = dict[str, float | str]
"""Drawn values of an episode by name, for `info`."""


class Drift(NamedTuple):
    """Changes of a machine within an episode, linear with machine time and not observed."""

    # time of the whole drift, and time from step to step
    over_s: float
    every_s: float
    conductivity_uS_cm: float  # final value of the water
    flushing_share: float  # final share of the nozzles' pressures at the workpiece

    def machine(self, machine: Machine, time_s: float) -> Machine:
        """Return the machine after a time."""
        share, water = min(time_s / self.over_s, 1.0), machine.base.dielectric.conductivity_uS_cm
        now = water.model_copy(update={"value": water.value + share * (self.conductivity_uS_cm - water.value)})
        left = 1.0 - share * (1.0 - self.flushing_share)
        lower_Pa, upper_Pa = flushing_Pa(machine)
        drifted = with_constants(machine, {"dielectric.conductivity_uS_cm": now})
        return drifted.with_(flushing_lower_Pa=left * lower_Pa, flushing_upper_Pa=left * upper_Pa)


class Scenario(NamedTuple):
    """Initial state of an episode."""

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]  # (k, 2): the wire's path, leg by leg; a wire is threaded between two legs
    # (m,): path lengths in um at which the height changes, the first 0, and the heights from there on in mm
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: Drawn
    # the edges of the part program, one for every leg; empty without a program
    contours: tuple[WireContour, ...] = ()
    wall: WallLine | None = None  # the wall to be finished by the only leg, along +x
    drift: Drift | None = None  # changes of the machine during the episode


def even_height(machine: Machine) -> tuple[Floats, Floats]:
    """Return `Scenario.heights` of a workpiece of one height."""
    return np.zeros(1), np.array([machine.height_mm])


# Constants of an episode's machine are drawn if they are uncertain; the operator's settings are not.
# What an operator sets, such as the pressure of the flushing, is not drawn: it keeps its value, which the
# observation contains. Constants without effect are not drawn either: friction and backlash of the table act only if
# MuJoCo steps the machine, bore and flow of the nozzles only if one has a stand-off; the rapid rate and the time for
# threading change only the time in which nothing is cut.

OPERATOR_SETTINGS = ("dielectric.flushing_pressure_Pa", "guides.wire_speed_m_s")
"""Constants with a range that an operator sets."""
DRY = ("table.friction_N", "table.presliding_um", "table.backlash_um")
"""Constants of the table that have an effect only with ``mechanics="mujoco"``."""
NOZZLES = ("dielectric.nozzle_mm", "dielectric.nozzle_flow_l_min")
"""Constants that have an effect only if a nozzle has a stand-off from the workpiece."""
_TIMES = ("table.rapid_um_s", "table.threading_s")


def names_of(machine: Machine, randomise: Sequence[str] | None, mechanics: str) -> tuple[str, ...]:
    """Return the constants that an episode draws: those of `randomise`, all for no names, and none for None."""
    if randomise is None:
        return ()
    without = _TIMES + (() if mechanics == "mujoco" else DRY) + (() if any(standoffs_mm(machine)) else NOZZLES)
    if not randomise:
        return tuple(name for name in machine.uncertain() if name not in (*without, *OPERATOR_SETTINGS))
    dead = [name for name in randomise if name in without or (name == "table" and mechanics != "mujoco")]
    if dead:
        raise InputError(
            f"randomise names {dead[0]!r}, which has no effect here: friction and backlash count with "
            'mechanics="mujoco" only, bore and flow of nozzles with a stand-off only, times of the table never'
        )
    return tuple(name for name in choose(machine, randomise) if name not in without)


class EnvArguments(ABC):
    """Arguments of an environment, as a frozen record, and what follows from them for its spaces.

    Episodes of a `Family` are decided on window by window; those of `edmsim.envs.part_task.Part` pass by pass.
    """

    own_weights: ClassVar[Any]
    lasting: ClassVar[tuple[str, ...]] = ()
    policy_arguments: ClassVar[tuple[str, ...]]
    """Arguments on which a policy depends: what it observes, what its actions mean, and when it acts."""
    resolution: str
    episode_s: float | None
    weights: Any
    objectives: Sequence[str]
    cost_limit: float

    @property
    @abstractmethod
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""

    @abstractmethod
    def entries(self) -> list[observation.Entry]:
        """Return every entry of an observation, in order."""

    @cached_property
    def reward_weights(self) -> Any:
        """Weights in force."""
        return self.own_weights if self.weights is None else self.weights

    def _check_reward(self, terms: Sequence[str]) -> None:
        for term in self.objectives:
            refuse_unknown("objective", term, terms)
        within("cost_limit", self.cost_limit, 0.0, 1e9)

    @classmethod
    def of(cls, **arguments: Any) -> Self:
        """Return the record of arguments, which may have the forms of JSON.

        ``machine`` may be a name under ``models/machines``, the path of your own TOML file, a mapping of arguments of
        `Machine.load`, or the result of `plain` for a machine; ``weights`` and ``sensors`` may be mappings, which
        override single values of the environment's own; tuples may be lists.
        """
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        for name, value in arguments.items():
            if name not in known:
                raise InputError(f"{cls.__name__} has no argument {name!r}; it has {one_of(name, known)}")
            if isinstance(value, list):
                arguments[name] = tuple(value)
        if "machine" in arguments:
            arguments["machine"] = machine_of(arguments["machine"])
        for name, own in (("weights", cls.own_weights), ("sensors", observation.Sensors())):
            if name in arguments:
                arguments[name] = record_of(name, arguments[name], own)
        return cls(**arguments)

    def changed(self, **arguments: Any) -> Self:
        """Return a copy with other arguments, in the forms of `of`; raises `InputError` for those in `lasting`."""
        for name in arguments:
            if name in self.lasting:
                raise InputError(f"{name} cannot change between episodes: make another environment with it")
        now = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return self.of(**{**now, **arguments})


@record_of_arguments
class Family(EnvArguments):
    """Episodes of one kind; its fields are the arguments of an environment.

    A subclass draws the cut in `draw_cut`, and has `own_weights` and `own_machine`. Its flags add entries to the
    observation: `knows_corners` the next corners, `locates_discharges` the places of ignition, `knows_wires` the
    history of the wires. With `counts_threading` the time of threading counts towards the episode's end; with
    `finishes_wall` errors are those of `Scenario.wall`, not of the wire. The defaults of an id are its benchmark.

    {parameters}

    Raises
    ------
    InputError
        If a value cannot be used.

    Notes
    -----
    `planner`: ``exact`` allows any feed and any corner. The others have feeds in units of 262.5 nm/s, at most 127 of
    them (33.3375 um/s), whatever ``max_feed_um_s`` is, and round corners to whole um or steps.

    `machine`: drawn values override its own, uniformly and per episode. ``randomise`` names sections or constants of
    `Machine.sample`; ``()`` draws all that have a published range and an effect and are not set by the operator (see
    `draws`). A reset with a seed always draws.

    `knobs`: see `KNOBS`; an action of 1 multiplies by 2 to the power of ``setting_octaves``.

    `decision_s`: all windows that begin within it are fired, at least one.

    `wires`: after a break the next wire is threaded where the last one broke, until the last wire breaks.

    `cost_limit`: a safe learner keeps the mean sum of ``info["cost"]`` over an episode below it.
    """

    resolution: str = argument("fast", "", "resolution of the plant: fast, default, fine")
    mechanics: str = argument("modal", "", "modal, or mujoco with friction and backlash")
    planner: str = argument("exact", "", "planner of the motor steps; exact has no greatest feed")
    machine: Machine | None = argument(None, "", "`Machine`, name, file, mapping; None: the task's own")
    materials: Sequence[str] = argument((), "", "names to draw one from; ``()``: the machine's own")
    # ours: from sheet to die plate, and usual tensions of a wire of 0.25 mm
    height_mm: Range | None = argument((4.0, 40.0), "mm", "greatest height, or (low, high); None: the machine's")
    tension: Range | None = argument((8.0, 20.0), "N", "tension, or (low, high); None: the machine's")
    randomise: Sequence[str] | None = argument((), "", "constants to draw; ``()`` for all, None for none")
    machine_episodes: int = argument(1, "", "episodes before another machine is drawn")
    action: Literal["change", "speed", "servo"] = argument(
        "change", "", "meaning of entry 0: change or speed of the feed, or servo"
    )
    knobs: Sequence[str] = argument((), "", "further actions: on_time, period or period_ratio")
    setting_octaves: float = argument(2.0, "octaves", "reach of the knobs either way, at most 4")
    detents_us: tuple[float, float] = argument(
        (1.0, 5.0), "us", "steps of the knobs: on-time, period"  # ours: small against the settings
    )
    offset_um: float | None = argument(None, "um", "offset of an action of 1; None: no such action")
    decision_s: float | None = argument(None, "s", "machine time between actions; None: a window")
    episode_s: float | None = argument(25.0, "s", "time after which an episode is truncated")
    wires: int = argument(1, "", "number of wires of an episode")
    max_feed_um_s: float = argument(MAX_FEED_UM_S, "um/s", "largest feed either way")
    max_change_um_s: float = argument(
        4.0, "um/s", "largest change of the feed per step"  # ours: ten windows to retract
    )
    start_feed_um_s: float = argument(5.0, "um/s", "feed before the first action")  # ours: below all rates
    servo_target_share: tuple[float, float] = argument(
        gap_servo.TARGET_SHARE, "", "targets of the servo at actions of -1 and 1"
    )
    servo_gains: tuple[float, float] = argument(gap_servo.GAINS, "", "um/s, and um/s per s, per unit of its error")
    latency_s: float = argument(0.0, "s", "delay of a new feed, a window at most")
    sensors: observation.Sensors | None = argument(None, "", "`Sensors` or a mapping: noise, steps, delay")
    history: int = argument(4, "steps", "number of steps in an observation")
    weights: reward.Weights | None = argument(None, "", "`Weights`, or a mapping of weights to change")
    objectives: Sequence[str] = argument((), "", "terms of a vector reward; ``()``: a scalar")
    near_corner_um: float | None = argument(None, "um", "path near corners where errors count; None: all")
    error_bound_um: float | None = argument(None, "um", "path error beyond which time costs")
    energy_bound_mJ: float | None = argument(None, "mJ", "energy of a discharge beyond which it costs")
    cost_limit: float = argument(0.1, "", "limit of an episode's mean cost")  # ours: a break in ten cuts

    knows_corners: ClassVar[bool] = False
    locates_discharges: ClassVar[bool] = False
    knows_wires: ClassVar[bool] = False
    counts_threading: ClassVar[bool] = False
    finishes_wall: ClassVar[bool] = False
    own_weights: ClassVar[reward.Weights] = reward.Weights()
    lasting: ClassVar[tuple[str, ...]] = LASTING
    policy_arguments: ClassVar[tuple[str, ...]] = (
        "action", "knobs", "setting_octaves", "detents_us", "offset_um", "decision_s", "episode_s", "wires",
        "max_feed_um_s", "max_change_um_s", "start_feed_um_s", "servo_target_share", "servo_gains", "history",
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Raise `InputError` for a value that cannot be used, before anything is built."""
        check_kinds(self)
        resolution(self.resolution)
        refuse_unknown("mechanics", self.mechanics, MECHANICS)
        self._check_numbers()
        self._check_knobs()
        self._check_reward(reward.TERMS)
        self._grid_um(self.base)
        self._check_draws()

    def _check_numbers(self) -> None:
        whole_within("history", self.history, 1, MOST_HISTORY)
        for name in ("wires", "machine_episodes"):
            whole_within(name, getattr(self, name), 1, 10**9)
        for name in ("max_feed_um_s", "max_change_um_s"):
            above_zero(name, getattr(self, name), MOST_FEED_UM_S)
        above_zero("setting_octaves", self.setting_octaves, MOST_OCTAVES)
        for name, most in (
            ("decision_s", MOST_DECISION_S), ("episode_s", MOST_TIME_S), ("near_corner_um", math.inf),
            ("error_bound_um", math.inf), ("offset_um", MOST_OFFSET_UM),
        ):  # fmt: skip
            if getattr(self, name) is not None:
                above_zero(name, getattr(self, name), most)
        if self.energy_bound_mJ is not None:
            within("energy_bound_mJ", self.energy_bound_mJ, *ENERGIES_MJ)
        for value in self.detents_us:
            within("detents_us", value, *DETENTS_US)
        within("start_feed_um_s", self.start_feed_um_s, -self.max_feed_um_s, self.max_feed_um_s)
        for share in self.servo_target_share:
            within("servo_target_share", share, 0.0, 1.0)
        if self.servo_target_share[0] == self.servo_target_share[1]:
            raise InputError(f"servo_target_share is {self.servo_target_share!r}: give two that differ")
        for gain in self.servo_gains:
            above_zero("servo_gains", gain)
        within("latency_s", self.latency_s, 0.0, 1.0)

    def _check_knobs(self) -> None:
        """Raise `InputError` for an unknown or repeated knob, and for both period and period ratio."""
        for name in self.knobs:
            refuse_unknown("knob", name, KNOBS)
        if len(set(self.knobs)) != len(self.knobs) or {"period", "period_ratio"} <= set(self.knobs):
            raise InputError(
                f"knobs are {', '.join(self.knobs)}: name each once, and period or period_ratio, not both"
            )

    def _check_draws(self) -> None:
        """Raise `InputError` for a range with an end that the machine refuses, before a reset draws it."""
        ranges = {name: ends_of(name, value) for name, value in self.drawn_settings.items() if value is not None}
        for base in self._bases:
            for name, ends in ranges.items():
                for end in ends:
                    try:
                        base.with_(**{name: end})
                    except InputError as error:
                        raise InputError(f"{name} is {ends}: {error.reason}; None takes the machine's own") from None
            if self.drawn_constants:
                most = base.with_(**{name: high for name, (_, high) in ranges.items()})
                most.sample(np.random.default_rng(0), self.drawn_constants)

    @cached_property
    def base(self) -> Machine:
        """The set-up before anything is drawn."""
        return self._bases[0]

    @staticmethod
    def own_machine() -> Machine:
        """Return the default set-up."""
        return Machine.load()

    @property
    def drawn_settings(self) -> dict[str, Range | None]:
        """Ranges of the operator's choices that an episode draws, by name."""
        return {"height_mm": self.height_mm, "tension": self.tension}

    @cached_property
    def _bases(self) -> tuple[Machine, ...]:
        """The set-up with each of the materials."""
        own = self.machine or self.own_machine()
        if not self.materials:
            return (own,)
        loaded = [Machine.load(material=name) for name in self.materials]
        changed = [own.model_copy(update={"material": m.material, "material_name": m.material_name}) for m in loaded]
        for machine in changed:
            machine.check()
        return tuple(changed)

    @cached_property
    def drawn_constants(self) -> tuple[str, ...]:
        """Names of the constants that an episode draws."""
        return names_of(self.base, self.randomise, self.mechanics)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        last = () if self.offset_um is None else ("offset",)
        return ("target" if self.action == "servo" else "feed", *self.knobs, *last)

    @property
    def step_entries(self) -> tuple[observation.Entry, ...]:
        """Entries of one step in an observation."""
        return observation.MEASURED + (observation.FIFTHS if self.locates_discharges else ())

    @property
    def known_entries(self) -> tuple[observation.Entry, ...]:
        """Entries after those of the set-up."""
        offset = () if self.offset_um is None else (observation.OFFSET,)
        corners = observation.CORNERS if self.knows_corners else ()
        return (*corners, *offset, *(observation.WIRES if self.knows_wires else ()))

    def entries(self) -> list[observation.Entry]:
        """Return every entry of an observation, in order."""
        steps = [
            entry._replace(name=f"{entry.name}[{-age}]" if age else entry.name)
            for age in range(self.history) for entry in self.step_entries
        ]  # fmt: skip
        return [*steps, *observation.SETUP_ENTRIES, *self.known_entries]

    @property
    def reach_mm(self) -> float:
        """Greatest distance from the table's centre that a cut may reach."""
        return self.base.base.table.travel_mm.value / 2 - ROOM_MM

    @property
    def least_mm(self) -> float:
        """Shortest piece of a path: a unit of the planner, or the shortest that `Course` keeps (ours)."""
        return max(5e-4, self._grid_um(self.base) * 1e-3)

    @cached_property
    def measured_by(self) -> observation.Sensors:
        """Sensors in force."""
        return self.sensors or observation.EXACT

    @property
    def scrap_s(self) -> float:
        """Time at the start of an episode in which the cut is scrap, with a reward of 0 for its area."""
        return 0.0

    @property
    def first_feed_um_s(self) -> float:
        """Feed before the first action."""
        return 0.0 if self.action == "speed" else self.start_feed_um_s

    def next_feed_um_s(self, before_um_s: Floats, actions: Floats) -> Floats:
        """Return the feeds (n,) for actions (n,) within -1..1, after the feeds before (n,)."""
        if self.action == "speed":
            return actions * self.max_feed_um_s
        limit = self.max_feed_um_s
        return np.asarray(np.minimum(np.maximum(before_um_s + actions * self.max_change_um_s, -limit), limit))

    def setting_us(self, first_us: Floats, actions: Floats) -> tuple[float, float]:
        """Return on-time and period in us for the actions on the knobs.

        Parameters
        ----------
        first_us : (2,)
            On-time and period at the episode's start.
        actions : (len(knobs),)
            Actions within -1..1.
        """
        turned = zip(self.knobs, actions.tolist(), strict=True)
        factor = {name: 2.0 ** (self.setting_octaves * float(action)) for name, action in turned}
        on_us, period_us = float(first_us[0]), float(first_us[1])
        on_us *= factor.get("on_time", 1.0)
        if "period_ratio" in factor:
            return on_us, period_us * factor.get("on_time", 1.0) * factor["period_ratio"]
        return on_us, period_us * factor.get("period", 1.0)

    def to_detents(self, t_on_us: float, t_period_us: float) -> tuple[float, float]:
        """Return the nearest setting that the knobs have."""
        on_step, period_step = self.detents_us
        return _detent(round(t_on_us / on_step), on_step), _detent(round(t_period_us / period_step), period_step)

    def least_setting_us(self, machine: Machine, t_on_us: float) -> tuple[float, float]:
        """Return an on-time with the shortest period that the supply allows for it, both in detents."""
        on_step, period_step = self.detents_us
        on = _detent(round(t_on_us / on_step), on_step)
        return on, _detent(math.ceil(least_period_us(machine, on) / period_step - 1e-9), period_step)

    @cached_property
    def greatest_feed_um_s(self) -> float:
        """Greatest possible feed: the lesser of ``max_feed_um_s`` and the planner's own."""
        return min(self.max_feed_um_s, kind_of(self.planner).max_feed_um_s)

    def _grid_um(self, machine: Machine) -> int:
        """Unit in which the planner counts on a machine's table; 0 if it does not count."""
        table = machine.base.table
        unit = position_unit(self.planner, table.travel_mm.value * 1e3, table.step_um.value)
        return unit_um(unit, round(table.step_um.value)) if kind_of(self.planner).counts else 0

    def draw(self, rng: np.random.Generator, machine: Machine | None = None) -> Scenario:
        """Draw an episode.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same episode.
        machine : Machine, optional
            Cut with this one; nothing of the machine is drawn then.
        """
        drawn: Drawn = {}
        if machine is None:
            machine = self._draw_machine(rng, drawn)
        drawn |= {"material": machine.material_name, "height_mm": machine.height_mm, "tension": machine.tension}
        seed = int(rng.integers(2**62))
        scenario = self._checked(self.draw_cut(rng, machine, seed, drawn))
        grid = self._grid_um(scenario.machine)
        if not grid:
            return scenario
        return scenario._replace(legs_um=tuple(np.rint(leg / grid) * grid for leg in scenario.legs_um))

    def _draw_machine(self, rng: np.random.Generator, drawn: Drawn) -> Machine:
        machine = self._bases[int(rng.integers(len(self._bases)))]
        bounds = {name: ends_of(name, value) for name, value in self.drawn_settings.items() if value is not None}
        values = {name: float(rng.uniform(*ends)) for name, ends in bounds.items()}
        if any(values[name] != getattr(machine, name) for name in values):
            machine = machine.with_(**values)
        if self.drawn_constants:
            machine = machine.sample(rng, self.drawn_constants)
            drawn |= values_of(machine, self.drawn_constants)
        return machine

    def _checked(self, scenario: Any) -> Scenario:
        """Return the scenario of `draw_cut`, which may be a user's; raises `InputError` if it is invalid."""
        returned = f"{type(self).__name__}.draw_cut returns"
        if not isinstance(scenario, Scenario) or not isinstance(scenario.machine, Machine):
            raise InputError(f"{returned} {scenario!r}: give a Scenario with a Machine")
        legs, heights, greatest_mm = _arrays(scenario.legs_um), _arrays(scenario.heights), scenario.machine.height_mm
        if not legs or any(leg.ndim != 2 or leg.shape[1] != 2 or not np.isfinite(leg).all() for leg in legs):
            raise InputError(f"{returned} legs_um {scenario.legs_um!r}: give arrays (n, 2) of finite numbers")
        if not _are_heights(heights, greatest_mm):
            raise InputError(
                f"{returned} heights {scenario.heights!r}: give lengths of path in um, the first 0 and each "
                f"greater than the last, and as many heights up to the machine's, {greatest_mm:g} mm"
            )
        return scenario._replace(legs_um=tuple(legs), heights=(heights[0], heights[1]))

    @abstractmethod
    def draw_cut(self, rng: np.random.Generator, machine: Machine, seed: int, drawn: Drawn) -> Scenario:
        """Lay out stock and path for a machine.

        Parameters
        ----------
        rng : numpy.random.Generator
            Generator of the cut's random draws.
        machine : Machine
        seed : int
            Seed of the plant.
        drawn : dict
            Values drawn so far, by name; add those drawn here.
        """


def _arrays(values: Any) -> list[Floats]:
    """Return arrays of numbers as float64; an empty list if they are something else."""
    try:
        return [np.asarray(each, np.float64) for each in values]
    except (TypeError, ValueError):
        return []


def _are_heights(heights: list[Floats], greatest_mm: float) -> bool:
    """Return whether arrays are valid `Scenario.heights` of a workpiece."""
    if len(heights) != 2 or heights[0].ndim != 1 or heights[0].shape != heights[1].shape or not heights[0].size:
        return False
    from_um, heights_mm = heights
    rises = from_um[0] == 0.0 and (np.diff(from_um) > 0.0).all()
    return bool(rises and ((heights_mm > 0.0) & (heights_mm <= greatest_mm)).all())


def _detent(number: int, step_us: float) -> float:
    """Return a detent as a decimal number: 7 steps of 0.2 us are 1.4 us, which is not exactly their product."""
    return round(number * step_us, 9)
