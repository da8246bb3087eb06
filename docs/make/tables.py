"""The tables of the guide that are made from the code; `python docs/make/tables.py` writes them.

A page marks the place of a table with two comments; the text between them is replaced::

    <!-- begin table: parameters counts -->
    <!-- end table -->

``tests/site`` fails if a page's tables differ from the code.
"""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from field_comments import declared_fields
from sections import DOCS, has_tables, table, with_tables
from typer.models import ArgumentInfo

from edmsim import controllers
from edmsim.cli import app as cli
from edmsim.cli.options import with_options
from edmsim.controllers.axis import ServoModule, Uhu
from edmsim.controllers.axis.drive import data_of
from edmsim.controllers.feed.law import GapServo, ServoLaw
from edmsim.machine.machine import Machine
from edmsim.machine.options import Names, SetUpOptions, available, fact, flag, limits_text
from edmsim.machine.setting import most_current_A, open_V, pulse_shape
from edmsim.recording.windows import COLUMNS, EQUALISING_COLUMNS

LINUXCNC = {
    "proportional_gain": "Pgain", "integral_gain": "Igain", "derivative_gain": "Dgain", "clamp": "maxoutput",
    "output_offset": "bias", "velocity_feed_forward": "FF1", "acceleration_feed_forward": "FF2",
    "jerk_feed_forward": "FF3",
}  # fmt: skip
"""Equivalent pins of LinuxCNC's component ``pid`` (its manual page)."""
VALUES = {str: "TEXT", int: "INTEGER", float: "NUMBER", Path: "PATH"}


def refreshed(text: str) -> str:
    """Return a page with its tables replaced."""
    return with_tables(text, TABLES)


def pages() -> list[Path]:
    """Return the pages with tables, except those of `validation.py`."""
    return [page for page in sorted(DOCS.rglob("*.md")) if page.parent.name != "theory" and has_tables(page)]


def commands() -> str:
    """Return the section of every command of ``edmsim``: its text, arguments and options."""
    parts: list[str] = []
    for name, callback in every_command():
        parameters = inspect.signature(callback, eval_str=True).parameters.values()
        shown = [(p, get_args(p.annotation)[1]) for p in parameters if get_origin(p.annotation) is Annotated]
        parts += [
            f"## edmsim {name}", inspect.getdoc(callback) or "",
            table(("argument or option", "default", "what"), [described(p, info) for p, info in shown]),
        ]  # fmt: skip
    return "\n\n".join(parts)


def every_command() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every command's name on the command line, such as ``console servo``, and its function."""
    groups = ((f"{info.name} ", info.typer_instance) for info in cli.app.registered_groups)
    for words, group in (("", cli.app), *groups):
        for command in group.registered_commands:
            name = command.name or command.callback.__name__.replace("_", "-")
            yield words + name, with_options(command.callback)


def option(parameter: inspect.Parameter, info: Any) -> str:
    """Return an option's name on the command line."""
    return info.default if isinstance(info.default, str) else "--" + parameter.name.replace("_", "-")


def word(parameter: inspect.Parameter, info: Any) -> str:
    """Return the placeholder of a value."""
    if info.metavar:
        return str(info.metavar)
    if isinstance(info, ArgumentInfo):
        return parameter.name.upper()
    return VALUES.get(bare(parameter), "")


def bare(parameter: inspect.Parameter) -> type:
    """Return the type of a parameter's value, without Annotated, None and list."""
    kind = get_args(parameter.annotation)[0]
    while get_origin(kind) in (Union, UnionType, list):
        kind = next(part for part in get_args(kind) if part is not NoneType)
    return kind if isinstance(kind, type) else object


def described(parameter: inspect.Parameter, info: Any) -> tuple[str, ...]:
    """Return the row of an argument or option."""
    if isinstance(info, ArgumentInfo):
        name = word(parameter, info)
    elif bare(parameter) is bool:
        name = option(parameter, info)
        name += "" if parameter.default is False else f", --no-{parameter.name}"
    else:
        name = f"{option(parameter, info)} {word(parameter, info)}"
    if parameter.default is parameter.empty:
        default = "required"
    else:
        shown = parameter.default is not None and bare(parameter) is not bool
        default = f"`{parameter.default}`" if shown else ""
    return f"`{name}`", default, info.help


def options(*names: str) -> str:
    """Return the table of options of a set-up: meaning and limits."""
    body = []
    for name in names:
        field = SetUpOptions.model_fields[name]
        listed = fact(field, Names)
        within = limits_text(name, field) if listed is None else ", ".join(listed.listed())
        body.append((f"`{flag(name, field)}`", f"`{name}`", " ".join(str(field.description).split()), within))
    return table(("option", "in Python", "meaning", "limits"), body)


def columns() -> str:
    """Return the table of columns of ``windows.parquet``."""
    columns = COLUMNS + EQUALISING_COLUMNS
    return table(("column", "unit", "meaning"), ((f"`{c.name}`", c.unit, c.meaning) for c in columns))


def letters() -> str:
    """Return the table of the servo drives' settings, with their letters and their names in LinuxCNC's ``pid``."""
    chips = [
        {row["name"]: row["letter"] for row in data_of(file)["parameter"]} for file in ("uhu", "servo_module")
    ]
    names = {**chips[0], **chips[1], **dict.fromkeys(Uhu().extensions), **dict.fromkeys(ServoModule().extensions)}
    return table(("name in Python", "UHU", "servo module", "LinuxCNC `pid`"), (
        (f"`{name}`", *(f"`{chip[name]}`" if name in chip else "" for chip in chips),
         f"`{LINUXCNC[name]}`" if name in LINUXCNC else "")
        for name in names
    ))  # fmt: skip


def parameters(name: str, like: str = "") -> str:
    """Return the table of a feed controller's parameters: default, value found by the search of gains, meaning.

    ``servo`` has those of all servos; the table of a servo law repeats only those that a search or the law has set.
    Rows that the law `like` has as well are omitted.
    """
    same = described_parameters(like) if like else []
    rows = [row for row in described_parameters(name) if row not in same]
    return table(("parameter", "default", "found", "meaning"), rows)


def described_parameters(name: str) -> list[tuple[str, ...]]:
    """Return the rows of a feed controller's parameters."""
    kind: type[Any] = GapServo if name == "servo" else type(controllers.make(name))
    found = {} if name == "servo" else controllers.found_gains(name)
    defaults = {field.name: field.default for field in fields(kind) if field.init}
    own = meanings(kind)
    if issubclass(kind, ServoLaw):
        components = [component for slot, component in kind.COMPONENTS.items() if slot != "servo"]
        bases = {base for component in components for base in component.__mro__[:-1]}
        found_in = [each for base in bases for each in meanings(base) if each[0][0] in defaults]
        own = sorted(found_in, key=lambda each: list(defaults).index(each[0][0]))
        usual = {field.name: field.default for field in fields(GapServo) if field.init}
        of_its_own = found.keys() | {key for key, value in usual.items() if defaults.get(key, value) != value}
        own += [each for each in meanings(GapServo) if each[0][0] in of_its_own]
    return [
        (", ".join(f"`{key}`" for key in keys), ", ".join(f"{defaults[key]:g}" for key in keys),
         ", ".join(f"{found[key]:g}" if key in found else "–" for key in keys) if found.keys() & set(keys) else "",
         meaning)
        for keys, meaning in own
    ]  # fmt: skip


def meanings(kind: type) -> list[tuple[list[str], str]]:
    """Return the parameters that a class itself declares, with one entry for those described together."""
    own = (field for field in declared_fields(kind) if field.meaning and not field.is_state)
    return [(field.names, field.meaning.rstrip(".")) for field in own]


def set_ups(kind: str) -> str:
    """Return the table of one kind of files in ``models/``: machines, materials, wires or generators."""
    head, row = SET_UPS[kind]
    return table(("name", "what", *head), (
        (f"`{name}`", *row(Machine.load(**{"name" if kind == "machines" else kind[:-1]: name})))
        for name in available(kind)  # type: ignore[arg-type]
    ))  # fmt: skip


def _machine(m: Machine) -> tuple[str, ...]:
    return m.base.title, f"{m.base.table.travel_mm.value:g}", f"{m.base.table.step_um.value:g}"


def _material(m: Machine) -> tuple[str, ...]:
    return m.material.title, f"{m.material.removal_mm3_J.value:g}", f"{m.material.burning_voltage_V.value:g}"


def _wire(m: Machine) -> tuple[str, ...]:
    return m.wire.title, f"{m.wire_diameter_um:g}", f"{m.tension:.3g}", f"{m.breaking_force:.3g}"


def _generator(m: Machine) -> tuple[str, ...]:
    shape, peak_A = pulse_shape(m), most_current_A(m)
    return m.generator.title, f"{m.t_on_us:g}", f"{m.t_period_us:g}", f"{open_V(m):g}", f"{shape}, {peak_A:.3g}"


SET_UPS: dict[str, tuple[tuple[str, ...], Callable[[Machine], tuple[str, ...]]]] = {
    "machines": (("travel, mm", "motor step, um"), _machine),
    "materials": (("removal, mm3/J", "burning voltage, V"), _material),
    "wires": (("usual diameter, um", "usual tension of it, N", "breaks cold at, N"), _wire),
    "generators": (("on-time, us", "period, us", "open voltage, V", "pulse, peak current in A"), _generator),
}
TABLES: dict[str, Callable[..., str]] = {
    "commands": commands, "columns": columns, "letters": letters, "options": options, "parameters": parameters,
    "set-ups": set_ups,
}


if __name__ == "__main__":
    for page in pages():
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")
