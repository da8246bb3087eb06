"""How much a program may hold: what no machine could cut is refused by size and count, before work on it begins."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

MOST_BYTES = 64_000_000  # size of a file (ours: a million moves take some 20 MB)
MOST_POINTS = 500_000  # points of all outlines, curves as chords (ours: a week of cutting in steps of 40 um)
MOST_CONTOURS = 1000  # contours (ours: the wire is threaded at each)
MOST_EXTENT_MM = 10_000.0
"""Extent along x or y of what is read at all (ours: twenty times the travel of the largest table there may be)."""
LONGEST_MM = 50_000.0  # length of an entity, or of the polygon that controls it (ours: weeks of cutting)
FARTHEST_MM = 1e6  # coordinates and radii (ours: doubles tell 0.1 nm apart there)
MOST_TABLES = 2.0
"""Extent of a job over the table's travel beyond which it is refused as drawn (ours: what offset and unreachable
corners take from a drawing is far less; a job between the two is refused by the wire's path)."""
GREATEST_NUMBER = 1e9  # a number in G-code: `FARTHEST_MM` in whole um
LONGEST_DWELL_S = 86_400.0  # a dwell: a day (ours)


def read_bytes(file: Path, what: str) -> bytes:
    """Return what a file holds that is to be `what`; one that cannot be read, or is too large, is refused."""
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
    """Refuse points (n, 2) in mm that are not finite, lie too far out, span too much or make too long a line."""
    if len(points_mm) == 0:
        return
    if not bool((np.abs(points_mm) <= FARTHEST_MM).all()):
        raise InputError(f"{what} has a coordinate beyond {FARTHEST_MM:g} mm, or none: no table is so large{hint}")
    extent = float(np.ptp(points_mm, axis=0).max())
    if extent > MOST_EXTENT_MM:
        raise InputError(f"{what} spans {extent:.0f} mm: no table takes more than {MOST_EXTENT_MM:.0f} mm{hint}")
    length = float(np.hypot(*np.diff(points_mm, axis=0).T).sum())
    if length > LONGEST_MM:
        raise InputError(f"{what} is {length / 1e3:.0f} m long: at most {LONGEST_MM / 1e3:.0f} m can be cut{hint}")


def check_count(points: int) -> None:
    """Refuse more points than a program has."""
    if points > MOST_POINTS:
        raise InputError(f"{points} points, curves as chords, are too many: at most {MOST_POINTS} can be cut")


def check_contours(contours: int) -> None:
    """Refuse more contours than a wire is threaded for."""
    if contours > MOST_CONTOURS:
        raise InputError(f"{contours} contours are too many: at most {MOST_CONTOURS} can be cut")

