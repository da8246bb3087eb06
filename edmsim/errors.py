"""Errors that users see: for bad input, one line with what is wrong, where, and what would be right."""

import errno
import os
import re
import sys
from collections import abc
from contextlib import contextmanager
from difflib import get_close_matches
from functools import wraps
from inspect import formatannotation, isfunction
from numbers import Number
from typing import Any, ParamSpec, Protocol, TypeVar

FAILED, BAD_INPUT, STOPPED, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses of a command: the model left its range of validity, or another failure; bad usage or input; the
machine stopped before the end; interrupted by the user."""


LONGEST_REASON, LONGEST_PLACE = 2000, 300
"""Greatest lengths of a reason and of a file name, in characters; longer ones lose their middle (ours)."""


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a full disk, an exceeded quota, and a file of the greatest allowed size."""


_NEAR = 0.75
"""Similarity from which a name is suggested (ours: one letter in four may be wrong)."""


_REASONS = {"missing": "missing", "extra_forbidden": "unknown", "model_type": "must be a table"}
"""Our wording of pydantic's error types."""


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_Class = TypeVar("_Class", bound=type)
_File = str | os.PathLike[str] | None


class EdmsimError(Exception):
    """Base class of all errors of edmsim."""


class InputError(EdmsimError):
    """An input of the user is invalid.

    Parameters
    ----------
    reason : str
        One sentence: what is wrong, the offending value, and what would be right.
    file : path, optional
        The file it was read from.
    line : int, optional
        The line in that file, counted from 1.
    """

    def __init__(self, reason: str, file: _File = None, line: int | None = None) -> None:
        self.reason = one_line(reason)
        super().__init__(self.reason)
        self.file = None if file is None else str(file)
        self.line = line

    def __str__(self) -> str:
        """Return ``file:line: reason``, without the parts that are unknown."""
        place = "" if self.file is None else one_line(self.file, LONGEST_PLACE)
        if self.line is not None:
            place += f":{self.line}"
        return f"{place}: {self.reason}" if place else self.reason


class WrongTypeError(InputError):
    """An argument has the wrong type; the caller may know the argument by another name."""


class CombinationError(InputError):
    """Values that are valid one by one, but not together."""


@contextmanager
def located(file: _File = None, line: int | None = None, name: str = "") -> abc.Iterator[None]:
    """Add a file, a line and a prefix to input errors raised inside, where they have none."""
    try:
        yield
    except InputError as error:
        error.reason = one_line(f"{name}: {error.reason}") if name else error.reason
        error.file, error.line = error.file or (None if file is None else str(file)), error.line or line
        raise


def refuses_wrong_types(function: abc.Callable[_Arguments, _Result]) -> abc.Callable[_Arguments, _Result]:
    """Let a function refuse non-booleans for a bool and texts for a list; if it fails, name a wrong argument."""
    kinds = {name: _shown(kind) for name, kind in function.__annotations__.items() if name != "return"}
    switches = {name for name, kind in kinds.items() if kind == "bool"}
    lists = {name for name, kind in kinds.items() if re.fullmatch(r"(Sequence|Iterable)\[str\]( \| None)?", kind)}

    def arguments(args: tuple[object, ...], options: dict[str, object]) -> abc.Iterator[tuple[str, object]]:
        yield from (*zip(function.__code__.co_varnames, args, strict=False), *options.items())

    @wraps(function)
    def run(*args: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
        for name, value in arguments(args, options) if switches or lists else ():
            if name in switches and type(value).__name__ != "bool":  # Python's or numpy's bool
                raise WrongTypeError(f"{name} is {value!r}: give True or False")
            if name in lists and isinstance(value, str):
                raise WrongTypeError(f"{name} is the text {value!r}: give a list, as [{value!r}]")
        try:
            return function(*args, **options)
        except (AttributeError, LookupError, TypeError, ValueError, WrongTypeError):
            for name, value in arguments(args, options):
                kind = kinds.get(name, "Any")
                if not _may_be(value, kind, function.__globals__):
                    shown = one_line(repr(value), LONGEST_PLACE)
                    raise WrongTypeError(f"{name} cannot be {shown}: give {kind}") from None
            raise

    return run


def methods_refuse_wrong_types(kind: _Class) -> _Class:
    """Apply `refuses_wrong_types` to all public methods of a class and to its constructor."""
    for name, method in [*vars(kind).items()]:
        if isfunction(method) and (name == "__init__" or not name.startswith("_")):
            setattr(kind, name, refuses_wrong_types(method))
    return kind


def _shown(annotation: object) -> str:
    """Return an evaluated annotation as text, without module names."""
    return annotation if isinstance(annotation, str) else re.sub(r"\w+\.", "", formatannotation(annotation))


_PLAIN = {"None", "Path", "bool", "float", "int", "str"}


def _may_be(value: object, kind: str, known: abc.Mapping[str, object]) -> bool:
    """Return whether a value may have an annotated type; True if a class of another package makes this uncertain."""
    own, kinds = type(value), set(re.findall(r"\w+", re.sub(r"\[[^|]*\]", "", kind)))
    taken = {"Any", "object", "None" if value is None else own.__name__}
    taken |= {"float"} if own is int else {"Literal"} if own is str else set()
    if own.__module__ != "builtins":
        classes = [known.get(name) for name in kinds - _PLAIN]
        if not all(_is_own(one) for one in classes):
            return True
        plain = (Number, os.PathLike) if kinds & _PLAIN else ()
        return isinstance(value, (*classes, *plain))  # type: ignore[arg-type]
    if taken & kinds:
        return True
    return any(isinstance(value, getattr(abc, name)) for name in kinds & {*abc.__all__})


def _is_own(kind: object) -> bool:
    return isinstance(kind, type) and kind.__module__.startswith(__package__) and not issubclass(kind, Protocol)


def refused_entry(error: Any) -> tuple[str, str]:
    """Return the first entry that pydantic refused, as ``table.key``, and the reason in terms of the file."""
    first = error.errors()[0]
    said = re.sub(r"^\w+ should\b", "must", re.sub("^Value error, | after validation", "", first["msg"]))
    return ".".join(map(str, first["loc"])), _REASONS.get(first["type"], said)


def invalid_entry(error: Any) -> str:
    """Return the first entry that pydantic refused, with the reason, in one line."""
    place, reason = refused_entry(error)
    return f"{place + ': ' if place else ''}{reason}"


def one_of(name: object, known: abc.Iterable[str], listed: abc.Iterable[str] | None = None) -> str:
    """Return the end of a refusal: the valid names (or those to list), and the one most similar to the wrong name."""
    by_lower = {one.lower(): one for one in known}
    near = get_close_matches(str(name).lower(), by_lower, n=1, cutoff=_NEAR)
    hint = f"; did you mean '{by_lower[near[0]]}'?" if near else ""
    return ", ".join(by_lower.values() if listed is None else listed) + hint


def refuse_unknown(what: str, name: object, known: abc.Iterable[str], file: _File = None) -> None:
    """Refuse a name that is not among the valid ones."""
    names = [*known]
    if not isinstance(name, abc.Hashable) or name not in names:  # comparing an array with a name gives an array
        raise InputError(f"unknown {what} {name!r}; there are: {one_of(name, names)}", file)


def one_line(text: str, longest: int = LONGEST_REASON) -> str:
    """Return a message as one line of at most ``longest`` characters; unprintable characters become blanks."""
    shown = text if text.isprintable() else "".join(c if c.isprintable() else " " for c in text)
    if len(shown) <= longest:
        return shown
    return f"{shown[: longest - 105]} ... {shown[-100:]}"


def run_command(run: abc.Callable[[], object]) -> None:
    """Run a command; an `EdmsimError` becomes one line on standard error and an exit status."""
    try:
        run()
    except (EdmsimError, ImportError, SystemError) as error:
        if _is_interrupted(error):
            sys.exit(INTERRUPTED)
        if not isinstance(error, EdmsimError):
            raise
        print("edmsim: " + " ".join(str(error).splitlines()), file=sys.stderr)
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            print(f"edmsim: {InputError('the name is too long for a file', error.filename)}", file=sys.stderr)
            sys.exit(BAD_INPUT)
        if error.errno not in _FULL:
            raise
        what = f"{error.filename}:"
        if error.filename is None:  # standard output failed, and Python would try to flush it again at exit
            what = "the standard output"
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"edmsim: {what} cannot be written: {error.strerror}", file=sys.stderr)
        sys.exit(FAILED)


def _is_interrupted(error: BaseException | None) -> bool:
    """Return whether an error comes from an import that Ctrl-C ended; compiled modules replace the exception."""
    while error is not None:
        if isinstance(error, ImportError | SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
