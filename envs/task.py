"""Base of the environments: what all have in common, and how machine, stock and path of an episode are drawn."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.planner.registry import kind_of, position_unit
from edmsim.envs.reward import Weights
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.setting import check_height
from edmsim.plant.resolution import resolution
from edmsim.plant.workpiece.kerf_field import Stock

if TYPE_CHECKING:
    from edmsim.program.path import WireContour

Floats = NDArray[np.float64]
Range = float | tuple[float, float]

CORNER_DEG = 20.0
"""A path has a corner where it turns by at least this (ours: chords of arcs turn by less)."""
MAX_FEED_UM_S = 100.0
"""Feed an action of 1 may ask for (ours: about twice the cutting rate of the standard set-up 10 mm high)."""
ROOM_MM = 2.5
"""Length of table that a cut leaves free before the end switches (ours)."""
_ACTIONS = ("change", "speed")


class Scenario(NamedTuple):
    """One episode before it begins.

    Attributes
    ----------
    machine : Machine
    stock : Stock
    legs_um : tuple of float64 arrays (k, 2)
        The wire's path, piece by piece; a fresh wire is threaded between two pieces.
    heights : (float64 array (m,), float64 array (m,))
        Lengths of path in um from which on the workpiece has another height, the first 0, and those heights in mm.
    plant_seed : int
    drawn : dict
        What was drawn for it, by name, for `info`.
    contours : tuple of WireContour
        The edges the part program draws, one for every leg; none where no program is cut.
    """

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: dict[str, float | str]
    contours: tuple[WireContour, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Family(ABC):
    """Episodes of one kind: limits, what is drawn, what actions mean. Every field is an argument of the environment.

    A subclass says in `draw_cut` what is cut. With `action_names` and `setting_us` it may let actions set the pulse
    generator, with `knows_corners` it shows the corners of the path, and `own_weights` are its weights of the reward.

    Parameters
    ----------
    resolution : {"fast", "default", "fine"}
        Resolution of the plant.
    machine : Machine, optional
        The set-up; the standard one if not given. What is drawn replaces its values.
    materials : sequence of str
        Workpiece materials, one of which is drawn per episode; the machine's own if empty.
    height_mm, tension : float or (low, high), optional
        Workpiece height in mm (the greatest one) and wire tension in newton, or the range each is drawn from,
        uniformly, per episode; the machine's own if not given.
    randomise : sequence of str, optional
        Constants drawn per episode within their published ranges: sections or names of `Machine.sample`.
        ``()`` for all that have a range.
    action : {"change", "speed"}
        Whether an action changes the feed or is the feed.
    max_feed_um_s : float
        Largest feed either way.
    max_change_um_s : float
        Largest change of the feed per window, with ``action="change"`` (ours: from the cutting rate to a
        retract within ten windows, a quarter of a second).
    start_feed_um_s : float
        Feed before the first action, with ``action="change"`` (ours: well below every cutting rate).
    history : int
        Windows in an observation, 1 or more.
    weights : Weights, optional
        Of the reward's terms; the family's own if not given.
    planner : str
        What makes motor steps of path and feed (see `edmsim.controllers.planner.registry.make_planner`). Those that
        count in integers take the feed in units of 262.5 nm/s and no more than 127 of them, 33.3375 um/s, whatever
        ``max_feed_um_s`` scales actions and observations by; corners of the path are rounded to what they count,
        whole um or steps, and what is drawn for it (turns, heights) stays as it was drawn. ``exact`` takes any feed
        and any corner.

    Raises
    ------
    InputError
        If a value cannot be used.
    """

    resolution: str = "default"
    machine: Machine | None = None
    materials: Sequence[str] = ()
    height_mm: Range | None = None
    tension: Range | None = None
    randomise: Sequence[str] | None = None
    action: Literal["change", "speed"] = "change"
    max_feed_um_s: float = MAX_FEED_UM_S
    max_change_um_s: float = 4.0
    start_feed_um_s: float = 5.0
    history: int = 4
    weights: Weights | None = None
    planner: str = "poscal"

    action_names: ClassVar[tuple[str, ...]] = ("feed",)
    knows_corners: ClassVar[bool] = False
    own_weights: ClassVar[Weights] = Weights()

    @classmethod
    def of(cls, **arguments: Any) -> Self:
        """Make it from arguments that may be written as JSON writes them.

        Parameters
        ----------
        **arguments
            Its fields. ``machine`` may be a name under ``models/machines``, the path of an own TOML file, or a
            mapping of arguments of `Machine.load`; ``weights`` a mapping, which replaces those it names of the
            environment's own; tuples may be lists.

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
            arguments["machine"] = _machine_of(arguments["machine"])
        weights = arguments.get("weights")
        if isinstance(weights, Mapping):
            _only_known("weights", weights, [f.name for f in fields(Weights)])
            arguments["weights"] = replace(cls.own_weights, **weights)
        return cls(**arguments)

    def __post_init__(self) -> None:
        """Refuse what cannot be used, before anything is built."""
        resolution(self.resolution)
        if self.action not in _ACTIONS:
            raise InputError(f"unknown action {self.action!r}; there are: {', '.join(_ACTIONS)}")
        if not isinstance(self.history, int) or self.history < 1:
            raise InputError(f"history is {self.history!r}: give a whole number of windows, 1 or more")
        for name in ("max_feed_um_s", "max_change_um_s"):
            above_zero(name, getattr(self, name))
        if not abs(self.start_feed_um_s) <= self.max_feed_um_s:
            raise InputError(f"start_feed_um_s is {self.start_feed_um_s!r}: give at most max_feed_um_s either way")
        for name in ("height_mm", "tension"):
            if getattr(self, name) is not None:
                ends_of(name, getattr(self, name))
        if self.height_mm is not None:
            for height in ends_of("height_mm", self.height_mm):
                check_height(height)
        if isinstance(self.materials, str):
            raise InputError(f"materials is the text {self.materials!r}: give a list, as [{self.materials!r}]")
        if self.randomise is not None:
            self.base.sample(np.random.default_rng(0), self.randomise or None)
        self._grid_um(self.base)

    @cached_property
    def base(self) -> Machine:
        """The set-up before anything is drawn."""
        return self._bases[0]

    @cached_property
    def _bases(self) -> tuple[Machine, ...]:
        """The set-up with each of the materials."""
        own = self.machine or Machine.load()
        if not self.materials:
            return (own,)
        loaded = [Machine.load(material=name) for name in self.materials]
        changed = [
            own.model_copy(update={"material": m.material, "material_name": m.material_name}) for m in loaded
        ]
        for machine in changed:
            machine.check()
        return tuple(changed)

    @property
    def reach_mm(self) -> float:
        """Greatest distance from the table's centre that a cut may lead to."""
        return self.base.base.table.travel_mm.value / 2 - ROOM_MM

    @cached_property
    def reward_weights(self) -> Weights:
        """Weights in force."""
        return self.own_weights if self.weights is None else self.weights

    @property
    def first_feed_um_s(self) -> float:
        """Feed before the first action."""
        return self.start_feed_um_s if self.action == "change" else 0.0

    def next_feed_um_s(self, before_um_s: Floats, wanted: Floats) -> Floats:
        """Return the feeds (n,) that actions (n,) within -1..1 ask for after others (n,)."""
        if self.action == "speed":
            return wanted * self.max_feed_um_s
        limit = self.max_feed_um_s
        return np.asarray(np.minimum(np.maximum(before_um_s + wanted * self.max_change_um_s, -limit), limit))

    def setting_us(self, first_us: Floats, wanted: Floats) -> tuple[float, float]:
        """Return on-time and period in us that the actions after the feed ask for.

        It is called where `action_names` has further names than the feed; the generator stays at its first setting
        unless a subclass says otherwise.

        Parameters
        ----------
        first_us : (2,)
            On-time and period at the episode's start.
        wanted : (len(action_names) - 1,)
            Actions within -1..1.
        """
        return float(first_us[0]), float(first_us[1])

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
            machine = self._draw_machine(rng, drawn)
        drawn |= {"material": machine.material_name, "height_mm": machine.height_mm, "tension": machine.tension}
        seed = int(rng.integers(2**62))
        scenario = self.draw_cut(rng, machine, seed, drawn)
        grid = self._grid_um(scenario.machine)
        if not grid:
            return scenario
        return scenario._replace(legs_um=tuple(np.rint(leg / grid) * grid for leg in scenario.legs_um))

    def _draw_machine(self, rng: np.random.Generator, drawn: dict[str, float | str]) -> Machine:
        machine = self._bases[int(rng.integers(len(self._bases)))]
        ranges = {name: ends_of(name, getattr(self, name)) for name in ("height_mm", "tension")
                  if getattr(self, name) is not None}
        if ranges:
            values = {name: float(rng.uniform(*bounds)) for name, bounds in ranges.items()}
            if any(values[name] != getattr(machine, name) for name in values):
                machine = machine.with_(**values)
        if self.randomise is not None:
            before = machine.uncertain()
            machine = machine.sample(rng, self.randomise or None)
            drawn |= {
                name: constant.value for name, constant in machine.uncertain().items()
                if constant.value != before[name].value
            }
        return machine

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


def even_height(machine: Machine) -> tuple[Floats, Floats]:
    """Return `Scenario.heights` of a workpiece of one height."""
    return np.zeros(1), np.array([machine.height_mm])


def above_zero(name: str, value: float, most: float = math.inf) -> None:
    """Refuse an argument that is no number above 0 and at most `most`."""
    if not (isinstance(value, int | float) and 0 < value <= most and math.isfinite(value)):
        up_to = f" and at most {most:g}" if math.isfinite(most) else ""
        raise InputError(f"{name} is {value!r}: give a number above 0{up_to}")


def ends_of(name: str, value: Range) -> tuple[float, float]:
    """Return the ends of a range given as an argument; a number is a range of its own."""
    low, high = value if isinstance(value, Sequence) and len(value) == 2 else (value, value)
    if not (isinstance(low, int | float) and isinstance(high, int | float) and 0 < low <= high < math.inf):
        raise InputError(f"{name} is {value!r}: give a number above 0, or the ends of a range, the lower first")
    return float(low), float(high)


def _machine_of(given: Any) -> Any:
    """Return the machine of a name, a file, or a mapping of arguments of `Machine.load`."""
    if isinstance(given, str | Path):
        return Machine.load(str(given))
    if not isinstance(given, Mapping):
        return given
    _only_known("machine", given, list(signature(Machine.load).parameters))
    return Machine.load(**given)


def _only_known(name: str, given: Mapping[str, Any], known: list[str]) -> None:
    for key in given:
        if key not in known:
            raise InputError(f"{name} has no entry {key!r}; it has {', '.join(known)}")
