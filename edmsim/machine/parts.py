"""The parts of a set-up as the files under `models/` have them: every constant a number with its source."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Part(BaseModel):
    """A group of constants or choices that is read as a whole, and never changed."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Constant(Part):
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


class Table(Part):
    """Cross table, its drives (friction and backlash count in the full model only) and its rapid moves."""

    travel_mm: Positive
    step_um: Positive
    max_feed_um_s: Positive | None = None  # without it that of the 1982 controller
    rapid_um_s: Positive
    threading_s: Constant
    friction_N: Constant
    presliding_um: Positive
    backlash_um: Constant

    @property
    def centre_um(self) -> tuple[float, float]:
        """Middle of the table in um."""
        return (self.travel_mm.value * 500.0, self.travel_mm.value * 500.0)


class Geometry(Part):
    """Errors of the table's screws and ways, none where nothing is given: see `edmsim.plant.axes.ways`."""

    x_pitch_um_m: Constant | None = None  # cumulative error of the screw
    y_pitch_um_m: Constant | None = None
    x_periodic_um: Constant | None = None  # amplitude of the error within a turn of the screw
    y_periodic_um: Constant | None = None
    lead_mm: Positive | None = None  # of both screws: travel of a turn
    squareness_um_m: Constant | None = None  # error of y per travel of x
    x_straightness_um: Constant | None = None  # how far the way of x bends towards y at its ends
    y_straightness_um: Constant | None = None
    change_per_mm: Constant | None = None  # share by which squareness and straightness change per mm of u

    def value(self, name: str) -> float:
        """Return a constant's value, 0 where it is not given."""
        constant: Constant | None = getattr(self, name)
        return 0.0 if constant is None else constant.value

    @property
    def has_errors(self) -> bool:
        """Whether there is any."""
        return any(self.value(name) for name in type(self).model_fields if name not in ("lead_mm", "change_per_mm"))

    @model_validator(mode="after")
    def _lead_where_needed(self) -> Geometry:
        if self.lead_mm is None and (self.value("x_periodic_um") or self.value("y_periodic_um")):
            raise ValueError("a periodic error needs lead_mm, the travel of a turn of the screw")
        return self


class Guides(Part):
    """Wire guides, damping and running of the wire."""

    clearance_mm: Positive
    damping_ratio: Positive
    wire_speed_m_s: Positive


class Dielectric(Part):
    """The water and its flushing; permittivity and viscosity are those at 20 C (see `edmsim.plant.gap.water`)."""

    permittivity: Positive
    conductivity_uS_cm: Positive
    temperature_K: Positive
    gap_temperature_K: Positive
    viscosity_Pa_s: Positive
    edge_loss: Constant
    flushing_pressure_Pa: Positive
    side_gap_um: Positive


class Gap(Part):
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


class Discharge(Part):
    """What a discharge does to workpiece and wire."""

    crater_cv: Constant
    crater_flatness: Positive
    removal_reference_us: Positive
    removal_exponent: Constant
    impulse_10mJ_Ns: Constant
    bubble_share: Positive
    short_removal_share: Positive
    short_push_share: Constant
    spot_gain: Constant
    spot_us: Positive
    wear_ratio: Constant


class Gas(Part):
    """The gas of the discharges in the gap: see `edmsim.plant.gap.coverage`."""

    steam_share: Constant
    permanent_share: Constant
    steam_periods: Positive
    wetting: Positive
    shielding: Constant
    dryness: Constant
    pumping: Constant
    ejection: Constant


class Cooling(Part):
    """Heat into the wire and out of it: see `edmsim.plant.wire`."""

    wire_heat_share: Constant
    convection_W_m2K: Positive
    convection_per_m_s: Constant
    superheat_K: Positive
    critical_W_m2: Positive
    film_W_m2K: Positive
    dry_share: Constant


class Base(Part):
    """A machine file: table, guides, dielectric, gap, discharge, gas, cooling, and the MJCF they belong to."""

    title: str
    model: str  # a file of `models/`, or the absolute path of a user's
    table: Table
    geometry: Geometry = Geometry()
    guides: Guides
    dielectric: Dielectric
    gap: Gap
    discharge: Discharge
    gas: Gas
    cooling: Cooling


class Wire(Part):
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
    melting_K: Positive
    stress_MPa: Positive


class Surface(Part):
    """What makes the layers of a cut face: see `edmsim.metrology.layers`."""

    diffusivity_mm2_s: Positive
    melting_K: Positive
    affected_K: Positive
    dissolved_mm3_C: Positive

    @model_validator(mode="after")
    def _affected_before_it_melts(self) -> Surface:
        if not self.affected_K.value < self.melting_K.value:
            raise ValueError("affected_K lies below melting_K")
        return self


class Material(Part):
    """A workpiece material; without `surface` nothing is said of the layers of its cut face."""

    title: str
    removal_mm3_J: Positive
    burning_voltage_V: Positive
    magnetic_share: Constant
    surface: Surface | None = None


class Generator(Part):
    """A pulse generator; what `t_on_us` means depends on the mode (see `edmsim.plant.gap.generator`)."""

    title: str
    mode: Literal["iso-pulse", "iso-energetic", "ignition-pulse"]
    open_voltage_V: Positive
    supply_voltage_V: Positive | None = None
    resistance_ohm: Positive
    short_current_share: Positive | None = None
    t_on_us: Positive
    t_period_us: Positive
    ignition_wait_us: Positive | None = None
    mean_current_limit_A: Positive
    pulse_shape: Literal["rectangle", "triangle"] = "rectangle"
    equalising: bool = False

    @model_validator(mode="after")
    def _wait_where_needed(self) -> Generator:
        if (self.ignition_wait_us is None) != (self.mode == "iso-pulse"):
            raise ValueError("ignition_wait_us belongs to iso-energetic and ignition-pulse, and only to them")
        return self


class Choices(Part):
    """What an operator may set in place of a constant of the files; None leaves the constant in force.

    Nothing but `edmsim.machine.setting` reads these: its functions return what is in force.
    """

    open_voltage_V: float | None = None
    peak_current_A: float | None = None
    resistance_ohm: float | None = None
    ignition_wait_us: float | None = None
    pulse_shape: str | None = None
    wire_speed_m_s: float | None = None
    flushing_lower_Pa: float | None = None
    flushing_upper_Pa: float | None = None


class SetUp(Choices):
    """Everything a set-up consists of, unchecked; see `edmsim.Machine` for its attributes."""

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
