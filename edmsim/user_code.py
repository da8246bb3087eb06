"""Code named by a text: the user's Python file, ``FILE.py:NAME``, or a kind, ``KIND:REST``."""

import ast
import hashlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache, lru_cache, wraps
from inspect import getattr_static, isfunction
from pathlib import Path
from pkgutil import resolve_name
from traceback import FrameSummary, extract_tb
from types import ModuleType
from typing import Any, NamedTuple

from edmsim.errors import EdmsimError, InputError, located
from edmsim.files import read_text

MAKERS: dict[str, str] = {}
"""What makes something of a kind from the text behind its colon: ``module:function``, imported when first wanted."""
PASS_MAKERS: dict[str, str] = {}
"""The same of what decides on the passes of a part (`edmsim.envs.pass_laws`)."""
_OWN = re.compile(r"(?P<file>.+\.py)(?::(?P<name>[^:]*)(?::(?P<rest>.*))?)?", re.DOTALL)


class UserObject(NamedTuple):
    """Something in a user's file."""

    file: str
    name: str  # what it is called there; empty if nothing was named
    rest: str  # what stood behind a second colon


def named(text: str) -> UserObject | None:
    """Take ``FILE.py:NAME:REST`` apart; None if the text names no Python file."""
    found = _OWN.fullmatch(text)
    return None if found is None else UserObject(found["file"], found["name"] or "", found["rest"] or "")


def policy_of(text: str) -> str:
    """Return a policy's file or name, without the prefix ``policy:`` that it has as a controller."""
    return text.removeprefix("policy:")


def file_of(text: str) -> str | None:
    """Return the user's file that a text names; of a policy the ``.json``, which has the hash of its ``.npz``."""
    if (own := named(text)) is not None:
        return own.file
    policy = policy_of(text)
    if policy == text or not policy.endswith((".json", ".npz")):
        return None
    return f"{policy.rpartition('.')[0]}.json"


def listed(text: str) -> list[str]:
    """Split a list at its commas, but for those between the numbers of a controller: ``a:x=1,y=2,b,b`` is two."""
    pieces: list[str] = []
    for piece in text.split(","):
        if pieces and "=" in piece and ":" not in piece:
            pieces[-1] += f",{piece}"
        else:
            pieces.append(piece.strip())
    return list(dict.fromkeys(piece for piece in pieces if piece))


def make(kind: str, rest: str, makers: Mapping[str, str] = MAKERS) -> Any:
    """Make what ``KIND:REST`` names, by the function registered in `MAKERS`, or in others."""
    return resolve_name(makers[kind])(rest)


def imported_by(text: str | bytes) -> list[str]:
    """Return the names of the modules that a Python text imports; raises `SyntaxError` if it is not Python."""
    nodes = [*ast.walk(ast.parse(text))]
    plain = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return plain + [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]


def run(file: str) -> ModuleType:
    """Run a Python file, once as long as its text stays the same; raises `InputError` if it fails."""
    return _run(str(Path(file).absolute()), read_text(file), file)


@lru_cache(maxsize=64)
def _run(place: str, text: str, shown: str) -> ModuleType:
    # no import: that would keep bytecode beside the file, and take it for new as long as size and second are the same
    module = ModuleType(f"{Path(place).stem}_{hashlib.sha256((place + text).encode()).hexdigest()[:16]}")
    module.__file__ = place
    sys.modules[module.__name__] = module  # where dataclasses look for the names of their fields' types
    if (folder := str(Path(place).parent)) not in sys.path:
        sys.path.append(folder)  # last, so that no file of the user's takes the place of an installed package
    try:
        exec(compile(text, place, "exec"), vars(module))
        _check_imports(text, Path(place).parent)
    except InputError:
        raise
    except SyntaxError as error:
        raise InputError(f"is not Python: {error.msg}", shown, error.lineno) from None
    except (Exception, SystemExit) as error:
        raise failure(error, shown, "fails when it is run") from None
    return module


def _check_imports(text: str, folder: Path) -> None:
    """Raise `ImportError` if a module of the file's folder was imported from another one."""
    for name in imported_by(text):
        file, found = folder / f"{name}.py", getattr(sys.modules.get(name), "__file__", None)
        if found and file.is_file() and Path(found).resolve() != file.resolve():
            raise ImportError(f"{name} was imported from {found}, not from this folder: rename one of them")


def failure(error: BaseException, file: str, what: str) -> InputError:
    """Return an error of the user's code as one that names the line of the file where it arose, and its callers."""
    frames = _frames(error, file)
    callers = " from ".join(f"line {frame.lineno} in {frame.name}" for frame in reversed(frames[:-1]))
    called = f"; {frames[-1].name} was called at {callers}" if callers else ""
    said = f"{type(error).__name__}: {error}".removesuffix(": ")
    return InputError(f"{what}: {said}{called}", file, frames[-1].lineno if frames else None)


def _frames(error: BaseException, file: str) -> list[FrameSummary]:
    """Return the calls of a file's code that an error came through, the innermost last."""
    place = str(Path(file).absolute())
    return [frame for frame in extract_tb(error.__traceback__) if frame.filename == place]


@cache
def naming_failures(kind: Any, file: str, methods: tuple[str, ...]) -> Any:
    """Return a user's class whose methods of these names fail with a `failure`; such a class as it is."""
    if hasattr(kind, "__wrapped__"):
        return kind

    def naming(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def run(*args: Any, **options: Any) -> Any:
            try:
                return method(*args, **options)
            except EdmsimError as error:
                frames = [] if getattr(error, "file", None) else _frames(error, file)
                with located(file, frames[-1].lineno if frames else None):
                    raise
            except (Exception, SystemExit) as error:
                raise failure(error, file, f"{kind.__name__}.{method.__name__} fails") from error

        return run

    found = {name: getattr_static(kind, name, None) for name in methods}
    own = {name: naming(method) for name, method in found.items() if isfunction(method)}
    about = {"__module__": kind.__module__, "__doc__": kind.__doc__, "__wrapped__": kind}
    if kind.__reduce__ is object.__reduce__:  # pickle finds the user's class by the name that both have
        about["__reduce__"] = lambda self: (_remade, (kind, file, methods), self.__getstate__())
    return type(kind.__name__, (kind,), {**about, **own})


def _remade(kind: Any, file: str, methods: tuple[str, ...]) -> Any:
    """Return an instance of what `naming_failures` returns, without its state."""
    named = naming_failures(kind, file, methods)
    return named.__new__(named)
