"""The options of a cut: what `edmsim.cut`, ``edmsim cut``, reports, calibrations and sweeps have in common."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict, TypeVar, get_args

import shapely
from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    field_serializer,
    field_validator,
    model_validator,
)
from shapely.geometry import mapping

from edmsim.controllers import FeedController, axis
from edmsim.controllers.own import check_is_controller, text_of
from edmsim.errors import InputError, one_of
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import checked_constants, with_overrides
from edmsim.machine.parts import Choices
from edmsim.machine.setting import check_height
from edmsim.numeric import Number, WholeNumber
from edmsim.plant.axes.faults import parse_fault
from edmsim.plant.plant import MECHANICS
from edmsim.plant.resolution import resolution as check_resolution
from edmsim.program.dialects import AUTO, check_dialect
from edmsim.program.heights import Area, Height, Heights, checked_areas, checked_changes
from edmsim.program.outline import Corners

METADATA_KEY = b"edmsim"
"""Under which the metadata of ``windows.parquet`` hold a cut's settings, as JSON."""

CORNERS: tuple[str, ...] = get_args(Corners)
"""What corners and arcs of a tapered wall may become."""
MOST_GUIDE_ERROR_MM = 5.0
"""Further from where the file says, no guide is (ours)."""

_Function = TypeVar("_Function", bound=Callable[..., Any])


class CutSettings(BaseModel):
    """How a part program is cut: every option once, checked, unchangeable, and readable from its JSON.

    Raises
    ------
    InputError
        A name that is no option, or a value that no cut can be made with.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, use_attribute_docstrings=True
    )

    machine: str = "agiecut-dem15"
    """Name under ``models/machines``, or path of an own TOML file."""
    material: str = "tool-steel"
    """Material of the workpiece: name under ``models/materials``, or path of an own TOML file."""
    height_mm: Number = 20.0
    """Workpiece height in mm, 0.5 to 400, where nothing else is said."""
    heights: tuple[tuple[Number, Number], ...] = ()
    """Pairs (from_mm, height_mm): from that length of wire path on, lead-in included, the workpiece is so high."""
    height_areas: tuple[tuple[shapely.Polygon, Number], ...] = ()
    """Pairs (polygon, height_mm): inside the polygon (of shapely, or its corners, in mm of the program) the workpiece
    is so high, whatever `heights` says; the first of overlapping ones holds."""
    wire: str = "brass"
    """Name under ``models/wires``, or path of an own TOML file; with a diameter in um if wanted: ``"brass-200"``."""
    tension: Number | None = None
    """Wire tension in N; by default the wire's own."""
    generator: str = "iso-pulse"
    """Pulse generator: name under ``models/generators``, or path of an own TOML file."""
    t_on_us: Number | None = None
    """On-time in us; by default the generator's own."""
    t_period_us: Number | None = None
    """Pulse period in us; by default the generator's own."""
    open_voltage_V: Number | None = None
    """Voltage on the gap until it ignites, in V; by default the generator's own."""
    peak_current_A: Number | None = None
    """Peak current of a discharge in A; by default what the supply drives through the generator's resistor, which is
    the most there is."""
    resistance_ohm: Number | None = None
    """Resistor in series with the gap in ohm, in place of the generator's own and of a peak current."""
    ignition_wait_us: Number | None = None
    """Longest wait for ignition in us, where the generator has one; by default its own."""
    pulse_shape: str | None = None
    """Shape of the current, rectangle or triangle; by default the generator's own."""
    wire_speed_m_s: Number | None = None
    """Speed of the running wire in m/s; by default the machine's own."""
    flushing_lower_Pa: Number | None = None
    """Pressure of the lower nozzle in Pa over the surroundings, 0 where it is off; by default the machine's own."""
    flushing_upper_Pa: Number | None = None
    """Pressure of the upper nozzle in Pa; by default the machine's own."""
    standoff_lower_mm: Number | None = None
    """Distance of the lower nozzle from the workpiece in mm; by default it lies on it."""
    standoff_upper_mm: Number | None = None
    """Distance of the upper nozzle from the workpiece in mm; by default it lies on it."""
    constants: tuple[tuple[str, Number], ...] = ()
    """Constants of machine, wire and material with values other than those of their files:
    ``{"gap.critical_um": 5.0}``."""
    controller: str | FeedController = "counts"
    """Feed controller, with parameters if wanted: ``"fixed:feed_um_s=20"``; a policy, ``"policy:FILE"``; a class in
    an own file, ``"own.py:Own"`` (see `edmsim.controllers.from_text`); or an object that is one."""
    planner: str = "poscal"
    """What makes motor steps of path and speed: poscal, poscal-literal, dda, sine-table or exact;
    ``docs/planners.md`` has their errors. With the controller ``mcu`` its timers make the steps of poscal-literal."""
    drive: str = "stepper"
    """What drives x and y: stepper, or a drive tuned for the table, uhu, servo-module or eanpos, with parameters that
    differ if wanted: ``uhu:proportional_gain=600``."""
    compensation: str | None = None
    """File of cam tables: errors of the table's screws and ways, as ``edmsim measure-table`` writes them, and cams
    that the upper guide follows (``docs/cam-tables.md``)."""
    mechanics: str = "modal"
    """Integrator of table and wire: modal or mujoco (see `Plant`)."""
    resolution: str = "default"
    """How finely the gap is computed: fast, default or fine."""
    offset: str | Number = "auto"
    """Wire offset in mm, or auto (the wire's radius and the expected side gap), or none."""
    ignore: tuple[str, ...] = ()
    """Words of a G-code program to leave out, ``M77``, or letters, ``U``."""
    layers: tuple[str, ...] = ()
    """Layers of a drawing to cut; by default all that are shown."""
    offsets: str | None = None
    """File with a G-code program's offset registers, lines as ``D1 = 0.155`` in mm, for the offset auto."""
    dialect: str = AUTO
    """Dialect of a G-code program: sodick, mitsubishi, skd2, charmilles, fanuc, linuxcnc, freecad, or iso for
    none; auto: recognised by its words (``docs/dialects/index.md``)."""
    conditions: str | None = None
    """File that says what the machining conditions are that a G-code program calls: a table ``[C001]`` for each."""
    upper_layer: str | None = None
    """Layer of a drawing with the contours of the workpiece's upper face, one for each of the lower face, with as
    many lines and arcs: the wall between them is ruled."""
    taper_deg: Number = 0.0
    """Angle between the part's wall and the vertical, in degrees: positive where the part is smaller above than in
    the plane that is drawn, the lower face. What a program says of taper comes before it."""
    taper_corners: str = "conical"
    """What corners and arcs become higher up: conical (both become cones), sharp (corners stay sharp, arcs become
    cones), cylindrical (corners stay sharp, arcs keep their radius) or rounded (arcs keep their radius, corners
    become cones)."""
    guide_errors_mm: tuple[Number, Number] | None = None
    """How much higher the lower and the upper guide are than the machine's file says, in mm, as
    ``edmsim find-guides`` finds: the control then leads them accordingly; by default none."""
    unit: str | None = None
    """Unit of a drawing, mm, um, cm, m, in, ft or mil; by default what the drawing says."""
    passes: WholeNumber | None = None
    """Cut every contour in so many passes, rough and trims, with offsets and settings of a technology; by default in
    one, or as the program does."""
    technology: str | None = None
    """Technology of the passes: name under ``models/technologies``, or path of an own TOML file; by default the one
    for the material. It decides machine, wire, generator, pulses, controller and planner."""
    tab_mm: Number = 1.5
    """Length of the edge in mm, at the end of a closed contour in passes, that is cut last and holds the piece; 0 for
    none."""
    overlap_mm: Number = 0.1
    """How far passes go on over what is already cut, in mm."""
    after_tab: str = "stop"
    """What comes before the tab is cut: stop, for the piece to be held, or cut, and the slug falls."""
    stuck_wire_sensor: bool = False
    """Whether the wire's sensor is stuck: a break goes unseen, and the machine goes on without a wire."""
    axis_faults: tuple[str, ...] = ()
    """What breaks at an axis under a drive with a loop, and from which time on: ``"x:stuck@2.5"``; see
    `edmsim.plant.axes.faults`."""
    seed: WholeNumber = 0
    """Seed of every draw: same seed, same cut."""
    max_time_s: Number | None = None
    """Machine time in s after which to stop; no limit by default."""

    @model_validator(mode="wrap")
    @classmethod
    def _refuse_in_one_line(cls, value: Any, handler: ModelWrapValidatorHandler[CutSettings]) -> CutSettings:
        try:
            return handler(value)
        except ValidationError as error:
            raise InputError(_line(error)) from None

    @field_validator("height_mm")
    @classmethod
    def _check_height(cls, height_mm: float) -> float:
        check_height(height_mm)
        return height_mm

    @field_validator("heights", mode="before")
    @classmethod
    def _check_heights(cls, value: Sequence[Height] | None) -> tuple[Height, ...]:
        return checked_changes(value or ())

    @field_validator("height_areas", mode="before")
    @classmethod
    def _check_areas(cls, value: Sequence[Area] | None) -> tuple[tuple[shapely.Polygon, float], ...]:
        return checked_areas(value or ())

    @field_validator("constants", mode="before")
    @classmethod
    def _check_constants(cls, value: Mapping[str, float] | None) -> tuple[tuple[str, float], ...]:
        return checked_constants(value or {})

    @field_serializer("height_areas")
    def _corners(self, areas: tuple[tuple[shapely.Polygon, float], ...]) -> list[list[object]]:
        """Return areas as lists of corners; those with holes, which such a list cannot tell, as GeoJSON."""
        return [
            [mapping(area) if area.interiors else shapely.get_coordinates(area).tolist(), height]
            for area, height in areas
        ]

    @field_validator("controller", mode="plain")
    @classmethod
    def _check_controller(cls, value: object) -> str | FeedController:
        return value if isinstance(value, str) else check_is_controller(value)

    @field_serializer("controller")
    def _text(self, controller: str | FeedController) -> str:
        return controller if isinstance(controller, str) else text_of(controller)

    @field_validator("dialect")
    @classmethod
    def _check_dialect(cls, name: str) -> str:
        return check_dialect(name)

    @field_validator("drive")
    @classmethod
    def _check_drive(cls, text: str) -> str:
        axis.from_text(text)
        return text

    @field_validator("axis_faults")
    @classmethod
    def _check_axis_faults(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            parse_fault(text)
        return texts

    @field_validator("taper_corners")
    @classmethod
    def _check_corners(cls, name: str) -> str:
        if name not in CORNERS:
            raise InputError(f"corners of a taper cannot be '{name}'; there are: {one_of(name, CORNERS)}")
        return name

    @field_validator("guide_errors_mm")
    @classmethod
    def _check_guide_errors(cls, errors_mm: tuple[float, float] | None) -> tuple[float, float] | None:
        if errors_mm is not None and not all(abs(error) <= MOST_GUIDE_ERROR_MM for error in errors_mm):
            lower, upper = errors_mm
            most = f"{MOST_GUIDE_ERROR_MM:g}"
            raise InputError(f"the guides' errors of {lower:g} and {upper:g} mm are not within {most} mm")
        return errors_mm

    @field_validator("mechanics")
    @classmethod
    def _check_mechanics(cls, name: str) -> str:
        if name not in MECHANICS:
            raise InputError(f"unknown mechanics '{name}'; there are: {one_of(name, MECHANICS)}")
        return name

    @field_validator("resolution")
    @classmethod
    def _check_resolution(cls, name: str) -> str:
        check_resolution(name)
        return name

    @field_validator("max_time_s")
    @classmethod
    def _check_max_time(cls, max_time_s: float | None) -> float | None:
        if max_time_s is not None and not 0 < max_time_s < math.inf:
            raise InputError(f"the time limit of {max_time_s:g} s must be finite and above zero")
        return max_time_s

    @classmethod
    def of_json(cls, text: str | bytes) -> CutSettings:
        """Read settings back from their JSON; raises `InputError` if it is none."""
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise InputError(_line(error)) from None

    @classmethod
    def of_report(cls, report: Mapping[str, Any]) -> CutSettings:
        """Return the settings of the cut that a report tells of, as ``report.json`` holds it.

        An option that a report of an earlier version does not have is at its default.
        """
        settings = {**report["settings"], "seed": report["seed"]}
        offset_um = settings["offset_um"]  # None: the contours have those of their registers
        settings |= {
            "tension": settings["tension_N"], "offset": "auto" if offset_um is None else offset_um * 1e-3
        }
        return cls(**{name: settings[name] for name in cls.model_fields if name in settings})

    @property
    def workpiece(self) -> Heights:
        """The heights of the workpiece."""
        return Heights(self.height_mm, self.heights, self.height_areas)

    def load_machine(self) -> Machine:
        """Return the set-up; its height is the greatest of the workpiece.

        Raises
        ------
        InputError
            As `Machine.load`.
        """
        machine = Machine.load(
            self.machine, material=self.material, wire=self.wire, generator=self.generator,
            height_mm=self.workpiece.greatest_mm, tension=self.tension, t_on_us=self.t_on_us,
            t_period_us=self.t_period_us, **{name: getattr(self, name) for name in Choices.model_fields},
        )
        return with_overrides(machine, self.constants) if self.constants else machine


class CutOptions(TypedDict, total=False):
    """Options of `edmsim.cut`: what `CutSettings` takes, for editors and type checkers."""

    machine: str
    material: str
    height_mm: float
    heights: Sequence[Height] | None
    height_areas: Sequence[Area] | None
    wire: str
    tension: float | None
    generator: str
    t_on_us: float | None
    t_period_us: float | None
    open_voltage_V: float | None
    peak_current_A: float | None
    resistance_ohm: float | None
    ignition_wait_us: float | None
    pulse_shape: str | None
    wire_speed_m_s: float | None
    flushing_lower_Pa: float | None
    flushing_upper_Pa: float | None
    standoff_lower_mm: float | None
    standoff_upper_mm: float | None
    constants: Mapping[str, float] | None
    controller: str | FeedController
    planner: str
    drive: str
    compensation: str | None
    mechanics: str
    resolution: str
    offset: str | float
    ignore: Sequence[str]
    layers: Sequence[str]
    offsets: str | None
    dialect: str
    conditions: str | None
    upper_layer: str | None
    taper_deg: float
    taper_corners: str
    guide_errors_mm: tuple[float, float] | None
    unit: str | None
    passes: int | None
    technology: str | None
    tab_mm: float
    overlap_mm: float
    after_tab: str
    stuck_wire_sensor: bool
    axis_faults: Sequence[str]
    seed: int
    max_time_s: float | None


def takes_settings(function: _Function) -> _Function:
    """Let a function with ``**options`` show them: names, types and defaults in its signature, meanings in its help.

    The docstring's line ``{options}`` is where the meanings go.
    """
    kinds = {name: kind.__forward_arg__ for name, kind in CutOptions.__annotations__.items()}
    shown = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=kinds[name])
        for name, field in CutSettings.model_fields.items()
    ]
    signature = inspect.signature(function)
    own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    function.__signature__ = signature.replace(parameters=[*own, *shown])  # type: ignore[attr-defined]
    if function.__doc__ is not None:
        meanings = [_meaning(name, kinds[name]) for name in CutSettings.model_fields]
        function.__doc__ = function.__doc__.replace("{options}", "\n    ".join(meanings))
    return function


def _meaning(name: str, kind: str) -> str:
    """Return an option's entry in a docstring: type, default, meaning."""
    field = CutSettings.model_fields[name]
    default = "optional" if field.default in (None, ()) else f"default {field.default!r}"
    return f"{name} : {kind}, {default}\n        {' '.join((field.description or '').split())}"


def _line(error: ValidationError) -> str:
    """Say in one line what is wrong with the first option that cannot be used."""
    first = error.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"a cut has no option '{name}'; there are: {one_of(name, CutSettings.model_fields)}"
    if not name:
        return f"these are no options of a cut: {first['msg']}"
    return f"option {name} cannot be {first['input']!r}: {first['msg']}"
