"""The options of a cut, for `edmsim.cut`, commands, reports, calibrations and sweeps.

Each is declared once, here or in `edmsim.machine.options`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, cast

import pydantic
import shapely

from edmsim.errors import InputError
from edmsim.machine import machine, options, overrides, setting
from edmsim.machine.options import Flag, Names, TextOrPath, registered
from edmsim.numeric import Number, WholeNumber
from edmsim.program.heights import Area, Height, Heights, checked_areas, checked_changes, corners_of, parse_height
from edmsim.program.passes import OVERLAP_MM, TAB_MM

if TYPE_CHECKING:
    from edmsim.closed_loop.simulation import Progress
    from edmsim.controllers import FeedController
else:  # placeholders for annotations: to import the classes loads the compiler, which takes too long for a help text
    FeedController, Progress = (type(name, (), {}) for name in ("FeedController", "Progress"))

METADATA_KEY = b"edmsim"  # key of a cut's settings, as JSON, in the metadata of ``windows.parquet``
MOST_GUIDE_ERROR_MM = 5.0  # greatest error of a guide's height in the machine's file (ours)


def _words(value: object) -> object:
    """Split ``A,B`` at the commas."""
    return [word.strip() for word in value.split(",") if word.strip()] if isinstance(value, str) else value


Words = Annotated[Sequence[str], pydantic.BeforeValidator(_words), pydantic.AfterValidator(tuple)]
_FILE = Flag(metavar="PATH")


def _list(value: Iterable[Any] | None) -> list[Any]:
    if value is not None and (isinstance(value, str) or not isinstance(value, Iterable)):
        raise ValueError("must be a list")
    return [*(value or ())]


def _drives() -> tuple[str, ...]:
    axis = resolve_name("edmsim.controllers.axis")
    return (axis.Stepper.name, *axis.COMMISSIONED)


class CutSettings(options.SetUpOptions, options.MachineOption):
    """Options of a cut: checked, immutable, and readable from their JSON.

    Raises
    ------
    InputError
        A name that is not an option, or a value that no cut can be made with.
    """

    heights: Annotated[Sequence[Height], Flag("height-at", "MM:MM", many=True)] = ()
    """Height of the workpiece from a length of wire path on, lead-in included: pairs (from_mm, height_mm), or texts
    ``12.5:30``."""
    height_areas: Sequence[Area] = ()
    """Pairs (polygon, height_mm): height of the workpiece inside a polygon (of shapely, or its corners, in mm of the
    program), which overrides `heights`; of overlapping ones the first applies."""
    constants: Annotated[
        Mapping[str, float] | Sequence[tuple[str, float]], Flag("constant", "NAME=NUMBER", many=True)
    ] = ()
    """Overrides of constants of machine, wire and material: ``gap.critical_um=5``."""
    controller: Annotated[
        str | FeedController,
        Names(lambda: resolve_name("edmsim.controllers:choices")(cutting=True), "with parameters, "
              "fixed:feed_um_s=20"),
    ] = "counts"  # fmt: skip
    """Feed controller: a name, a policy, a class in your own file, or an object."""
    planner: Annotated[str, Names(registered("edmsim.controllers.planner.registry:PLANNERS"))] = "poscal"
    """Planner of the motor steps from path and speed. With the controller ``mcu`` and poscal-literal its timers make
    the steps."""
    drive: Annotated[str, Names(_drives, "with parameters, uhu:proportional_gain=600")] = "stepper"
    """Drive of x and y."""
    compensation: Annotated[TextOrPath | None, _FILE] = None
    """File of cam tables: errors of the table's screws and ways, as ``edmsim measure table`` writes them, and cams
    that the upper guide follows."""
    mechanics: Annotated[str, Names(registered("edmsim.plant.plant:MECHANICS"))] = "modal"
    """Integrator of table and wire."""
    resolution: Annotated[str, Names(registered("edmsim.plant.resolution:RESOLUTIONS"))] = "default"
    """Resolution of the gap."""
    offset: str | Number = "auto"
    """Wire offset in mm, or auto (the wire's radius and the expected side gap), or none."""
    ignore: Annotated[Words, Flag(metavar="A,B")] = ()
    """Words of a G-code program to leave out, ``M77``, or letters, ``U``."""
    layers: Annotated[Words, Flag(metavar="A,B")] = ()
    """Layers of a drawing to cut; by default all visible ones."""
    offsets: Annotated[TextOrPath | None, _FILE] = None
    """File with a G-code program's offset registers, lines like ``D1 = 0.155`` in mm, for the offset auto; by default
    the program's own."""
    dialect: Annotated[str, Names(lambda: ("auto", *resolve_name("edmsim.program.dialects:DIALECTS")))] = "auto"
    """Dialect of a G-code program; iso for none; auto recognises it by its words."""
    conditions: Annotated[TextOrPath | None, _FILE] = None
    """File with settings of the machining conditions that a G-code program calls: a table ``[C001]`` for each."""
    upper_layer: Annotated[str | None, Flag(metavar="LAYER")] = None
    """Layer of a drawing with the contours of the workpiece's upper face, one for each of the lower face, with the
    same number of lines and arcs: the wall between them is ruled."""
    taper_deg: Annotated[Number, Flag("taper-deg")] = 0.0
    """Angle between the part's wall and the vertical, in degrees: positive if the part is smaller above than at the
    lower face, which is drawn. Taper words of a program take precedence."""
    taper_corners: Annotated[str, Names(registered("edmsim.program.outline:Corners"))] = "conical"
    """Shape of corners and arcs higher up: conical (both become cones), sharp (corners stay sharp, arcs become
    cones), cylindrical (corners stay sharp, arcs keep their radius) or rounded (arcs keep their radius, corners
    become cones). Codes of a program for it take precedence."""
    guide_errors_mm: Annotated[tuple[Number, Number] | None, Flag(metavar="LOWER:UPPER")] = None
    """Height errors of the lower and the upper guide in mm, true less file, as ``edmsim measure guides`` finds them;
    the control compensates them. By default none."""
    unit: str | None = None
    """Unit of a drawing, mm, um, cm, m, in, ft or mil; by default that of the drawing."""
    passes: Annotated[WholeNumber, pydantic.Field(ge=1)] | None = None
    """Number of passes for every contour, rough and trims, with offsets and settings of a technology; by default
    one, or those of the program."""
    technology: TextOrPath | None = None
    """Technology of the passes, a name or your own TOML file; by default that of the material. It sets machine,
    wire, generator, pulses, controller and planner."""
    tab_mm: Number = TAB_MM
    """Length of the edge in mm, at the end of a closed contour in passes, that is cut last and holds the piece; 0 for
    none."""
    overlap_mm: Number = OVERLAP_MM
    """Distance in mm by which passes continue over what is already cut."""
    after_tab: Annotated[str, Names(registered("edmsim.program.passes:AfterTab"))] = "stop"
    """Before the tab is cut: stop, to hold the piece; or cut, and the slug falls."""
    stuck_wire_sensor: bool = False
    """The wire sensor is stuck: it misses a break, and the machine goes on without a wire."""
    axis_faults: Annotated[
        Words, Flag("axis-fault", "AXIS:FAULT@SECONDS", many=True),
        Names(registered("edmsim.plant.axes.drives:FAULTS"), "several at several times"),
    ] = ()
    """Fault of a servo axis, and its time in s: ``x:stuck@2.5``."""
    seed: Annotated[WholeNumber, pydantic.Field(ge=0)] = 0
    """Seed of all random draws; the same seed gives the same result."""
    max_time_s: Number | None = None
    """Machine time in s after which to stop; by default no limit."""

    @pydantic.model_validator(mode="wrap")
    @classmethod
    def _refuse_in_one_line(cls, value: Any, handler: pydantic.ModelWrapValidatorHandler[CutSettings]) -> CutSettings:
        try:
            return handler(value)
        except pydantic.ValidationError as error:
            raise options.refusal(error, CutSettings, "a cut") from None

    @pydantic.field_validator("height_mm")
    @classmethod
    def _check_height(cls, height_mm: float) -> float:
        setting.check_height(height_mm)
        return height_mm

    @pydantic.field_validator("heights", mode="plain")
    @classmethod
    def _check_heights(cls, value: Sequence[Height | str] | str | None) -> tuple[Height, ...]:
        items = [value] if isinstance(value, str) else _list(value)
        return checked_changes([parse_height(item) if isinstance(item, str) else item for item in items])

    @pydantic.field_validator("height_areas", mode="plain")
    @classmethod
    def _check_areas(cls, value: Sequence[Area] | None) -> tuple[tuple[shapely.Polygon, float], ...]:
        return checked_areas(_list(value))

    @pydantic.field_validator("constants", mode="plain")
    @classmethod
    def _check_constants(cls, value: Any) -> tuple[tuple[str, float], ...]:
        if isinstance(value, Iterable) and not isinstance(value, Mapping | str):
            value = [overrides.parse_constant(item) if isinstance(item, str) else item for item in value]
        return tuple((name, float(number)) for name, number in overrides.checked_constants(value or {}))

    @pydantic.field_serializer("heights", "constants")
    def _pairs(self, pairs: Any) -> Any:
        return pairs

    @pydantic.field_serializer("height_areas")
    def _corners(self, areas: tuple[tuple[shapely.Polygon, float], ...]) -> list[list[object]]:
        return corners_of(areas)

    @pydantic.field_validator("controller", mode="plain")
    @classmethod
    def _check_controller(cls, value: object) -> str | FeedController:
        check = resolve_name("edmsim.controllers.user_controllers:check_is_controller")
        return value if isinstance(value, str) else cast("FeedController", check(value))

    @pydantic.field_serializer("controller")
    def _text(self, controller: str | FeedController) -> str:
        text: Callable[[object], str] = resolve_name("edmsim.controllers.user_controllers:text_of")
        return controller if isinstance(controller, str) else text(controller)

    @pydantic.field_validator("planner", "mechanics", "resolution", "dialect", "taper_corners", "after_tab")
    @classmethod
    def _check_name(cls, value: str, info: pydantic.ValidationInfo) -> Any:
        return options.checked_name(cls, str(info.field_name), value)

    @pydantic.field_validator("drive")
    @classmethod
    def _check_drive(cls, text: str) -> str:
        resolve_name("edmsim.controllers.axis:from_text")(text)
        return text

    @pydantic.field_validator("axis_faults")
    @classmethod
    def _check_axis_faults(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            resolve_name("edmsim.plant.axes.drives:parse_fault")(text)
        return texts

    @pydantic.field_validator("guide_errors_mm", mode="before")
    @classmethod
    def _parse_guide_errors(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        try:
            lower, upper = (float(part) for part in value.split(":"))
        except ValueError:
            raise InputError(f"the guides' errors are {value!r}: give two numbers in mm, as 0.1:-0.05") from None
        return lower, upper

    @pydantic.field_validator("guide_errors_mm")
    @classmethod
    def _check_guide_errors(cls, errors_mm: tuple[float, float] | None) -> tuple[float, float] | None:
        if errors_mm is not None and not all(abs(error) <= MOST_GUIDE_ERROR_MM for error in errors_mm):
            lower, upper = errors_mm
            most = f"{MOST_GUIDE_ERROR_MM:g}"
            raise InputError(f"the guides' errors of {lower:g} and {upper:g} mm are not within {most} mm")
        return errors_mm

    @pydantic.field_validator("max_time_s")
    @classmethod
    def _check_max_time(cls, max_time_s: float | None) -> float | None:
        most_s = setting.MOST_TIME_S
        if max_time_s is not None and not 0 < max_time_s <= most_s:
            raise InputError(f"the time limit of {max_time_s:g} s must be above zero, and at most {most_s:g} s")
        return max_time_s

    @classmethod
    def of_json(cls, text: str | bytes) -> CutSettings:
        """Read settings back from their JSON; raises `InputError` if it is invalid."""
        try:
            return cls.model_validate_json(text)
        except pydantic.ValidationError as error:
            raise options.refusal(error, CutSettings, "a cut") from None

    @classmethod
    def of_report(cls, report: Mapping[str, Any]) -> CutSettings:
        """Return the settings of the cut from its report, ``report.json`` or a `Report`."""
        settings = {**report["settings"], "seed": report["seed"]}
        offset_um = settings["offset_um"]  # None: the contours have those of their registers
        settings |= {"tension": settings["tension_N"], "offset": "auto" if offset_um is None else offset_um * 1e-3}
        return cls(**{name: settings[name] for name in cls.model_fields if name in settings})

    @property
    def workpiece(self) -> Heights:
        """The heights of the workpiece."""
        return Heights(self.height_mm, self.heights, cast(Any, self.height_areas))

    @property
    def overrides(self) -> tuple[tuple[str, float], ...]:
        """The `constants` as pairs of name and value."""
        return cast(tuple[tuple[str, float], ...], self.constants)

    @property
    def set_up(self) -> dict[str, Any]:
        """The arguments of `Machine.load` other than the machine's name."""
        return {name: getattr(self, name) for name in options.SetUpOptions.model_fields}

    def load_machine(self) -> machine.Machine:
        """Return the set-up; its height is the greatest of the workpiece.

        Raises
        ------
        InputError
            As `Machine.load`.
        """
        loaded = machine.Machine.load(self.machine, **{**self.set_up, "height_mm": self.workpiece.greatest_mm})
        return overrides.with_overrides(loaded, self.overrides) if self.overrides else loaded


class Running(options.Options):
    """Options for running a cut that do not change its result."""

    out: Annotated[str | Path | None, Flag(metavar="PATH")] = None
    """Folder for the outputs."""
    resume: bool = False
    """Resume the interrupted cut of that folder."""
    overwrite: bool = False
    """Discard the interrupted cut of that folder and start a new one."""
    watch: Callable[[Progress], None] | None = None
    """Called with a `Progress` after every window. In a notebook a bar is shown if there is none; with
    ``EDMSIM_PROGRESS=0`` in the environment there is no bar."""
    enter: Callable[[str], None] | None = None
    """Called with the name of a phase when it begins: cutting, measuring, figures, recording."""

    @classmethod
    def taken_from(cls, values: dict[str, Any]) -> Running:
        """Remove these options from all those of a cut and return them; raises `InputError` for an invalid value."""
        try:
            return cls.model_validate({name: values.pop(name) for name in Running.model_fields if name in values})
        except pydantic.ValidationError as error:
            raise options.refusal(error, Running, "a cut") from None


class CutOptions(CutSettings, Running):
    """All options of `edmsim.cut`."""
