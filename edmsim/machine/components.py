"""The components of a set-up as the files under `models/` declare them: every constant with its source.

Constants have bounds, most of them an order of magnitude beyond known values, so typing errors are refused before a
cut begins.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from edmsim.machine.options import Choices
from edmsim.numeric import Number

BOILING_K = 373.15  # water at ambient pressure


class Component(BaseModel):
    """An immutable group of constants or choices."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def changed(self, values: Mapping[str, object]) -> Self:
        """Return a copy with other values, unchecked; draws make dozens, and pydantic's copy is four times slower."""
        made, put = object.__new__(type(self)), object.__setattr__
        put(made, "__dict__", {**self.__dict__, **values})
        # attributes of a pydantic model besides its values, which do not change
        put(made, "__pydantic_fields_set__", self.__pydantic_fields_set__)
        put(made, "__pydantic_extra__", self.__pydantic_extra__)
        put(made, "__pydantic_private__", self.__pydantic_private__)
        return made


class Constant(Component):
    """A positive number with its source."""

    value: Annotated[Number, Field(allow_inf_nan=False)]
    source: Annotated[str, Field(min_length=3)]  # publication, or "ours" with the reason
    range: tuple[Number, Number] | None = None  # published or assumed bounds of the value

    @model_validator(mode="before")
    @classmethod
    def _is_table(cls, entry: object) -> object:
        if isinstance(entry, bool | int | float | str):
            raise ValueError(f"must have its source, as {{ value = {entry}, source = \"ours: why\" }}")
        return entry

    @model_validator(mode="after")
    def _value_in_range(self) -> Self:
        if self.range is not None and not self.range[0] <= self.value <= self.range[1]:
            raise ValueError(f"value {self.value:g} lies outside its range {self.range}")
        return self


class Positive(Constant):
    """A constant above zero."""

    value: Annotated[Number, Field(gt=0, allow_inf_nan=False)]


def _within(low: float, high: float) -> AfterValidator:
    """Refuse a constant or range far beyond that of any machine (ours)."""

    def check(constant: Constant) -> Constant:
        for number in (constant.value, *(constant.range or ())):
            if not low <= number <= high:
                raise ValueError(f"{number:g} is out of range: it must be within {low:g}..{high:g}")
        return constant

    return AfterValidator(check)


class Table(Component):
    """Cross table, its drives (friction and backlash: of servos, and in the full model) and its rapid moves."""

    travel_mm: Annotated[Positive, _within(1, 500)]
    step_um: Annotated[Positive, _within(0.01, 100)]
    max_feed_um_s: Annotated[Positive, _within(0.1, 100000)] | None = None  # without it that of the 1982 controller
    rapid_um_s: Annotated[Positive, _within(1, 1e6)]
    threading_s: Annotated[Constant, _within(0, 10000)]
    friction_N: Annotated[Constant, _within(0, 100000)]
    presliding_um: Annotated[Positive, _within(0.01, 1000)]
    backlash_um: Annotated[Constant, _within(0, 1000)]

    @property
    def centre_um(self) -> tuple[float, float]:
        """Middle of the table in um."""
        return (self.travel_mm.value * 500.0, self.travel_mm.value * 500.0)


class Optional(Component):
    """Constants of which some may be omitted, as 0."""

    def value(self, name: str) -> float:
        """Return a constant's value; 0 if it is omitted."""
        constant: Constant | None = getattr(self, name)
        return 0.0 if constant is None else constant.value


class Geometry(Optional):
    """Errors of the table's screws and ways; omitted ones are 0. See `edmsim.plant.axes.geometric_errors`."""

    # cumulative error of the screw
    x_pitch_um_m: Annotated[Constant, _within(-10000, 10000)] | None = None
    y_pitch_um_m: Annotated[Constant, _within(-10000, 10000)] | None = None
    # amplitude of the error within a turn of the screw
    x_periodic_um: Annotated[Constant, _within(-1000, 1000)] | None = None
    y_periodic_um: Annotated[Constant, _within(-1000, 1000)] | None = None
    # lead of both screws: travel per turn
    lead_mm: Annotated[Positive, _within(0.1, 100)] | None = None
    # error of y per travel of x
    squareness_um_m: Annotated[Constant, _within(-50000, 50000)] | None = None
    # bend of the way of x towards y at its ends
    x_straightness_um: Annotated[Constant, _within(-1000, 1000)] | None = None
    y_straightness_um: Annotated[Constant, _within(-1000, 1000)] | None = None
    # relative change of squareness and straightness per mm of u
    change_per_mm: Annotated[Constant, _within(-1, 1)] | None = None

    @property
    def has_errors(self) -> bool:
        """Whether any error is not 0."""
        return any(self.value(name) for name in type(self).model_fields if name not in ("lead_mm", "change_per_mm"))

    @model_validator(mode="after")
    def _lead_where_needed(self) -> Self:
        if self.lead_mm is None and (self.value("x_periodic_um") or self.value("y_periodic_um")):
            raise ValueError("a periodic error needs lead_mm, the travel of a turn of the screw")
        return self


class Guides(Optional):
    """Wire guides, damping and running of the wire."""

    clearance_mm: Annotated[Positive, _within(0.1, 200)]
    damping_ratio: Annotated[Positive, _within(0.0001, 0.9)]
    wire_speed_m_s: Annotated[Positive, _within(0.001, 15)]
    # radius of the edge over which a tilted wire bends; by default 0
    edge_radius_mm: Annotated[Constant, _within(0, 50)] | None = None
    # travel of the upper guide in each direction; without it taper is impossible
    upper_travel_mm: Annotated[Positive, _within(0.1, 300)] | None = None
    # height of the guides over that known to the control
    lower_error_mm: Annotated[Constant, _within(-5, 5)] | None = None
    upper_error_mm: Annotated[Constant, _within(-5, 5)] | None = None


class Dielectric(Component):
    """The water and its flushing; permittivity and viscosity are those at 20 C (see `edmsim.plant.gap.water`)."""

    permittivity: Annotated[Positive, _within(1, 200)]
    conductivity_uS_cm: Annotated[Positive, _within(0.001, 100000)]
    temperature_K: Annotated[Positive, _within(273, 373)]
    gap_temperature_K: Annotated[Positive, _within(273, 373.15)]
    viscosity_Pa_s: Annotated[Positive, _within(0.0001, 1)]
    edge_loss: Annotated[Constant, _within(0, 10)]
    film_stirring: Annotated[Positive, _within(0.1, 100)]
    turbulence: Annotated[Constant, _within(0, 10)]
    wake_mm: Annotated[Positive, _within(0.01, 100)]
    jet_drag: Annotated[Constant, _within(0, 10)]
    flushing_pressure_Pa: Annotated[Positive, _within(100, 3e6)]
    nozzle_mm: Annotated[Positive, _within(0.1, 100)]  # bore of the nozzle
    nozzle_flow_l_min: Annotated[Positive, _within(0.1, 500)]  # greatest flow of the pump per nozzle
    side_gap_um: Annotated[Positive, _within(1, 100)]


class Gap(Component):
    """When and where a pulse breaks down: see `edmsim.plant.gap.breakdown`."""

    median_a_us_um2: Annotated[Positive, _within(0.001, 100)]
    median_b_us_um: Annotated[Constant, _within(-1000, 1000)]
    median_c_us: Annotated[Positive, _within(0.001, 10000)]
    reference_voltage_V: Annotated[Positive, _within(1, 1000)]
    reference_height_mm: Annotated[Positive, _within(0.1, 1000)]
    reference_wire_um: Annotated[Positive, _within(10, 1000)]
    critical_um: Annotated[Positive, _within(0.1, 100)]
    critical_width_um: Annotated[Positive, _within(0.01, 50)]
    primed_scale_us: Annotated[Positive, _within(0.001, 1000)]
    primed_shape: Annotated[Positive, _within(0.1, 10)]
    formative_us: Annotated[Positive, _within(0.001, 100)]
    formative_sd_us: Annotated[Constant, _within(0, 100)]
    contact_um: Annotated[Positive, _within(0.1, 20)]
    deionisation_us: Annotated[Positive, _within(0.01, 10000)]
    particle_share: Annotated[Positive, _within(0.001, 1)]
    chaining: Annotated[Constant, _within(0, 10000)]
    carried_um: Annotated[Positive, _within(1, 100000)]
    bridge_base: Annotated[Positive, _within(0.001, 10)]
    bridge_per_um: Annotated[Constant, _within(0, 1)]
    bridge_ceiling: Annotated[Positive, _within(0.001, 10)]
    bridge_steepness: Annotated[Positive, _within(1, 100000)]

    @model_validator(mode="after")
    def _waits_at_every_gap(self) -> Self:
        a, b, c = self.median_a_us_um2.value, self.median_b_us_um.value, self.median_c_us.value
        if b < 0 and c <= b * b / (4 * a):
            raise ValueError("the median delay a g^2 + b g + c must be above zero at every gap g: raise median_c_us")
        return self


class Discharge(Component):
    """Effects of a discharge on workpiece and wire."""

    crater_cv: Annotated[Constant, _within(0, 2)]
    crater_flatness: Annotated[Positive, _within(0.001, 1)]
    removal_reference_us: Annotated[Positive, _within(0.1, 10000)]
    removal_exponent: Annotated[Constant, _within(-2, 2)]
    impulse_10mJ_Ns: Annotated[Constant, _within(0, 0.001)]
    bubble_share: Annotated[Positive, _within(0.0001, 1)]
    short_removal_share: Annotated[Positive, _within(0.0001, 1)]
    short_push_share: Annotated[Constant, _within(0, 10)]
    spot_gain: Annotated[Constant, _within(0, 100)]
    spot_us: Annotated[Positive, _within(0.1, 10000)]
    wear_ratio: Annotated[Constant, _within(0, 10)]


class Gas(Component):
    """The gas of the discharges in the gap: see `edmsim.plant.gap.gas`."""

    steam_share: Annotated[Constant, _within(0, 1)]
    permanent_share: Annotated[Constant, _within(0, 1)]
    steam_periods: Annotated[Positive, _within(0.01, 1000)]
    wetting: Annotated[Positive, _within(0.01, 1)]
    shielding: Annotated[Constant, _within(0, 1)]
    dryness: Annotated[Constant, _within(-10, 1)]
    pumping: Annotated[Constant, _within(0, 1)]
    ejection: Annotated[Constant, _within(0, 1)]


class Cooling(Component):
    """Heat into the wire and out of it: see `edmsim.plant.wire`."""

    wire_heat_share: Annotated[Constant, _within(0, 1)]
    convection_W_m2K: Annotated[Positive, _within(1, 1e6)]
    convection_per_m_s: Annotated[Constant, _within(0, 100)]
    superheat_K: Annotated[Positive, _within(1, 200)]
    critical_W_m2: Annotated[Positive, _within(100, 1e9)]
    critical_stream: Annotated[Constant, _within(0, 1e7)]
    film_W_m2K: Annotated[Positive, _within(1, 1e6)]
    dry_share: Annotated[Constant, _within(0, 1)]


class Base(Component):
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


class Wire(Component):
    """A wire material."""

    title: str
    default_diameter_um: Annotated[Positive, _within(1, 1000)]
    density_kg_m3: Annotated[Positive, _within(500, 25000)]
    heat_capacity_J_kgK: Annotated[Positive, _within(50, 5000)]
    conductivity_W_mK: Annotated[Positive, _within(1, 5000)]
    resistivity_Ohm_m: Annotated[Positive, _within(1e-9, 0.001)]
    resistivity_per_K: Annotated[Constant, _within(0, 0.1)]
    strength_MPa: Annotated[Positive, _within(1, 20000)]
    half_strength_K: Annotated[Positive, _within(400, 5000)]
    melting_K: Annotated[Positive, _within(400, 5000)]
    stress_MPa: Annotated[Positive, _within(0.1, 20000)]
    # Young's modulus; without it the wire has no bending stiffness
    elasticity_GPa: Annotated[Positive, _within(0.1, 1500)] | None = None

    @model_validator(mode="after")
    def _yields_before_it_melts(self) -> Self:
        if not self.half_strength_K.value < self.melting_K.value:
            raise ValueError("half_strength_K must be below melting_K")
        return self


class Surface(Component):
    """Constants of the layers of a cut face: see `edmsim.metrology.roughness`."""

    diffusivity_mm2_s: Annotated[Positive, _within(0.01, 1000)]
    melting_K: Annotated[Positive, _within(300, 6000)]
    affected_K: Annotated[Positive, _within(300, 6000)]
    dissolved_mm3_C: Annotated[Positive, _within(1e-7, 1)]

    @model_validator(mode="after")
    def _affected_before_it_melts(self) -> Self:
        if not self.affected_K.value < self.melting_K.value:
            raise ValueError("affected_K must be below melting_K")
        return self


class Material(Component):
    """A workpiece material; without `surface` the report has no layers of its cut face."""

    title: str
    removal_mm3_J: Annotated[Positive, _within(1e-15, 1)]
    burning_voltage_V: Annotated[Positive, _within(1, 200)]
    magnetic_share: Annotated[Constant, _within(-1, 1)]
    surface: Surface | None = None


MOST_EQUALISING_A = 0.4
"""Least current of an arc (ours: between clean metals a few tenths of an ampere, Atalla 1953)."""


class Equalising(Component):
    """Supply of the equalising pulses, and its series resistor: see `edmsim.plant.gap.generator`."""

    voltage_V: Annotated[Positive, _within(1, 1000)]
    resistance_ohm: Annotated[Positive, _within(0.001, 100000)]

    @model_validator(mode="after")
    def _holds_no_arc(self) -> Self:
        most_A = self.voltage_V.value / self.resistance_ohm.value
        if most_A > MOST_EQUALISING_A * (1 + 1e-9):
            raise ValueError(f"{self.voltage_V.value:g} V through {self.resistance_ohm.value:g} ohm are {most_A:.3g} "
                             f"A, which may hold an arc; equalising pulses have at most {MOST_EQUALISING_A:g} A: "
                             "raise resistance_ohm")
        return self


class Generator(Component):
    """A pulse generator; the meaning of `t_on_us` depends on the mode (see `edmsim.plant.gap.generator`)."""

    title: str
    mode: Literal["iso-pulse", "iso-energetic", "ignition-pulse"]
    open_voltage_V: Annotated[Positive, _within(1, 1000)]
    supply_voltage_V: Annotated[Positive, _within(1, 1000)] | None = None
    resistance_ohm: Annotated[Positive, _within(0.001, 100000)]
    short_current_share: Annotated[Positive, _within(0.001, 10)] | None = None
    arc_share: Annotated[Positive, _within(0.001, 1)] | None = None
    t_on_us: Annotated[Positive, _within(0.01, 100000)]
    t_period_us: Annotated[Positive, _within(0.1, 1e6)]
    ignition_wait_us: Annotated[Positive, _within(0.01, 100000)] | None = None
    mean_current_limit_A: Annotated[Positive, _within(0.001, 10000)]
    pulse_shape: Literal["rectangle", "triangle"] = "rectangle"
    equalising: Equalising | None = None

    @model_validator(mode="after")
    def _wait_where_needed(self) -> Self:
        if (self.ignition_wait_us is None) != (self.mode == "iso-pulse"):
            raise ValueError("ignition_wait_us belongs to iso-energetic and ignition-pulse, and only to them")
        return self


class SetUp(Choices):
    """All components of a set-up, unchecked; see `edmsim.Machine` for its attributes."""

    name: str
    wire_name: str
    material_name: str
    generator_name: str
    base: Base
    wire: Wire
    material: Material
    generator: Generator
    wire_diameter_um: Number
    tension: Number
    height_mm: Number
    t_on_us: Number
    t_period_us: Number

    @property
    def guide_distance_mm(self) -> float:
        """Free length of the wire: workpiece height and the clearance to each guide."""
        return self.height_mm + 2 * self.base.guides.clearance_mm.value

    @property
    def guides_z_mm(self) -> tuple[float, float]:
        """Heights of the lower and the upper guide over the workpiece's lower face; the lower is negative."""
        clearance_mm = self.base.guides.clearance_mm.value
        return -clearance_mm, self.height_mm + clearance_mm

    @property
    def auto_offset_mm(self) -> float:
        """Expected distance from wire centre to part edge: wire radius and side gap."""
        return (self.wire_diameter_um / 2 + self.base.dielectric.side_gap_um.value) * 1e-3

    @property
    def breaking_force(self) -> float:
        """Tension in N at which the cold wire breaks."""
        return self.wire.strength_MPa.value * math.pi / 4 * (self.wire_diameter_um * 1e-3) ** 2
