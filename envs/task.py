"""Base of the environments: what all have in common, and how machine, stock and path of an episode are drawn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.planner.registry import kind_of, position_unit
from edmsim.envs import knobs as generator
from edmsim.envs import servo
from edmsim.envs.arguments import Range, above_zero, ends_of, machine_of, one_of, record_of, within
from edmsim.envs.draws import draw_machine, names_of
from edmsim.envs.reward import TERMS, Weights
from edmsim.envs.scenario import Scenario
from edmsim.envs.sensors import EXACT, Sensors
from edmsim.errors import InputError
from edmsim.given_numbers import keep_plain, whole_from
from edmsim.machine.machine import Machine
from edmsim.machine.setting import check_height
from edmsim.plant.plant import MECHANICS
from edmsim.plant.resolution import resolution

if TYPE_CHECKING:
    pass

Floats = NDArray[np.float64]

CORNER_DEG = 20.0
"""A path has a corner where it turns by at least this (ours: chords of arcs turn by less)."""
MAX_FEED_UM_S = 100.0
"""Feed an action of 1 may ask for (ours: about twice the cutting rate of the standard set-up 10 mm high)."""
MOST_OFFSET_UM = 100.0
"""Greatest offset from the path that may be asked for (ours: well beyond what a wire is bent by)."""
ROOM_MM = 2.5
"""Length of table that a cut leaves free before the end switches (ours)."""
ACTIONS = ("change", "speed", "servo")
LASTING = (
    "resolution", "mechanics", "planner", "action", "knobs", "offset_um", "sensors", "history", "objectives",
)  # fmt: skip
"""Arguments that decide on spaces and plants: they stay as long as the environment does."""


@dataclass(frozen=True, kw_only=True)
class Family(ABC):
    """Episodes of one kind: limits, what is drawn, what actions mean; its fields are an environment's arguments.

    A subclass says in `draw_cut` what is cut, and has `own_weights` and `own_machine`. `knows_corners` shows corners,
    `locates_discharges` where pulses ignite, `knows_wires` what the wires did; with `finishes_wall` errors are those
    of `Scenario.wall`, and not of the wire's place. An id's defaults are its benchmark.

    Parameters
    ----------
    resolution : {"fast", "default", "fine"}
        Resolution of the plant.
    mechanics : {"modal", "mujoco"}
        What moves table and wire; with MuJoCo friction, lost steps and backlash of the table count.
    planner : str
        What makes motor steps of path and feed (see `edmsim.controllers.planner.registry.make_planner`). ``exact``
        takes any feed and any corner. The others take feeds in units of 262.5 nm/s, 127 of them at most (33.3375
        um/s), whatever ``max_feed_um_s`` is, and round corners to whole um or steps.
    machine : Machine, optional
        The set-up; the environment's own if not given. What is drawn replaces its values.
    materials : sequence of str
        Workpiece materials to draw one from per episode; the machine's own if empty.
    height_mm, tension : float or (low, high), optional
        Greatest height of the workpiece in mm and wire tension in newton, or the range each is drawn from, uniformly,
        per episode; the machine's own if None (ours: sheet to die plate; what wires of 0.25 mm bear).
    randomise : sequence of str, optional
        Constants drawn per episode within their published ranges: sections or names of `Machine.sample`.
        ``()`` for all that have a range and an effect and are no dial of the operator (see `draws`), None for none.
    machine_episodes : int
        Episodes that a lane cuts with a machine before it draws another; a reset with a seed always draws.
    action : {"change", "speed", "servo"}
        Whether an action changes the feed, is the feed, or sets the target of a servo that makes the feed.
    knobs : sequence of str
        Knobs of the generator that further actions turn: see `knobs.KNOBS`.
    setting_octaves : float
        How far knobs turn either way: an action of 1 multiplies by 2 to the power of this.
    detents_us : (float, float)
        Steps of the knobs, on-time and period (ours: fine against what they change).
    offset_um : float, optional
        How far an action of 1 leads the guides to the left of the path, the last entry of an action; none if None.
    decision_s : float, optional
        Machine time between two actions: as many windows as begin within it, one at the least. One window if None.
    episode_s : float, optional
        Time of cutting after which an episode is truncated; none if None.
    wires : int
        Wires of an episode: after a break the next one is threaded where the last one broke, until none is left.
    max_feed_um_s, max_change_um_s : float
        Largest feed either way; with ``action="change"`` its largest change per step (ours: ten windows to retract).
    start_feed_um_s : float
        Feed before the first action, with ``action="change"``, and that a servo begins with (ours: below all rates).
    servo_target_share, servo_gains : (float, float)
        What actions of -1 and 1 ask a servo for, and how it answers: see `servo`.
    latency_s : float
        How long a new feed takes to count after a window's end, as a processor does in `edmsim cut`.
    sensors : Sensors, optional
        Noise, steps and delay of what is observed; none if None.
    history : int
        Steps in an observation, 1 or more.
    weights : Weights, optional
        Of the reward's terms; the family's own if not given.
    objectives : sequence of str
        Terms that a vector reward has, in order; a scalar reward, the sum of all terms, if empty.
    near_corner_um : float, optional
        Path errors count within this length of path before and behind a corner; everywhere if None.
    error_bound_um, energy_bound_mJ : float, optional
        Path error and energy of a discharge (which makes the roughness) beyond which a step has a cost.
    cost_limit : float
        Sum of ``info["cost"]`` over an episode that a safe learner keeps to in the mean (ours: a break in ten cuts).

    Raises
    ------
    InputError
        If a value cannot be used.
    """

    resolution: str = "fast"
    mechanics: str = "modal"
    planner: str = "poscal"
    machine: Machine | None = None
    materials: Sequence[str] = ()
    height_mm: Range | None = (4.0, 40.0)
    tension: Range | None = (8.0, 20.0)
    randomise: Sequence[str] | None = ()
    machine_episodes: int = 1
    action: Literal["change", "speed", "servo"] = "change"
    knobs: Sequence[str] = ()
    setting_octaves: float = 2.0
    detents_us: tuple[float, float] = (1.0, 5.0)
    offset_um: float | None = None
    decision_s: float | None = None
    episode_s: float | None = 25.0
    wires: int = 1
    max_feed_um_s: float = MAX_FEED_UM_S
    max_change_um_s: float = 4.0
    start_feed_um_s: float = 5.0
    servo_target_share: tuple[float, float] = servo.TARGET_SHARE
    servo_gains: tuple[float, float] = servo.GAINS
    latency_s: float = 0.0
    sensors: Sensors | None = None
    history: int = 4
    weights: Weights | None = None
    objectives: Sequence[str] = ()
    near_corner_um: float | None = None
    error_bound_um: float | None = None
    energy_bound_mJ: float | None = None
    cost_limit: float = 0.1

    knows_corners: ClassVar[bool] = False
    locates_discharges: ClassVar[bool] = False
    knows_wires: ClassVar[bool] = False
    finishes_wall: ClassVar[bool] = False
    own_weights: ClassVar[Weights] = Weights()

    @classmethod
    def of(cls, **arguments: Any) -> Self:
        """Make it from arguments that may be written as JSON writes them.

        Parameters
        ----------
        **arguments
            Its fields. ``machine`` may be a name under ``models/machines``, the path of an own TOML file, a
            mapping of arguments of `Machine.load`, or one that `plain` made of a machine; ``weights`` and ``sensors``
            mappings, which replace those they name of the environment's own; tuples may be lists.

        Raises
        ------
        InputError
            An unknown entry of a mapping, or a value that cannot be used.
        TypeError
            An unknown argument.
        """
        known = [f.name for f in fields(cls)]
        for name, value in arguments.items():
            if name not in known:
                raise TypeError(f"{cls.__name__} has no argument {name!r}; it has {', '.join(known)}")
            if isinstance(value, list):
                arguments[name] = tuple(value)
        if "machine" in arguments:
            arguments["machine"] = machine_of(arguments["machine"])
        for name, own in (("weights", cls.own_weights), ("sensors", Sensors())):
            if name in arguments:
                arguments[name] = record_of(name, arguments[name], own)
        return cls(**arguments)

    def changed(self, **arguments: Any) -> Self:
        """Return it with other arguments, in the forms of `of`.

        Raises
        ------
        InputError
            One of those that decide on spaces and plants: `LASTING`.
        TypeError
            An unknown argument.
        """
        for name in arguments:
            if name in LASTING:
                raise InputError(f"{name} cannot change between episodes: make another environment with it")
        now = {f.name: getattr(self, f.name) for f in fields(self)}
        return self.of(**{**now, **arguments})

    def __post_init__(self) -> None:
        """Refuse what cannot be used, before anything is built."""
        keep_plain(self)
        resolution(self.resolution)
        one_of("action", self.action, ACTIONS)
        one_of("mechanics", self.mechanics, MECHANICS)
        self._check_numbers()
        if self.height_mm is not None:
            for height in ends_of("height_mm", self.height_mm):
                check_height(height)
        if self.tension is not None:
            ends_of("tension", self.tension)
        for name in ("materials", "knobs", "objectives"):
            if isinstance(getattr(self, name), str):
                text = getattr(self, name)
                raise InputError(f"{name} is the text {text!r}: give a list, as [{text!r}]")
        generator.check_knobs(self.knobs)
        for term in self.objectives:
            one_of("objective", term, TERMS)
        self._grid_um(self.base)
        if self.drawn_constants:
            self.base.sample(np.random.default_rng(0), self.drawn_constants)

    def _check_numbers(self) -> None:
        for name in ("history", "wires", "machine_episodes"):
            whole_from(name, getattr(self, name), 1)
        for name in ("max_feed_um_s", "max_change_um_s"):
            above_zero(name, getattr(self, name))
        above_zero("setting_octaves", self.setting_octaves, generator.MOST_OCTAVES)
        for name in ("decision_s", "episode_s", "near_corner_um", "error_bound_um", "energy_bound_mJ"):
            if getattr(self, name) is not None:
                above_zero(name, getattr(self, name))
        for value in self.detents_us:
            above_zero("detents_us", value)
        if self.offset_um is not None:
            above_zero("offset_um", self.offset_um, MOST_OFFSET_UM)
        within("start_feed_um_s", self.start_feed_um_s, -self.max_feed_um_s, self.max_feed_um_s)
        for share in self.servo_target_share:
            within("servo_target_share", share, 0.0, 1.0)
        for gain in self.servo_gains:
            above_zero("servo_gains", gain)
        within("latency_s", self.latency_s, 0.0, 1.0)
        within("cost_limit", self.cost_limit, 0.0, 1e9)

    @cached_property
    def base(self) -> Machine:
        """The set-up before anything is drawn."""
        return self._bases[0]

    @staticmethod
    def own_machine() -> Machine:
        """Return the set-up where no other is given."""
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
        changed = [
            own.model_copy(update={"material": m.material, "material_name": m.material_name}) for m in loaded
        ]
        for machine in changed:
            machine.check()
        return tuple(changed)

    @cached_property
    def drawn_constants(self) -> tuple[str, ...]:
        """Names of the constants that an episode draws."""
        return names_of(self.base, self.randomise, self.mechanics)

    @property
    def action_names(self) -> tuple[str, ...]:
        """What each entry of an action is called."""
        last = () if self.offset_um is None else ("offset",)
        return ("target" if self.action == "servo" else "feed", *self.knobs, *last)

    @property
    def reach_mm(self) -> float:
        """Greatest distance from the table's centre that a cut may lead to."""
        return self.base.base.table.travel_mm.value / 2 - ROOM_MM

    @cached_property
    def reward_weights(self) -> Weights:
        """Weights in force."""
        return self.own_weights if self.weights is None else self.weights

    @cached_property
    def measured_by(self) -> Sensors:
        """Sensors in force."""
        return self.sensors or EXACT

    @property
    def first_feed_um_s(self) -> float:
        """Feed before the first action."""
        return 0.0 if self.action == "speed" else self.start_feed_um_s

    def next_feed_um_s(self, before_um_s: Floats, wanted: Floats) -> Floats:
        """Return the feeds (n,) that actions (n,) within -1..1 ask for after others (n,)."""
        if self.action == "speed":
            return wanted * self.max_feed_um_s
        limit = self.max_feed_um_s
        return np.asarray(np.minimum(np.maximum(before_um_s + wanted * self.max_change_um_s, -limit), limit))

    def setting_us(self, first_us: Floats, wanted: Floats) -> tuple[float, float]:
        """Return on-time and period in us that the actions on the knobs ask for.

        Parameters
        ----------
        first_us : (2,)
            On-time and period at the episode's start.
        wanted : (len(knobs),)
            Actions within -1..1.
        """
        first = float(first_us[0]), float(first_us[1])
        return generator.turned_us(self.knobs, self.setting_octaves, first, wanted.tolist())

    @cached_property
    def greatest_feed_um_s(self) -> float:
        """Greatest feed there can be: ``max_feed_um_s``, or the planner's own where that is less."""
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
        drawn: dict[str, float | str] = {}
        if machine is None:
            machine = draw_machine(rng, self._bases, self.drawn_settings, self.drawn_constants, drawn)
        drawn |= {"material": machine.material_name, "height_mm": machine.height_mm, "tension": machine.tension}
        seed = int(rng.integers(2**62))
        scenario = self.draw_cut(rng, machine, seed, drawn)
        grid = self._grid_um(scenario.machine)
        if not grid:
            return scenario
        return scenario._replace(legs_um=tuple(np.rint(leg / grid) * grid for leg in scenario.legs_um))

    @abstractmethod
    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Lay out stock and path for a machine.

        Parameters
        ----------
        rng : numpy.random.Generator
            Of whatever is drawn for the cut.
        machine : Machine
        seed : int
            Of the plant.
        drawn : dict
            What was drawn so far, by name; what is drawn here is added.
        """
