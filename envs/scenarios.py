"""What the environments ask for: four families of cuts, and the machine, stock and path drawn for an episode."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.reward import Weights
from edmsim.errors import InputError
from edmsim.machine.machine import Machine, check_height
from edmsim.plant.resolution import resolution
from edmsim.plant.workpiece.height_steps import HeightStep as Step
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.plant.workpiece.start_slot import SLOT_GAP_UM, begun_slot

if TYPE_CHECKING:
    from edmsim.program.path import Contour as ProgramContour
    from edmsim.program.path import CutPath

Floats = NDArray[np.float64]
Range = float | tuple[float, float]

CENTRE_UM = (32_500.0, 32_500.0)
"""Where straight cuts and corners begin: the middle of the table."""
CORNER_DEG = 20.0
"""A path has a corner where it turns by at least this (ours: chords of arcs turn by less)."""
MAX_FEED_UM_S = 100.0
"""Feed an action of 1 may ask for (ours: about twice the cutting rate of the standard set-up 10 mm high)."""
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
    contours : tuple of Contour
        The edges the part program draws, one for every leg; none where no program is cut.
    """

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: dict[str, float | str]
    contours: tuple[ProgramContour, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Family(ABC):
    """What is common to the four families; every field is an argument of the environments.

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

    sets_generator: ClassVar[bool] = False
    knows_corners: ClassVar[bool] = False
    own_weights: ClassVar[Weights] = Weights()

    def __post_init__(self) -> None:
        """Refuse what cannot be used, before anything is built."""
        resolution(self.resolution)
        if self.action not in _ACTIONS:
            raise InputError(f"unknown action {self.action!r}; there are: {', '.join(_ACTIONS)}")
        if not isinstance(self.history, int) or self.history < 1:
            raise InputError(f"history is {self.history!r}: give a whole number of windows, 1 or more")
        for name in ("max_feed_um_s", "max_change_um_s"):
            _above_zero(name, getattr(self, name))
        if not abs(self.start_feed_um_s) <= self.max_feed_um_s:
            raise InputError(f"start_feed_um_s is {self.start_feed_um_s!r}: give at most max_feed_um_s either way")
        for name in ("height_mm", "tension"):
            if getattr(self, name) is not None:
                _bounds(name, getattr(self, name))
        if self.height_mm is not None:
            for height in _bounds("height_mm", self.height_mm):
                check_height(height)
        if isinstance(self.materials, str):
            raise InputError(f"materials is the text {self.materials!r}: give a list, as [{self.materials!r}]")
        if self.randomise is not None:
            self.base.sample(np.random.default_rng(0), self.randomise or None)

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

    @cached_property
    def reward_weights(self) -> Weights:
        """Weights in force."""
        return self.own_weights if self.weights is None else self.weights

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
        return self.draw_cut(rng, machine, seed, drawn)

    def _draw_machine(self, rng: np.random.Generator, drawn: dict[str, float | str]) -> Machine:
        machine = self._bases[int(rng.integers(len(self._bases)))]
        ranges = {name: _bounds(name, getattr(self, name)) for name in ("height_mm", "tension")
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


@dataclass(frozen=True, kw_only=True)
class GapFeed(Family):
    """A straight cut from a begun slot: hold the gap, as fast as the machine can.

    Parameters
    ----------
    length_mm : float
        Length of the cut (ours: longer than the standard episode, so that time ends it and the return grows with
        the cutting rate).
    """

    length_mm: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _above_zero("length_mm", self.length_mm, 30.0)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """A straight path into the slot's end."""
        path = _straight(self.length_mm)
        return Scenario(machine, begun_slot(machine, CENTRE_UM), (path,), _even(machine), seed, drawn)


@dataclass(frozen=True, kw_only=True)
class HeightStep(GapFeed):
    """A straight cut through a workpiece whose height jumps, the classic wire breaker.

    Parameters
    ----------
    band_mm : (low, high)
        Lengths of path between two jumps (ours: a few seconds of cutting each).
    low_share : float
        Least local height as a share of the greatest, 0.2 to 1.
    """

    band_mm: tuple[float, float] = (0.1, 0.3)
    low_share: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        for length in _bounds("band_mm", self.band_mm):
            _above_zero("band_mm", length)
        if not 0.2 <= self.low_share <= 1:
            raise InputError(f"low_share is {self.low_share!r}: give a share from 0.2 to 1")

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """The same, and jumps of height across it."""
        import shapely

        x, y = CENTRE_UM
        total = self.length_mm * 1e3
        starts, heights, at = [0.0], [machine.height_mm], float(rng.uniform(*self.band_mm)) * 1e3
        while at < total:
            starts.append(at)
            heights.append(machine.height_mm * float(rng.uniform(self.low_share, 1.0)))
            at += float(rng.uniform(*self.band_mm)) * 1e3
        ends = [*starts[1:], total + 2e3]  # the last band reaches beyond what the wire erodes
        x += machine.wire_diameter_um / 2 + SLOT_GAP_UM  # where the wire's front meets a jump
        steps = [
            Step(shapely.box(x + a, y - 2e3, x + b, y + 2e3), h)
            for a, b, h in zip(starts[1:], ends[1:], heights[1:], strict=True)
        ]
        drawn |= {"height_jumps": float(len(steps))}
        stock = begun_slot(machine, CENTRE_UM, steps=steps)
        profile = np.array(starts), np.array(heights)
        return Scenario(machine, stock, (_straight(self.length_mm),), profile, seed, drawn)


@dataclass(frozen=True, kw_only=True)
class Corner(Family):
    """Two legs with a sharp turn between; the action sets the pulse generator, too, and profile error counts.

    Parameters
    ----------
    leg_mm : float
        Length of each leg.
    turn_deg : (low, high)
        Range of the turn, drawn per episode, to the left or to the right.
    setting_octaves : float
        How far the knobs turn either way: an action of 1 multiplies the on-time, or the ratio of period to on-time,
        by 2 to the power of this.
    """

    leg_mm: float = 0.3
    turn_deg: tuple[float, float] = (45.0, 135.0)
    setting_octaves: float = 2.0

    sets_generator: ClassVar[bool] = True
    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=4.0, time=0.1)  # accuracy first

    def __post_init__(self) -> None:
        super().__post_init__()
        _above_zero("leg_mm", self.leg_mm, 15.0)
        _above_zero("setting_octaves", self.setting_octaves, 4.0)
        low, high = _bounds("turn_deg", self.turn_deg)
        if not CORNER_DEG <= low <= high <= 160.0:
            raise InputError(f"turn_deg is {self.turn_deg!r}: give a range within {CORNER_DEG:g} to 160 degrees")

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Two legs and a turn."""
        turn = float(rng.uniform(*self.turn_deg)) * (1 if rng.random() < 0.5 else -1)
        leg, (x, y) = self.leg_mm * 1e3, CENTRE_UM
        angle = math.radians(turn)
        path = np.array(
            [(x, y), (x + leg, y), (x + leg + leg * math.cos(angle), y + leg * math.sin(angle))], np.float64
        )
        drawn |= {"turn_deg": turn}
        return Scenario(machine, begun_slot(machine, CENTRE_UM), (path,), _even(machine), seed, drawn)


@dataclass(frozen=True, kw_only=True)
class Contour(Family):
    """Any part program.

    Parameters
    ----------
    program : path, optional
        Of `edmsim.program.path.plan_path`; a punch of 1.5 x 1 mm if not given. Dwells (G4) are left out.
    """

    program: str | Path | None = None

    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=1.0, time=0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._cut  # noqa: B018 - a program that cannot be cut is told now

    @cached_property
    def _cut(self) -> tuple[Stock, CutPath]:
        from edmsim.program.path import plan_path

        if self.program is None:
            with resources.as_file(resources.files(__package__) / "small_punch.ngc") as file:
                path = plan_path(file, auto_offset_mm=self.base.auto_offset_mm)
        else:
            path = plan_path(self.program, auto_offset_mm=self.base.auto_offset_mm)
        x0, y0, x1, y1 = (1e3 * v for v in path.stock_mm)
        radius = path.start_hole_radius_mm * 1e3
        holes = tuple((float(c.points_um[0, 0]), float(c.points_um[0, 1]), radius) for c in path.contours)
        return Stock((x0, y0, x1, y1), holes), path

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """The program's contours."""
        stock, path = self._cut
        legs = tuple(c.points_um.astype(np.float64) for c in path.contours)
        return Scenario(machine, stock, legs, _even(machine), seed, drawn, path.contours)


def _straight(length_mm: float) -> Floats:
    x, y = CENTRE_UM
    return np.array([(x, y), (x + length_mm * 1e3, y)])


def _even(machine: Machine) -> tuple[Floats, Floats]:
    return np.zeros(1), np.array([machine.height_mm])


def _above_zero(name: str, value: float, most: float = math.inf) -> None:
    if not (isinstance(value, int | float) and 0 < value <= most and math.isfinite(value)):
        up_to = f" and at most {most:g}" if math.isfinite(most) else ""
        raise InputError(f"{name} is {value!r}: give a number above 0{up_to}")


def _bounds(name: str, value: Range) -> tuple[float, float]:
    """Return the ends of a range; a number is one of its own."""
    low, high = value if isinstance(value, Sequence) and len(value) == 2 else (value, value)
    if not (isinstance(low, int | float) and isinstance(high, int | float) and 0 < low <= high < math.inf):
        raise InputError(f"{name} is {value!r}: give a number above 0, or the ends of a range, the lower first")
    return float(low), float(high)
