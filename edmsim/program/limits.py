"""Limits on size and contents of programs; programs that no machine could cut are refused before processing."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

MOST_BYTES = 64_000_000  # size of a file (ours: a million moves take some 20 MB)
MOST_POINTS = 500_000  # points of all outlines, curves as chords (ours: a week of cutting in steps of 40 um)
MOST_CONTOURS = 1000  # contours (ours: the wire is threaded at each)
MOST_EXTENT_MM = 10_000.0
"""Greatest extent of a program along x or y (ours: twenty times the travel of the largest table allowed)."""
LONGEST_MM = 50_000.0  # length of an entity, or of its control polygon (ours: weeks of cutting)
FARTHEST_MM = 1e6  # coordinates and radii (ours: doubles resolve 0.1 nm there)
MOST_TABLES = 2.0
"""Greatest extent of a job as drawn, in travels of the table (ours: offset and unreachable corners reduce a drawing
by far less; a job between one and two travels is refused if the wire's path does not fit)."""
GREATEST_NUMBER = 1e9  # a number in G-code: `FARTHEST_MM` in whole um
LONGEST_DWELL_S = 86_400.0  # a dwell: a day (ours)


def read_bytes(file: Path, what: str) -> bytes:
    """Return the bytes of a file; if it is unreadable or too large, raise an `InputError` that calls it `what`."""
    try:
        size = file.stat().st_size
        data = file.read_bytes() if size <= MOST_BYTES else b""
    except FileNotFoundError:
        raise InputError(f"no such file: give the path of {what}", file) from None
    except IsADirectoryError:
        raise InputError(f"this is a directory: give the path of {what}", file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file) from None
    except ValueError as error:  # a name with a zero byte
        raise InputError(f"cannot be read: {error}", file) from None
    if size > MOST_BYTES:
        raise InputError(f"{size / 1e6:.0f} MB are more than a program has: at most {MOST_BYTES / 1e6:.0f} MB", file)
    return data


def check_points(points_mm: NDArray[np.float64], what: str, hint: str = "") -> None:
    """Refuse points (n, 2) in mm that are not finite, are too far out, span too much or form too long a line."""
    if len(points_mm) == 0:
        return
    if not bool((np.abs(points_mm) <= FARTHEST_MM).all()):
        raise InputError(f"{what} has a coordinate beyond {FARTHEST_MM:g} mm, or NaN: no table is so large{hint}")
    extent = float(np.ptp(points_mm, axis=0).max())
    if extent > MOST_EXTENT_MM:
        raise InputError(f"{what} spans {extent:.0f} mm: no table takes more than {MOST_EXTENT_MM:.0f} mm{hint}")
    length = float(np.hypot(*np.diff(points_mm, axis=0).T).sum())
    if length > LONGEST_MM:
        raise InputError(f"{what} is {length / 1e3:.0f} m long: at most {LONGEST_MM / 1e3:.0f} m can be cut{hint}")


def check_count(points: int) -> None:
    """Refuse more than `MOST_POINTS` points."""
    if points > MOST_POINTS:
        raise InputError(f"{points} points, curves as chords, are too many: at most {MOST_POINTS} can be cut")


def check_contours(contours: int) -> None:
    """Refuse more than `MOST_CONTOURS` contours."""
    if contours > MOST_CONTOURS:
        raise InputError(f"{contours} contours are too many: at most {MOST_CONTOURS} can be cut")

