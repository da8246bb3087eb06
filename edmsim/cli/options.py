"""Options shared by commands; those of a cut take names, types, defaults and help from their declaration."""

import inspect
import itertools
from collections.abc import Callable
from copy import copy
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin

import typer

import edmsim
from edmsim.errors import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from edmsim.job.options import CutSettings

Program = Annotated[Path, typer.Argument(help="Part program: .ngc .nc .gcode .iso .txt .dxf", show_default=False)]
Environment = Annotated[
    str,
    typer.Argument(metavar="ENV_ID", help="Environment: edmsim/GapFeed-v2 ..., or FILE.py:ID.", show_default=False),
]
DriveAxis = Annotated[str, typer.Option(help="Axis: x or y of the machine, bench, table, fast, low-impedance.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
_Command = TypeVar("_Command", bound=Callable[..., None])
_TAKEN = "_options_taken"
SET_UP = "set-up"  # stands for the names of all options of a set-up except the machine


class Unset(NamedTuple):
    """Replaces a default: the option has none, and this text is added to its help."""

    text: str


class Among(NamedTuple):
    """Replaces a default: the default applies, but the command accepts only these names, which its help lists."""

    listed: Callable[[], list[str]]


class _Taken(NamedTuple):
    names: tuple[str, ...]
    instead: dict[str, Any]


def takes(*names: str, **instead: Any) -> Callable[[_Command], _Command]:
    """Add the options of a cut, all or those named, to a command; its ``**options`` are those that are not None."""
    # `instead`: defaults of this command that differ from those of a cut, `Unset` or `Among`

    def mark(command: _Command) -> _Command:
        setattr(command, _TAKEN, _Taken(names, instead))
        whole = inspect.signature(command, eval_str=True)
        own = [parameter for parameter in whole.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
        command.__signature__ = whole.replace(parameters=own)  # type: ignore[attr-defined]
        return command

    return mark


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose signature includes the options added by `takes`."""
    taken: _Taken | None = getattr(command, _TAKEN, None)
    if taken is None:
        return command
    from edmsim.job.options import CutOptions
    from edmsim.machine.options import SetUpOptions

    fields = CutOptions.model_fields
    named = [[*SetUpOptions.model_fields] if name == SET_UP else [name] for name in taken.names or fields]
    names = [name for name in itertools.chain(*named) if name not in _NO_FLAG]
    own = [_with_names(parameter) for parameter in inspect.signature(command).parameters.values()]
    shown = [_parameter(name, fields[name], taken) for name in names]

    def run(**values: Any) -> None:
        left_out = [name for name in names if values[name] in (None, [])]
        command(**{name: value for name, value in values.items() if name not in left_out})

    run.__signature__ = inspect.Signature([*own, *shown])  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in (*own, *shown)}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


def settings_of(options: dict[str, Any]) -> "CutSettings":
    """Return the checked options of a cut from those of a command; the others have their defaults."""
    from edmsim.job.options import CutSettings

    return CutSettings.model_validate(options)


_NO_FLAG = {"height_areas", "watch", "enter"}  # options that cannot be typed: polygons, functions


class Command(typer.core.TyperCommand):
    """A command that looks up its options when it runs or shows its help, not when all commands are listed."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return arguments and options."""
        self._complete()
        return super().get_params(ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments; refuse empty values, as of a shell's unset variable, because paths would become ``.``."""
        for before, word in itertools.pairwise(["", *args]):
            name, joined, value = word.partition("=")
            if not word or (name.startswith("--") and joined and not value):
                what = next((one for one in (name, before) if one.startswith("--")), "an argument")
                raise InputError(f"{what} is empty: give a value, or leave it out")
        typed = [word.partition("=")[0] for word in args]
        for option in self.get_params(ctx):
            if option.metavar == "A,B" and sum(map(typed.count, option.opts)) > 1:  # the last list would override it
                raise InputError(f"{option.opts[0]} appears twice: write its values with commas, as A,B")
        return super().parse_args(ctx, args)

    def _complete(self) -> None:
        plain = inspect.unwrap(self.callback) if self.callback is not None else None
        if plain is not None and hasattr(plain, _TAKEN):
            app = typer.Typer(add_completion=False)
            app.command()(with_options(plain))
            made = typer.main.get_command(app)
            self.params, self.callback = made.params, made.callback


def _with_names(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return a command's own argument or option; in its help, ``{controllers}`` is replaced by their names."""
    kind, info = get_args(parameter.annotation)
    if "{controllers}" not in info.help:
        return parameter
    listing = copy(info)
    listing.help = info.help.replace("{controllers}", ", ".join(edmsim.controllers.choices()))
    return parameter.replace(annotation=Annotated[kind, listing])


def _parameter(name: str, field: "FieldInfo", taken: _Taken) -> inspect.Parameter:
    from edmsim.machine.options import Flag, Names, fact, flag, meaning

    default = taken.instead.get(name, field.default)
    if isinstance(default, Among):
        field = copy(field)
        field.metadata, default = [Names(default.listed), *field.metadata], field.default
    own, help_text = fact(field, Flag) or Flag(), meaning(name, field).replace("``", "").replace("`", "")
    if own.many:
        help_text += " Repeatable."
    kind = _kind(field.annotation, own.many)
    if isinstance(default, Unset):
        help_text, default = f"{help_text} {default.text}", None
    if kind is not bool and default in (None, ()):
        kind, default = kind | None, None
    option = typer.Option(flag(name, field), help=help_text, metavar=own.metavar)
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option]
    )


def _kind(kind: Any, is_list: bool) -> Any:
    """Return the type as which the command line parses an option: str for all types that it does not know."""
    if is_list:
        return list[str]
    if get_origin(kind) is Annotated:
        return _kind(get_args(kind)[0], False)
    if get_origin(kind) in (UnionType, Union):
        kinds = {_kind(part, False) for part in get_args(kind) if part is not NoneType}
        return next((known for known in (Path, str) if known in kinds), None) or kinds.pop()
    return kind if kind in (bool, int, float, Path) else str
