"""Machine: every constant of one set-up, read from `models/` and checked.

Each constant in the TOML files is a table ``{ value, source, range }``: the source is a publication or the
word "ours"; the range, where one is known, is what `value` may be drawn from.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edmsim.errors import InputError

if TYPE_CHECKING:
    import numpy as np

Kind = Literal["machines", "wires", "materials", "generators"]
_Model = TypeVar("_Model", bound="_Frozen")


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Constant(_Frozen):
    """A positive number with its source.

    Attributes
    ----------
    value : float
    source : str
        Publication, or "ours" with the reason.
    range : (float, float), optional
        Published or assumed bounds of the value.
    """

    value: Annotated[float, Field(allow_inf_nan=False)]
    source: Annotated[str, Field(min_length=3)]
    range: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _value_in_range(self) -> Constant:
        if self.range is not None and not self.range[0] <= self.value <= self.range[1]:
            raise ValueError(f"value {self.value:g} lies outside its range {self.range}")
        return self


class Positive(Constant):
    """A constant above zero."""

    value: Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Table(_Frozen):
    """Cross table, its drives (friction and backlash count in the full model only) and its rapid moves."""

    travel_mm: Positive
    step_um: Positive
    rapid_um_s: Positive
    threading_s: Constant
    friction_N: Constant
    presliding_um: Positive
    backlash_um: Constant

    @property
    def centre_um(self) -> tuple[float, float]:
        """Middle of the table, x and y."""
        middle = self.travel_mm.value * 1e3 / 2
        return middle, middle


class Guides(_Frozen):
    """Wire guides, damping and running of the wire."""

    clearance_mm: Positive
    damping_ratio: Positive
    wire_speed_m_s: Positive


class Dielectric(_Frozen):
    """The water and its flushing."""

    permittivity: Positive
    conductivity_uS_cm: Positive
    temperature_K: Positive
    viscosity_Pa_s: Positive
    flushing_pressure_Pa: Positive
    side_gap_um: Positive


class Gap(_Frozen):
    """When and where a pulse breaks down: see `edmsim.plant.gap.breakdown`."""

    median_a_us_um2: Positive
    median_b_us_um: Constant
    median_c_us: Positive
    reference_voltage_V: Positive
    reference_height_mm: Positive
    reference_wire_um: Positive
    critical_um: Positive
    critical_width_um: Positive
    primed_scale_us: Positive
    primed_shape: Positive
    formative_us: Positive
    formative_sd_us: Constant
    contact_um: Positive
    deionisation_us: Positive
    debris_gain: Constant
    flow_quench_m_s: Positive
    bridge_base: Positive
    bridge_per_um: Constant
    bridge_ceiling: Positive
    bridge_steepness: Positive


class Discharge(_Frozen):
    """What a discharge does to workpiece and wire."""

    crater_cv: Constant
    crater_flatness: Positive
    impulse_10mJ_Ns: Constant
    impulse_exponent: Positive
    short_removal_share: Positive
    wire_heat_share: Constant
    convection_W_m2K: Positive
    wear_ratio: Constant


class Base(_Frozen):
    """A machine file: table, guides, dielectric, gap, discharge, and the MJCF they belong to."""

    title: str
    model: str  # a file of `models/`, or the absolute path of a user's
    table: Table
    guides: Guides
    dielectric: Dielectric
    gap: Gap
    discharge: Discharge


class Wire(_Frozen):
    """A wire material."""

    title: str
    default_diameter_um: Positive
    density_kg_m3: Positive
    heat_capacity_J_kgK: Positive
    conductivity_W_mK: Positive
    resistivity_Ohm_m: Positive
    resistivity_per_K: Constant
    strength_MPa: Positive
    half_strength_K: Positive
    stress_MPa: Positive


class Material(_Frozen):
    """A workpiece material."""

    title: str
    removal_mm3_J: Positive
    burning_voltage_V: Positive


class Generator(_Frozen):
    """A pulse generator; what `t_on_us` means depends on the mode (see `edmsim.plant.gap.generator`)."""

    title: str
    mode: Literal["iso-pulse", "iso-energetic", "ignition-pulse"]
    open_voltage_V: Positive
    supply_voltage_V: Positive | None = None
    resistance_ohm: Positive
    t_on_us: Positive
    t_period_us: Positive
    ignition_wait_us: Positive | None = None
    mean_current_limit_A: Positive

    @model_validator(mode="after")
    def _wait_where_needed(self) -> Generator:
        if (self.ignition_wait_us is None) != (self.mode == "iso-pulse"):
            raise ValueError("ignition_wait_us belongs to iso-energetic and ignition-pulse, and only to them")
        return self


WIRE_DIAMETER_UM = (20.0, 400.0)
"""Wire diameters of the field (thesis 1982, section 2.7.1)."""
HEIGHT_MM = (0.5, 400.0)
"""Workpiece heights of the field, from sheet to the tallest machines' work areas (ours)."""


class Machine(_Frozen):
    """One set-up, complete: machine, wire, material, generator and the operator's choices.

    Build it with `Machine.load`; change one thing with ``machine.with_(height_mm=30)``.

    Attributes
    ----------
    name, wire_name, material_name, generator_name : str
        Files under `models/` the parts were read from.
    wire_diameter_um : float
        20..400.
    tension : float
        Wire tension in newton.
    height_mm : float
        Workpiece height; the greatest one, if it changes. The guides stand off it.
    t_on_us, t_period_us : float
        Setting of the pulse generator.
    """

    name: str
    wire_name: str
    material_name: str
    generator_name: str
    base: Base
    wire: Wire
    material: Material
    generator: Generator
    wire_diameter_um: float
    tension: float
    height_mm: float
    t_on_us: float
    t_period_us: float

    @classmethod
    def load(
        cls,
        name: str = "agiecut-dem15",
        *,
        material: str = "tool-steel",
        wire: str = "brass",
        generator: str = "iso-pulse",
        height_mm: float = 20.0,
        tension: float | None = None,
        t_on_us: float | None = None,
        t_period_us: float | None = None,
    ) -> Machine:
        """Read a set-up and check it.

        Parameters
        ----------
        name, material, generator : str
            A name under `models/`, or the path of an own TOML file.
        wire : str
            Name or path, optionally with a diameter in um: ``"brass"``, ``"copper-100"``.
        height_mm : float
            Workpiece height, 0.5..400 mm.
        tension : float, optional
            Newton; the wire's default stress if not given.
        t_on_us, t_period_us : float, optional
            Generator setting; the generator's own if not given.

        Raises
        ------
        InputError
            Unknown name (which exist is said), a wrong or missing key, or a setting that cannot run.
        """
        wire_name, diameter = _split_wire(wire)
        base, wire_, material_, generator_ = (
            _read_base(name),
            _read(Wire, "wires", wire_name),
            _read(Material, "materials", material),
            _read(Generator, "generators", generator),
        )
        diameter = wire_.default_diameter_um.value if diameter is None else diameter
        area_mm2 = math.pi / 4 * (diameter * 1e-3) ** 2
        machine = cls(
            name=name, wire_name=wire_name, material_name=material, generator_name=generator,
            base=base, wire=wire_, material=material_, generator=generator_,
            wire_diameter_um=diameter,
            tension=wire_.stress_MPa.value * area_mm2 if tension is None else tension,
            height_mm=height_mm,
            t_on_us=generator_.t_on_us.value if t_on_us is None else t_on_us,
            t_period_us=generator_.t_period_us.value if t_period_us is None else t_period_us,
        )
        machine.check()
        return machine

    def with_(self, **changes: float) -> Machine:
        """Return a copy with other operator's choices (tension, height_mm, t_on_us, t_period_us), checked."""
        unknown = set(changes) - {"tension", "height_mm", "t_on_us", "t_period_us", "wire_diameter_um"}
        if unknown:
            raise InputError(f"Machine.with_ does not know {', '.join(sorted(unknown))}")
        machine = self.model_copy(update=changes)
        machine.check()
        return machine

    def uncertain(self) -> dict[str, Constant]:
        """Return the constants of machine, wire and material that have a range.

        Their names are section and key: ``"gap.critical_um"``, ``"wire.strength_MPa"``. The ranges of the
        generator are not among them: they bound what an operator may set, not what is known.
        """
        from edmsim.machine.ranges import uncertain

        return uncertain(self)

    def sample(self, rng: np.random.Generator, only: Iterable[str] | None = None) -> Machine:
        """Draw a machine within the ranges of its uncertain constants.

        Each constant is drawn by itself: log-uniformly where its range is positive and spans a factor of 3 or
        more, uniformly otherwise. The operator's choices (tension, height, diameter, pulse setting) stay. A
        set-up that `check` refuses, say because the wire drawn does not hold the tension, is drawn again, so
        the machines follow the ranges as far as these choices allow.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same machine. What one constant is drawn as does not depend on `only`, unless a
            set-up had to be drawn again.
        only : iterable of str, optional
            Sections (``"gap"``) and constants (``"dielectric.conductivity_uS_cm"``) to draw; the others keep
            their values. All by default; see `uncertain`.

        Returns
        -------
        Machine
            Checked; its constants keep their sources and ranges.

        Raises
        ------
        InputError
            A name that is none, or a constant without a range; or no set-up that can run was drawn.
        """
        from edmsim.machine.ranges import sample

        return sample(self, rng, only)

    @property
    def guide_distance_mm(self) -> float:
        """Free length of the wire: workpiece height and the clearance to each guide."""
        return self.height_mm + 2 * self.base.guides.clearance_mm.value

    @property
    def auto_offset_mm(self) -> float:
        """Distance from wire centre to part edge that is expected: wire radius and side gap."""
        return (self.wire_diameter_um / 2 + self.base.dielectric.side_gap_um.value) * 1e-3

    @property
    def breaking_force(self) -> float:
        """Tension in newton at which the cold wire breaks."""
        return self.wire.strength_MPa.value * math.pi / 4 * (self.wire_diameter_um * 1e-3) ** 2

    def check(self) -> None:
        """Raise `InputError` for a set-up that cannot run."""
        from edmsim.plant.gap.generator import check_setting

        low, high = WIRE_DIAMETER_UM
        if not low <= self.wire_diameter_um <= high:
            raise InputError(f"wire diameter {self.wire_diameter_um:g} um is not within {low:g}..{high:g} um")
        check_height(self.height_mm)
        if not self.tension > 0:
            raise InputError(f"wire tension {self.tension:g} N must be above zero")
        if self.tension >= self.breaking_force:
            raise InputError(
                f"wire tension {self.tension:g} N breaks the {self.wire_diameter_um:g} um {self.wire_name} wire "
                f"at rest: it holds {self.breaking_force:.3g} N"
            )
        check_setting(self)


def check_height(height_mm: float, where: str = "") -> None:
    """Raise `InputError` for a workpiece height no machine takes; `where` ends the message's subject."""
    low, high = HEIGHT_MM
    if not low <= height_mm <= high:
        raise InputError(f"workpiece height {height_mm:g} mm{where} is not within {low:g}..{high:g} mm")


def available(kind: Kind) -> list[str]:
    """Names that exist under `models/` for machines, wires, materials or generators."""
    folder = resources.files("edmsim.models") / kind
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def _split_wire(wire: str) -> tuple[str, float | None]:
    name, dash, diameter = wire.rpartition("-")
    if wire.endswith(".toml") or not dash:
        return wire, None
    try:
        return name, float(diameter)
    except ValueError:
        return wire, None


def _read(model: type[_Model], kind: Kind, name: str) -> _Model:
    if name.endswith(".toml"):
        file, text = name, _own_file(name)
    else:
        names = available(kind)
        if name not in names:
            raise InputError(f"unknown {kind[:-1]} '{name}'; there are: {', '.join(names)}")
        source = resources.files("edmsim.models") / kind / f"{name}.toml"
        file, text = f"models/{kind}/{name}.toml", source.read_text(encoding="utf-8")
    try:
        data: dict[str, Any] = tomllib.loads(text)
        return model.model_validate(data)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}", file) from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "file"
        raise InputError(f"key '{key}': {first['msg']}", file) from None


def _read_base(name: str) -> Base:
    base = _read(Base, "machines", name)
    if not name.endswith(".toml"):
        return base
    from edmsim.plant.mechanics.mjcf import own

    return base.model_copy(update={"model": own(base.model, name)})


def _own_file(name: str) -> str:
    try:
        return Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", name) from None
