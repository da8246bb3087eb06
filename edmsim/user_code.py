"""Objects named by a text: in a user's Python file, ``FILE.py:NAME``, or of a kind, ``KIND:REST``."""

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

from edmsim import errors, files

MAKERS = {"policy": "edmsim.learning.policy_controller:from_name"}
"""Functions that make an object of a kind from the text after the colon: ``module:function``, imported on use."""
PASS_MAKERS = {"policy": "edmsim.learning.policy_controller:passes_from_name"}
"""The same for laws that decide on the passes of a part (`edmsim.envs.pass_laws`)."""
_OWN = re.compile(r"(?P<file>.+\.py)(?::(?P<name>[^:]*)(?::(?P<rest>.*))?)?", re.DOTALL)


class UserObject(NamedTuple):
    """An object in a user's file."""

    file: str
    name: str  # its name there; may be empty
    rest: str  # text after a second colon


def named(text: str) -> UserObject | None:
    """Split ``FILE.py:NAME:REST``; None if the text names no Python file."""
    found = _OWN.fullmatch(text)
    return None if found is None else UserObject(found["file"], found["name"] or "", found["rest"] or "")


def policy_of(text: str) -> str:
    """Return a policy's file or name without the prefix ``policy:``."""
    return text.removeprefix("policy:")


def file_of(text: str) -> str | None:
    """Return the user's file that a text names; for a policy its ``.json``, which has the hash of the ``.npz``."""
    if (own := named(text)) is not None:
        return own.file
    policy = policy_of(text)
    if policy == text or not policy.endswith((".json", ".npz")):
        return None
    return f"{policy.rpartition('.')[0]}.json"


def listed(text: str) -> list[str]:
    """Split a list at its commas, except those between the parameters of a controller."""
    pieces: list[str] = []
    for piece in text.split(","):
        if pieces and "=" in piece and ":" not in piece:
            pieces[-1] += f",{piece}"
        else:
            pieces.append(piece.strip())
    return list(dict.fromkeys(piece for piece in pieces if piece))


def make(kind: str, rest: str, makers: Mapping[str, str] = MAKERS) -> Any:
    """Make the object that ``KIND:REST`` names, by the function registered in `MAKERS` or another table."""
    return resolve_name(makers[kind])(rest)


def local_modules(file: str | Path) -> dict[str, Path]:
    """Return the modules and packages in a Python file's folder that it imports, also indirectly, by name."""
    # without edmsim, if the file is next to it, because a run has the version
    root, found, left = Path(file).parent, dict[str, Path](), [("", Path(file))]
    for package, read in left:
        names = [name.split(".") for name in _imported_by(read.read_bytes(), package)]
        for parts in (name[:end] for name in names if name[0] != "edmsim" for end in range(1, len(name) + 1)):
            module, above, place = ".".join(parts), ".".join(parts[:-1]), root.joinpath(*parts)
            for of, there in ((module, place / "__init__.py"), (above, place.with_name(f"{parts[-1]}.py"))):
                if module not in found and there.is_file():
                    found[module] = there
                    left.append((of, there))
    return found


@lru_cache(maxsize=1024)
def _imported_by(text: bytes, package: str) -> list[str]:
    """Return the names of modules that a source of a package may import; empty if it is not Python."""
    try:
        nodes = [*ast.walk(ast.parse(text))]
    except (SyntaxError, ValueError, RecursionError):
        return []
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            above = package.split(".")[: -node.level + 1 or None] if node.level else []
            parts = [part for part in (*above, node.module) if part]
            names += [".".join([*parts, alias.name]) for alias in node.names]
    return names


def run(file: str) -> ModuleType:
    """Run a Python file, again only if its text has changed; raises `InputError` if it fails."""
    return _run(str(Path(file).absolute()), files.read_text(file), file)


@lru_cache(maxsize=64)
def _run(place: str, text: str, shown: str) -> ModuleType:
    # not imported: bytecode would be saved next to the file, and used as long as the file's size and second are equal
    module = ModuleType(f"{Path(place).stem}_{hashlib.sha256((place + text).encode()).hexdigest()[:16]}")
    module.__file__ = place
    sys.modules[module.__name__] = module  # dataclasses look up the types of their fields there
    if (folder := str(Path(place).parent)) not in sys.path:
        sys.path.append(folder)  # last, so the user's files do not replace installed packages
    try:
        exec(compile(text, place, "exec"), vars(module))
        _check_imports(place)
    except errors.InputError:
        raise
    except SyntaxError as error:
        raise errors.InputError(f"is not Python: {error.msg}", shown, error.lineno) from None
    except (Exception, SystemExit) as error:
        raise failure(error, shown, "fails when it is run") from None
    return module


def _check_imports(file: str) -> None:
    """Raise `ImportError` if a module with a file in this folder was imported from elsewhere."""
    for name, here in local_modules(file).items():
        found = getattr(sys.modules.get(name), "__file__", None)
        if found and Path(found).resolve() != here.resolve():
            raise ImportError(f"{name} was imported from {found}, not from this folder: rename one of them")


def failure(error: BaseException, file: str, what: str) -> errors.InputError:
    """Return an error of the user's code as an `InputError` that names the line and its callers."""
    frames = _frames(error, file)
    callers = " from ".join(f"line {frame.lineno} in {frame.name}" for frame in reversed(frames[:-1]))
    called = f"; {frames[-1].name} was called at {callers}" if callers else ""
    said = f"{type(error).__name__}: {error}".removesuffix(": ")
    return errors.InputError(f"{what}: {said}{called}", file, frames[-1].lineno if frames else None)


def _frames(error: BaseException, file: str) -> list[FrameSummary]:
    """Return the calls in a file's code through which an error passed, the innermost last."""
    place = str(Path(file).absolute())
    return [frame for frame in extract_tb(error.__traceback__) if frame.filename == place]


@cache
def naming_failures(kind: Any, file: str, methods: tuple[str, ...]) -> Any:
    """Return a subclass of a user's class whose methods of these names raise a `failure`."""
    if hasattr(kind, "__wrapped__"):
        return kind

    def naming(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def run(*args: Any, **options: Any) -> Any:
            try:
                return method(*args, **options)
            except errors.EdmsimError as error:
                frames = [] if getattr(error, "file", None) else _frames(error, file)
                with errors.located(file, frames[-1].lineno if frames else None):
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
