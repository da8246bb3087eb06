"""Technologies: offsets and settings of every pass by workpiece height, files of `models/technologies`.

A technology is found by simulation (``edmsim tune technology``). Its passes form a chain: the setting of a pass does
not depend on the number of passes after it, and offsets are relative to the last pass, which produces the drawn size.
"""

import math
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self, TypeVar

from pydantic import Field, model_validator

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.machine.components import Component
from edmsim.machine.machine import Machine, read, read_wire
from edmsim.machine.options import USUAL_MACHINE, SetUpOptions, available
from edmsim.numeric import Number

_BEYOND = 1.6  # greatest ratio of a height to the nearest height of a technology (ours)
_NEAR_WIRE = 0.02
"""Greatest difference of two diameters, as a share, at which a wire takes the technology of the other (ours: 0.25 and
0.254 mm, ten thousandths of an inch, are one size)."""
_Above = Annotated[Number, Field(gt=0, allow_inf_nan=False)]
_Any = Annotated[Number, Field(allow_inf_nan=False)]
_Component = TypeVar("_Component", bound=Component)


class FoundPass(Component):
    """Results of a pass when the technology was found: feed, removed stock, roughness and bow of a straight cut."""

    feed_mm_min: _Any
    stock_um: _Any
    ra_um: _Any
    bow_um: _Any


class PassSetting(Component):
    """Setting of a pass at one height."""

    generator: str
    t_on_us: _Above
    t_period_us: _Above
    # peak_current_A, open_voltage_V, ignition_wait_us: by default the generator's own
    peak_current_A: _Above | None = None
    open_voltage_V: _Above | None = None
    ignition_wait_us: _Above | None = None
    # tension_N, wire_speed_m_s, flushing_lower_Pa, flushing_upper_Pa: by default the wire's and the machine's own
    tension_N: _Above | None = None
    wire_speed_m_s: _Above | None = None
    flushing_lower_Pa: _Any | None = None
    flushing_upper_Pa: _Any | None = None
    # "adaptive" follows the gap; "constant" is constant and slowed by shorts
    feed: Literal["adaptive", "constant"]
    open_target_share: Annotated[Number, Field(ge=0, le=1)] = 0.06  # target share of open pulses of an adaptive feed
    stop_share: Annotated[Number, Field(gt=0, le=1)] = 0.5  # share of shorts at which a constant feed stops
    # path before an outer corner on which the period of a constant feed is longer, and the factor on it
    corner_before_um: _Any = 0.0
    corner_factor: Annotated[Number, Field(ge=1)] = 3.0
    feed_mm_min: _Above  # the constant feed; an adaptive one begins at half of it
    last_offset_um: _Above  # offset that produces the drawn size if this is the last pass
    step_um: _Any = 0.0  # decrease of the offset to the next pass
    found: FoundPass

    def controller(self, scale: float = 1.0) -> str:
        """Return the feed controller for the command line.

        Parameters
        ----------
        scale : float
            Factor on the feed, for slower lead-ins.
        """
        feed_um_s = self.feed_mm_min / 0.06 * scale
        if self.feed == "constant" or scale != 1.0:
            corner = f",before_um={self.corner_before_um:.6g},corner_factor={self.corner_factor:.6g}"
            return f"trim:feed_um_s={feed_um_s:.6g},stop_share={self.stop_share:.6g}" + (
                corner if self.corner_before_um and scale == 1.0 else ""
            )
        return f"counts:open_target_share={self.open_target_share:.6g},start_feed_um_s={feed_um_s / 2:.6g}"


OF_PASS = {
    "generator": "generator", "tension": "tension_N", "t_on_us": "t_on_us", "t_period_us": "t_period_us",
    "open_voltage_V": "open_voltage_V", "peak_current_A": "peak_current_A", "ignition_wait_us": "ignition_wait_us",
    "wire_speed_m_s": "wire_speed_m_s", "flushing_lower_Pa": "flushing_lower_Pa",
    "flushing_upper_Pa": "flushing_upper_Pa",
}  # fmt: skip
"""Options of a set-up that each pass has, and their names in a `PassSetting`."""


def machine_of(one: PassSetting, machine: str, material: str, wire: str, height_mm: float) -> Machine:
    """Return a machine with the setting of a pass; raises `InputError` as `Machine.load`."""
    of_pass: Any = {name: getattr(one, own) for name, own in OF_PASS.items()}
    return Machine.load(machine, material=material, wire=wire, height_mm=height_mm, **of_pass)


class AtHeight(Component):
    """The passes of a technology at one height, from rough to last, and the factor on the feed of a lead-in."""

    height_mm: _Above
    resolution: str | None = None  # resolution of the cuts in which the offsets were measured, if known
    approach_share: Annotated[Number, Field(gt=0, le=1)] = 0.25
    passes: Annotated[tuple[PassSetting, ...], Field(alias="pass", min_length=1)]

    @model_validator(mode="after")
    def _offsets_fall(self) -> Self:
        if any(one.step_um < 0 for one in self.passes):
            raise ValueError("step_um is below 0: the offset would grow from a pass to the next")
        return self


class PassTable(NamedTuple):
    """A technology's offsets and settings for the passes of a cut, from rough to last."""

    offsets_mm: tuple[float, ...]
    settings: tuple[PassSetting, ...]
    approach_share: float  # feed of a lead-in over that of the rough pass
    resolution: str | None  # see `AtHeight`
    notices: tuple[str, ...]


class Technology(Component):
    """Settings of passes for a machine, a material and a wire."""

    title: str
    source: Annotated[str, Field(min_length=3)]
    machine: str  # machine, material, wire, planner: names in a cut's options; the wire's includes its diameter
    material: str
    wire: str
    planner: str = "exact"
    heights: Annotated[tuple[AtHeight, ...], Field(alias="height", min_length=1)]  # in rising order

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if any(b.height_mm <= a.height_mm for a, b in pairwise(self.heights)):
            raise ValueError("heights must rise")
        return self

    def thinner_um(self, wire: str) -> float | None:
        """Return by how much a wire is thinner than the technology's; None if it is of another kind or size."""
        (name, _, diameter_um), (own, _, own_um) = read_wire(wire), read_wire(self.wire)
        near = name == own and abs(diameter_um / own_um - 1.0) <= _NEAR_WIRE
        return own_um - diameter_um if near else None

    @refuses_wrong_types
    def table(self, height_mm: float, passes: int) -> PassTable:
        """Return offsets and settings for a height and a number of passes, interpolated between heights.

        Near a single height, trims have its power per mm of height; a rough pass has no more than that, and no more
        power.

        Raises
        ------
        InputError
            If it has fewer passes, or this height is far outside.
        """
        at, notices = self._at(height_mm)
        if not 1 <= passes <= len(at.passes):
            raise InputError(f"the technology for {self.material} and the wire {self.wire} has 1 to {len(at.passes)} "
                             f"passes for {height_mm:g} mm, not {passes}: choose one of these, or find others with "
                             "edmsim tune technology")
        settings = at.passes[:passes]
        steps_um = [one.step_um for one in settings[-2::-1]]
        offsets_um = accumulate(steps_um, initial=settings[-1].last_offset_um)
        offsets_mm = tuple(round(um) / 1e3 for um in offsets_um)[::-1]
        return PassTable(offsets_mm, settings, at.approach_share, at.resolution, notices)

    def _at(self, height_mm: float) -> tuple[AtHeight, tuple[str, ...]]:
        known = [one.height_mm for one in self.heights]
        for one in self.heights:
            if math.isclose(one.height_mm, height_mm, rel_tol=1e-3):
                return one, ()
        listed = " and ".join(f"{mm:g}" for mm in known)
        if not known[0] / _BEYOND <= height_mm <= known[-1] * _BEYOND:
            raise InputError(f"the technology for {self.material} and the wire {self.wire} has settings for heights "
                             f"of {listed} mm, too far from {height_mm:g} mm: find some with edmsim tune technology "
                             f"{self.material} --height {height_mm:g}")
        between = known[0] < height_mm < known[-1]
        how = "interpolated between" if between else "extrapolated from"
        rule = ", by power per mm of height" if len(known) == 1 else ""
        notice = (
            f"the settings of the passes are {how} those for {listed} mm{rule}; this workpiece is {height_mm:g} mm "
            "high"
        )
        if len(known) == 1:
            return _alone(self.heights[0], height_mm), (notice,)
        pair = next((p for p in pairwise(self.heights) if height_mm <= p[1].height_mm), self.heights[-2:])
        low, high = pair
        share = math.log(height_mm / low.height_mm) / math.log(high.height_mm / low.height_mm)
        return _between(low, high, share, height_mm), (notice,)


def _alone(at: AtHeight, height_mm: float) -> AtHeight:
    """Return the settings for another height than the only known one, with the same power per mm of height."""
    # With this power a trim removes its metal at its feed. The rough pass of a taller part keeps the total power and
    # is slower. That of a lower part must not: at the power for 25.4 mm, wires break on 16 mm.
    share = at.height_mm / height_mm
    rough, *trims = at.passes
    slower = min(share, 1.0)
    found = rough.found.model_copy(update={"feed_mm_min": rough.found.feed_mm_min * slower})
    changed = {
        "t_period_us": rough.t_period_us * max(share, 1.0), "feed_mm_min": rough.feed_mm_min * slower, "found": found,
    }  # fmt: skip
    passes = (
        rough.model_copy(update=changed),
        *(one.model_copy(update={"t_period_us": one.t_period_us * share}) for one in trims),
    )
    return at.model_copy(update={"height_mm": height_mm, "passes": passes})


def _between(low: AtHeight, high: AtHeight, share: float, height_mm: float) -> AtHeight:
    """Interpolate between two settings at a share of the logarithm of the height."""
    passes = []
    for a, b in zip(low.passes, high.passes, strict=False):
        mixed = _mixed(a, b, share)  # outside the heights, the extrapolated result could be faster than the feed
        most = {"feed_mm_min": min(mixed.found.feed_mm_min, mixed.feed_mm_min)}
        passes.append(mixed.model_copy(update={"found": mixed.found.model_copy(update=most)}))
    resolution = low.resolution if low.resolution == high.resolution else None
    return AtHeight.model_construct(
        height_mm=height_mm, resolution=resolution, approach_share=low.approach_share, passes=tuple(passes)
    )


def _mixed(a: _Component, b: _Component, share: float) -> _Component:
    values: dict[str, Any] = {}
    for name in type(a).model_fields:
        one, other = getattr(a, name), getattr(b, name)
        if isinstance(one, float) and isinstance(other, float):
            positive = one > 0 and other > 0
            mixed = one * (other / one) ** share if positive else one + share * (other - one)
            values[name] = max(mixed, min(one, other, 0.0))
        elif isinstance(one, Component):
            values[name] = _mixed(one, other, share)
        else:
            values[name] = one if share < 0.5 else other
    return type(a).model_construct(**values)


def read_technology(file: str | Path) -> Technology:
    """Read a technology by its name under ``models/technologies`` or the path of your own TOML file.

    Raises
    ------
    InputError
        If the name is unknown or the file invalid; names the wrong key.
    """
    return read(Technology, "technologies", str(file))


def technology_for(material: str, machine: str | None = None, wire: str | None = None) -> Technology:
    """Return the technology of a material, or of that with the nearest removal; optionally for machine and wire.

    It may be for a wire of nearly this diameter: see `Technology.thinner_um`.
    """
    known = [read_technology(name) for name in available("technologies")]
    on_machine = [one for one in known if machine in (None, one.machine)]
    fitting = [one for one in on_machine if wire is None or one.thinner_um(wire) is not None]
    if not fitting:
        named = {what: name for what, name in (("machine", machine), ("wire", wire)) if name}
        usual_wire = SetUpOptions.model_fields["wire"].default
        Machine.load(machine or USUAL_MACHINE, material=material, wire=wire or usual_wire)  # refuses unknown names
        chosen = "".join(f", {what} {name}" for what, name in named.items())
        ours = "; ".join(f"{one.material}, machine {one.machine}, wire {one.wire}" for one in known)
        options = "".join(f" --{what} {name}" for what, name in named.items())
        raise InputError(f"there is no technology for {material}{chosen}; there are: {ours}. Find one with: edmsim "
                         f"tune technology {material}{options}")

    def away(one: Technology) -> float:
        removals = [Machine.load(material=name).material.removal_mm3_J.value for name in (one.material, material)]
        return abs(math.log(removals[0] / removals[1]))

    return min(fitting, key=lambda one: (one.material != material, away(one)))
