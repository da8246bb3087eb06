"""A DXF file opened: by the strict reader of the library, or where that fails by the one that recovers."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from edmsim.errors import InputError
from edmsim.program.entities import SHAPES, named
from edmsim.program.irregular import regular
from edmsim.program.limits import check_size

if TYPE_CHECKING:
    from ezdxf.document import Drawing

_BINARY_DXF = b"AutoCAD Binary DXF\r\n\x1a\x00"
_UTF16 = re.compile(rb"\xff\xfe|\xfe\xff|(\s\0)*\d\0|(\0\s)*\0\d")
_UNIT = "$INSUNITS"
_EXPORT = "export it as DXF again"
_COMPARE = "compare the picture of its path with it"

Found = TypeVar("Found")


def look_into(path: Path, look: Callable[[Drawing], Found]) -> tuple[Found, list[str]]:
    """Open a drawing and return what is found in it.

    Parameters
    ----------
    path : path
    look : callable
        Takes the document. What it raises besides `InputError` says that the document is damaged.

    Returns
    -------
    found
    notices : list of str
        How the file is irregular, in one, and what of it is not cut.

    Raises
    ------
    InputError
        No DXF drawing, or one so damaged that parts of it are lost.
    """
    from ezdxf.filemanagement import readfile

    data = _read(path)
    with _heard() as warnings:
        try:
            found = look(_without_own_unit(readfile(path), data))
        except InputError:
            raise
        except Exception:  # the library lets errors of any kind through, here and below
            pass
        else:
            return found, [f"the drawing is irregular ({_summed_up(warnings)}): {_COMPARE}"] if warnings else []
        if data.startswith(_BINARY_DXF):
            raise InputError(f"this binary DXF drawing is damaged: {_EXPORT}")
        drawing = regular(data)
        try:
            found = look(_without_own_unit(_recovered(drawing.text), data))
        except InputError:
            raise
        except Exception:
            if drawing.foreign:
                raise InputError(f"{named(drawing.foreign[0])} cannot be cut: draw {SHAPES}") from None
            raise InputError(f"this DXF drawing is damaged, its contents cannot be read: {_EXPORT}") from None
    left_out = [f"{count} {kind} left out" for kind, count in sorted(drawing.left_out.items())]
    return found, [f"the drawing is irregular and is read by recovering what it holds: {_COMPARE}", *left_out]


def _read(path: Path) -> bytes:
    if path.is_dir():
        raise InputError("this is a directory: give the path of a DXF drawing")
    if not path.exists():
        raise InputError("no such file: give the path of a DXF drawing")
    check_size(path)
    try:
        data = path.read_bytes()
    except OSError:
        raise InputError("this file cannot be read: see who may read it") from None
    _refuse_others(data)
    return data


def _refuse_others(data: bytes) -> None:
    """Say what a file is that is no DXF drawing."""
    if data.startswith(_BINARY_DXF):
        return
    if not data.strip():
        raise InputError(f"this file is empty: {_EXPORT}")
    if re.match(rb"AC1[.\d]|AC2\.|MC0\.", data):
        raise InputError("this is a DWG file, whatever its name: save it as DXF")
    if _UTF16.match(data):
        raise InputError("this is text in UTF-16: save it as UTF-8")
    if not re.match(rb"(\xef\xbb\xbf)?\s*-?\d+\s*[\r\n]", data):
        kind = "a binary file" if b"\0" in data else "text that does not begin with a group code"
        raise InputError(f"this is no DXF drawing but {kind}: {_EXPORT}")


def _without_own_unit(document: Drawing, data: bytes) -> Drawing:
    """Take out the unit that the library sets where a drawing says none."""
    if _UNIT.encode() not in data and _UNIT in document.header:
        del document.header[_UNIT]
    return document


def _recovered(data: bytes) -> Drawing:
    from ezdxf import recover
    from ezdxf.audit import AuditError as Flaw

    document, repairs = recover.read(io.BytesIO(data))
    losses = {
        Flaw.REMOVED_INVALID_GRAPHIC_ENTITY, Flaw.REMOVED_ENTITY_WITH_INVALID_OWNER_HANDLE,
        Flaw.INVALID_ENTITY_HANDLE, Flaw.UNDEFINED_BLOCK, Flaw.UNDEFINED_BLOCK_NAME, Flaw.INVALID_SPLINE_DEFINITION,
        Flaw.INVALID_SPLINE_CONTROL_POINT_COUNT, Flaw.INVALID_SPLINE_FIT_POINT_COUNT,
        Flaw.INVALID_SPLINE_KNOT_VALUE_COUNT, Flaw.INVALID_SPLINE_WEIGHT_COUNT, Flaw.FOUND_TAG_OUTSIDE_SECTION,
        Flaw.MISSING_SECTION_NAME_TAG,
    }  # fmt: skip
    lost = sum(entry.code in losses for entry in (*repairs.errors, *repairs.fixes))
    if lost:
        raise InputError(f"this DXF drawing is damaged, {lost} of its parts cannot be read: {_EXPORT}")
    return document


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Collect the library's warnings instead of printing them."""
    heard: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            heard.append(record.getMessage())

    logger, listener = logging.getLogger("ezdxf"), Listener(logging.WARNING)
    propagate = logger.propagate
    logger.addHandler(listener)
    logger.propagate = False
    try:
        yield heard
    finally:
        logger.removeHandler(listener)
        logger.propagate = propagate


def _summed_up(warnings: list[str]) -> str:
    others = f", and {len(warnings) - 1} more" if len(warnings) > 1 else ""
    return f"{warnings[0].rstrip('. ')}{others}"
