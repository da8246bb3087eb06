"""The options of a set-up, each declared once for signatures, docstrings, commands and checks.

An option is an attribute of a class below, with name (which ends in the unit), type, default, its meaning in the
docstring after it, and in ``Annotated`` its limits, valid names, and its spelling on the command line.
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
"""Unit suffixes of names, and the units as written; a suffix may be omitted if the name stays unique."""


def available(kind: Kind) -> list[str]:
    """Return the names of the files of a kind under `models/`."""
    folder = resources.files("edmsim.models") / kind
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def registered(place: str) -> Callable[[], list[str]]:
    """Return a function that imports a registry, ``module:mapping`` or ``module:Literal``, and lists its names."""

    def listed() -> list[str]:
        found = resolve_name(place)
        return [*(get_args(found) or found)]

    return listed


@dataclass(frozen=True)
class Limits:
    """Least and greatest value, and the option's name in messages if it differs."""

    low: float
    high: float
    what: str = ""

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value."""
        return self.low, self.high


@dataclass(frozen=True)
class Names:
    """Valid names of an option, from a registry."""

    listed: Callable[[], Iterable[str]]
    or_else: str = ""  # other valid values, for the help; if empty, other names are refused


@dataclass(frozen=True)
class Flag:
    """Spelling of an option on the command line, if it does not follow from name and type."""

    name: str = ""
    metavar: str | None = None
    many: bool = False


class Options(BaseModel):
    """Options that are checked together and immutable."""

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
    """Return a path as text; anything else unchanged."""
    return os.fspath(file) if isinstance(file, os.PathLike) else file


TextOrPath = Annotated[str, BeforeValidator(as_text)]  # a text, for which a path is also accepted


class ComponentOptions(Options):
    """The files of a set-up, and options that every set-up has."""

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
    # row T-1; a range in the generator's file replaces these limits and those below
    t_on_us: Annotated[Number | None, Limits(1.0, 1000.0, "t_on")] = None
    """On-time in us; by default the generator's own."""
    # 500 kHz (row T-36) to 10 ms (row T-2)
    t_period_us: Annotated[Number | None, Limits(2.0, 10_000.0, "t_period")] = None
    """Pulse period in us; by default the generator's own."""


class Choices(Options):
    """Options that override a constant of the files; None keeps the constant."""

    # Only `edmsim.machine.setting` reads these; its functions return the values that apply. The limits range from
    # trim cuts to the largest roughing generators, from a creeping wire to the 10 m/s of machines that reuse it, from
    # a nozzle that is off to pumps of 30 bar, from a nozzle on the workpiece to one far away (ours). A range in the
    # generator's file replaces them.
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


class SetUpOptions(Choices, ComponentOptions):
    """Options of `edmsim.Machine.load` without the machine's name."""


USUAL_MACHINE = "agiecut-dem15"


class MachineOption(Options):
    """The machine by name, as one option among others."""

    machine: Annotated[TextOrPath, Names(lambda: available("machines"), "your own TOML file")] = USUAL_MACHINE
    """Machine by name."""


def fact(field: FieldInfo, kind: type[_Fact]) -> _Fact | None:
    """Return an option's `Limits`, `Names` or `Flag`, if declared."""
    return next((found for found in field.metadata if isinstance(found, kind)), None)


def bare_name(name: str) -> str:
    """Return an option's name without its unit: ``wire_speed`` for ``wire_speed_m_s``."""
    return next((name.removesuffix(f"_{end}") for end in UNITS if name.endswith(f"_{end}")), name)


def unit_of(name: str) -> str:
    """Return the unit in which an option's name ends, as written."""
    return next((unit for end, unit in UNITS.items() if name.endswith(f"_{end}")), "")


def limits_of(options: type[BaseModel]) -> dict[str, Limits]:
    """Return the limits of options by name."""
    found = {name: fact(field, Limits) for name, field in options.model_fields.items()}
    return {name: limits for name, limits in found.items() if limits is not None}


def meaning(name: str, field: FieldInfo) -> str:
    """Return the text of an option for help and docstrings: meaning, names and limits."""
    text, names = " ".join((field.description or "").split()), fact(field, Names)
    if names is not None:
        text += f" One of: {', '.join(names.listed())}{f', or {names.or_else}' if names.or_else else ''}."
    limits = limits_text(name, field)
    return f"{text} {limits}." if limits else text


def limits_text(name: str, field: FieldInfo) -> str:
    """Return an option's limits as text; empty without limits."""
    limits = fact(field, Limits)
    return "" if limits is None else f"{limits.low:g} to {limits.high:,.10g} {unit_of(name)}"


def checked_name(options: type[BaseModel], name: str, value: Any) -> Any:
    """Return an option's value; raises `InputError` for a name that is not in its registry."""
    names = fact(options.model_fields[name], Names)
    if names is not None and not names.or_else and (known := [*names.listed()]):
        refuse_unknown(name.replace("_", " "), value, known)
    return value


def flag(name: str, field: FieldInfo) -> str:
    """Return the name of an option on the command line."""
    own = fact(field, Flag)
    return "--" + (own.name if own is not None and own.name else bare_name(name).replace("_", "-"))


def refusal(error: ValidationError, options: type[BaseModel], of: str) -> InputError:
    """Return the error of the first invalid option in one line."""
    first, (name, reason) = error.errors()[0], refused_entry(error)
    if first["type"] == "extra_forbidden":
        return InputError(f"{of} has no option '{name}'; there are: {one_of(name, options.model_fields)}")
    if not name:
        return InputError(f"these are no options of {of}: {reason}")
    if len(first["loc"]) > 1 and isinstance(first["loc"][1], str):  # error for one of several types
        name = str(first["loc"][0])
        reason = f"give {kind_of(options.model_fields[name].annotation)}"
    return InputError(f"option {name} cannot be {first['input']!r}: {reason}")


def show(function: Callable[..., Any], options: type[BaseModel]) -> Any:
    """Return a function with ``**options`` that shows them in its signature and docstring.

    The meanings replace the docstring's line ``{options}``.
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
    if function.__doc__ and indent:  # python -OO removes docstrings
        entries = []
        for name, field in fields.items():
            default = "optional" if field.default in (None, ()) else f"default {field.default!r}"
            entries.append(f"{name} : {kind_of(field.annotation)}, {default}\n{indent[1]}    {meaning(name, field)}")
        function.__doc__ = function.__doc__.replace("{options}", f"\n{indent[1]}".join(entries))
    return function


def kind_of(annotation: Any) -> str:
    """Return a type as text for signatures."""
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
