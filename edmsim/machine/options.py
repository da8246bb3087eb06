"""The options of a set-up, each declared once for signatures, docstrings, commands and checks.

An option is an attribute of a class below: name (it ends in the unit), type, default, meaning in the docstring under
it, and in ``Annotated`` its limits, the names it may have, and how the command line spells it.
"""

import inspect
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import resources
from pkgutil import resolve_name
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, field_validator
from pydantic.fields import FieldInfo

from edmsim.errors import InputError, one_of, refuse_unknown, refused_entry
from edmsim.numeric import Number

Kind = Literal["machines", "wires", "materials", "generators", "technologies"]
_Fact = TypeVar("_Fact")
UNITS = {"mm": "mm", "us": "us", "V": "V", "A": "A", "ohm": "ohm", "m_s": "m/s", "Pa": "Pa", "s": "s"}
"""Units that names end in, and how they are written; where nothing else is meant, the ending may be left out."""


def available(kind: Kind) -> list[str]:
    """Names of the files of a kind under `models/`."""
    folder = resources.files("edmsim.models") / kind
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def registered(place: str) -> Callable[[], list[str]]:
    """Return what lists the names of a registry, ``module:mapping`` or ``module:Literal``, and loads it only then."""

    def listed() -> list[str]:
        found = resolve_name(place)
        return [*(get_args(found) or found)]

    return listed


@dataclass(frozen=True)
class Limits:
    """Least and greatest value, and what messages call it if not by its name."""

    low: float
    high: float
    what: str = ""

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value."""
        return self.low, self.high


@dataclass(frozen=True)
class Names:
    """Names that an option may have, from the registry that knows them."""

    listed: Callable[[], Iterable[str]]
    or_else: str = ""  # what else it may be, for the help; if that is empty, other names are refused


@dataclass(frozen=True)
class Flag:
    """How the command line spells an option, where its name and type do not say it."""

    name: str = ""
    metavar: str | None = None
    many: bool = False


class Options(BaseModel):
    """Options that are checked together and never changed."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, use_attribute_docstrings=True
    )

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_bytes(cls, value: Any) -> Any:
        entries = value if isinstance(value, list | tuple | set | frozenset) else (value,)
        if any(isinstance(entry, bytes | bytearray) for entry in entries):  # pydantic would decode them
            raise ValueError("must not be bytes: decode them to text")
        return value


def as_text(file: Any) -> Any:
    """Return a path as the text of it; anything else as it is."""
    return os.fspath(file) if isinstance(file, os.PathLike) else file


TextOrPath = Annotated[str, BeforeValidator(as_text)]  # a text, a file's name perhaps, which may be given as a path


class PartOptions(Options):
    """Which files a set-up is read from, and what every set-up has a value for."""

    material: Annotated[TextOrPath, Names(lambda: available("materials"), "your own TOML file")] = "tool-steel"
    """Material of the workpiece."""
    wire: Annotated[TextOrPath, Names(lambda: available("wires"), "your own TOML file")] = "brass"
    """Wire, optionally with a diameter in um: ``copper-100``."""
    generator: Annotated[TextOrPath, Names(lambda: available("generators"), "your own TOML file")] = "iso-pulse"
    """Pulse generator."""
    # from sheet to the tallest machines' work areas (ours)
    height_mm: Annotated[Number, Limits(0.5, 400.0, "workpiece height")] = 20.0
    """Workpiece height in mm."""
    tension: Number | None = None
    """Wire tension in N; by default the wire's usual stress."""
    # row T-1; a range in the generator's file holds in place of this one and of those below
    t_on_us: Annotated[Number | None, Limits(1.0, 1000.0, "t_on")] = None
    """On-time in us; by default the generator's own."""
    # 500 kHz (row T-36) to 10 ms (row T-2)
    t_period_us: Annotated[Number | None, Limits(2.0, 10_000.0, "t_period")] = None
    """Pulse period in us; by default the generator's own."""


class Choices(Options):
    """What an operator may set in place of a constant of the files; None leaves the constant in force."""

    # nothing but `edmsim.machine.setting` reads these: its functions return what is in force. The limits reach from
    # trim cuts to the largest roughing generators, from a wire that creeps to the 10 m/s of machines that reuse it,
    # from a nozzle that is off to pumps of 30 bar, from a nozzle on the workpiece to one that is out of the way
    # (ours). A range in the generator's file holds in their place
    open_voltage_V: Annotated[Number | None, Limits(10.0, 500.0)] = None
    """Voltage until ignition in V; by default the generator's own. It also drives the discharge if the generator
    has no separate supply for it."""
    peak_current_A: Annotated[Number | None, Limits(0.1, 2000.0)] = None
    """Peak current of a discharge in A, at most that through the generator's own resistor, which is the default."""
    resistance_ohm: Annotated[Number | None, Limits(0.01, 10_000.0)] = None
    """Resistor in series with the gap in ohm, replacing the generator's own and a peak current."""
    ignition_wait_us: Annotated[Number | None, Limits(0.1, 10_000.0)] = None
    """Longest wait for ignition in us, by default the generator's own; an iso-pulse generator has none."""
    pulse_shape: Annotated[str | None, Names(registered("edmsim.machine.setting:PULSE_FORMS"))] = None
    """Shape of the current, by default the generator's own; no triangle with an iso-pulse generator."""
    wire_speed_m_s: Annotated[Number | None, Limits(0.001, 15.0)] = None
    """Speed of the running wire in m/s; by default the machine's own."""
    flushing_lower_Pa: Annotated[Number | None, Limits(0.0, 3e6, "pressure of the lower nozzle")] = None
    """Pressure of the lower nozzle in Pa over the surroundings, 0 for off; by default the machine's own."""
    flushing_upper_Pa: Annotated[Number | None, Limits(0.0, 3e6, "pressure of the upper nozzle")] = None
    """Pressure of the upper nozzle in Pa, as for the lower one."""
    standoff_lower_mm: Annotated[Number | None, Limits(0.0, 100.0, "stand-off of the lower nozzle")] = None
    """Distance of the lower nozzle from the workpiece in mm; by default 0. With a stand-off water escapes
    sideways, and the pressure falls."""
    standoff_upper_mm: Annotated[Number | None, Limits(0.0, 100.0, "stand-off of the upper nozzle")] = None
    """Distance of the upper nozzle from the workpiece in mm, as for the lower one."""


class SetUpOptions(Choices, PartOptions):
    """What `edmsim.Machine.load` takes beside the machine's name."""


USUAL_MACHINE = "agiecut-dem15"


class MachineOption(Options):
    """The machine by name, where it is one option of several."""

    machine: Annotated[TextOrPath, Names(lambda: available("machines"), "your own TOML file")] = USUAL_MACHINE
    """Machine by name."""


def fact(field: FieldInfo, kind: type[_Fact]) -> _Fact | None:
    """Return what an option declares of a kind, `Limits`, `Names` or `Flag`."""
    return next((found for found in field.metadata if isinstance(found, kind)), None)


def bare_name(name: str) -> str:
    """Return an option's name without its unit: ``wire_speed`` for ``wire_speed_m_s``."""
    return next((name.removesuffix(f"_{end}") for end in UNITS if name.endswith(f"_{end}")), name)


def unit_of(name: str) -> str:
    """Return the unit that an option's name ends in, as it is written."""
    return next((unit for end, unit in UNITS.items() if name.endswith(f"_{end}")), "")


def limits_of(options: type[BaseModel]) -> dict[str, Limits]:
    """Return the limits of options by name."""
    found = {name: fact(field, Limits) for name, field in options.model_fields.items()}
    return {name: limits for name, limits in found.items() if limits is not None}


def meaning(name: str, field: FieldInfo) -> str:
    """Return what help and docstrings say of an option: meaning, names and limits."""
    text, names = " ".join((field.description or "").split()), fact(field, Names)
    if names is not None:
        text += f" One of: {', '.join(names.listed())}{f', or {names.or_else}' if names.or_else else ''}."
    limits = limits_text(name, field)
    return f"{text} {limits}." if limits else text


def limits_text(name: str, field: FieldInfo) -> str:
    """Return an option's limits in words, nothing if it has none."""
    limits = fact(field, Limits)
    return "" if limits is None else f"{limits.low:g} to {limits.high:,.10g} {unit_of(name)}"


def checked_name(options: type[BaseModel], name: str, value: Any) -> Any:
    """Return an option's value; raises `InputError` for a name that its registry does not have."""
    names = fact(options.model_fields[name], Names)
    if names is not None and not names.or_else and (known := [*names.listed()]):
        refuse_unknown(name.replace("_", " "), value, known)
    return value


def refusal(error: ValidationError, options: type[BaseModel], of: str) -> InputError:
    """Return one line that says what is wrong with the first option that cannot be used."""
    first, (name, reason) = error.errors()[0], refused_entry(error)
    if first["type"] == "extra_forbidden":
        return InputError(f"{of} has no option '{name}'; there are: {one_of(name, options.model_fields)}")
    if not name:
        return InputError(f"these are no options of {of}: {reason}")
    if len(first["loc"]) > 1 and isinstance(first["loc"][1], str):  # of several types that it may have
        name = str(first["loc"][0])
        reason = f"give {kind_of(options.model_fields[name].annotation)}"
    return InputError(f"option {name} cannot be {first['input']!r}: {reason}")


def show(function: Callable[..., Any], options: type[BaseModel]) -> Any:
    """Return a function with ``**options`` that shows them: in its signature and, with their meanings, in its help.

    The docstring's line ``{options}`` is where the meanings go.
    """
    fields = options.model_fields
    shown = [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=kind_of(field.annotation)
        )
        for name, field in fields.items()
    ]
    signature = inspect.signature(function)
    own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    function.__signature__ = signature.replace(parameters=[*own, *shown])  # type: ignore[attr-defined]
    indent = re.search(r"^( *)\{options\}", function.__doc__ or "", re.MULTILINE)
    if function.__doc__ and indent:  # there are none with python -OO
        entries = []
        for name, field in fields.items():
            default = "optional" if field.default in (None, ()) else f"default {field.default!r}"
            entries.append(f"{name} : {kind_of(field.annotation)}, {default}\n{indent[1]}    {meaning(name, field)}")
        function.__doc__ = function.__doc__.replace("{options}", f"\n{indent[1]}".join(entries))
    return function


def kind_of(annotation: Any) -> str:
    """Return a type as signatures show it."""
    if get_origin(annotation) is Annotated:
        return kind_of(get_args(annotation)[0])
    if get_origin(annotation) in (UnionType, Union):
        return " | ".join(map(kind_of, get_args(annotation)))
    if isinstance(annotation, list):
        return f"[{', '.join(map(kind_of, annotation))}]"
    if get_args(annotation):
        inner = ", ".join("..." if part is Ellipsis else kind_of(part) for part in get_args(annotation))
        return f"{kind_of(get_origin(annotation))}[{inner}]"
    return "None" if annotation is NoneType else str(getattr(annotation, "__name__", annotation))
