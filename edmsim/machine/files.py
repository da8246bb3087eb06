"""Files a set-up is read from: those under `models/` by name, and users' own by path."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from edmsim import models
from edmsim.errors import InputError, one_of
from edmsim.machine.options import Kind, available
from edmsim.machine.parts import Base, Part

_MOST_BYTES = 1_000_000
_Part = TypeVar("_Part", bound=Part)


def read(part: type[_Part], kind: Kind, name: str) -> _Part:
    """Read a part of a set-up from a name under `models/` or an own TOML file.

    A file that says ``like = "agiecut-dem15"`` has the constants of that one of ours where it gives none itself.
    """
    if name.endswith(".toml"):
        file, text = name, _own_file(name)
    else:
        file, text = f"models/{kind}/{name}.toml", _our_file(kind, name)
    try:
        data: dict[str, Any] = tomllib.loads(text)
        like = data.pop("like", None)
        if like is not None:
            data = _overlaid(tomllib.loads(_our_file(kind, str(like), file)), data)
        return part.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "file"
        raise InputError(f"key '{key}': {first['msg']}", file) from None
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, and brackets within brackets, too
        raise InputError(f"not valid TOML: {error}", file) from None


def _our_file(kind: Kind, name: str, referring_file: str | None = None) -> str:
    names = available(kind)
    if name not in names:
        raise InputError(f"unknown {kind[:-1]} '{name}'; there are: {one_of(name, names)}", referring_file)
    return (resources.files("edmsim.models") / kind / f"{name}.toml").read_text(encoding="utf-8")


def _overlaid(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return what a file says on top of the one it is like: constants, whole, and what no section holds."""
    sections = {
        key: {**below[key], **value}
        for key, value in above.items()
        if isinstance(value, dict) and isinstance(below.get(key), dict) and "value" not in value
    }
    return {**below, **above, **sections}


def read_base(name: str) -> Base:
    """Read a machine file and find the MJCF it names; see `read`."""
    base = read(Base, "machines", name)
    return base.model_copy(update={"model": own_mjcf(base.model, name)}) if name.endswith(".toml") else base


def own_mjcf(name: str, file: str) -> str:
    """Return which MJCF a user's machine file means: the absolute path of the one beside it, or a name of ours."""
    sibling = Path(file).absolute().parent / name
    if sibling.is_file():
        return str(sibling)
    if not (Path(models.__file__).parent / name).is_file():
        raise InputError(f"key 'model': there is no MJCF {name!r} in this file's folder or in edmsim", file)
    return name


def own_mjcf_text(model_file: str) -> str:
    """Return the text of a user's MJCF; nothing of ours, which belongs to the version of edmsim."""
    return Path(model_file).read_text(encoding="utf-8") if Path(model_file).is_absolute() else ""


def mjcf_version(model_file: str) -> int:
    """Return a number that changes when a user's MJCF does; 0 for ours."""
    return Path(model_file).stat().st_mtime_ns if Path(model_file).is_absolute() else 0


def _own_file(name: str) -> str:
    try:
        if Path(name).stat().st_size > _MOST_BYTES:
            raise InputError(f"this is not a file of constants: it is larger than {_MOST_BYTES / 1e6:g} MB", name)
        return Path(name).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"byte {error.start} is not UTF-8: save the file as UTF-8", name) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", name) from None
