"""Causes of the profile error: shares of programmed path, planner, drive, wire and gap, and places out of reach.

Each share is a difference of two distances from the edge: programmed path minus offset, commanded position minus
programmed path, guides minus commanded position, wire minus guides. The gap has the remainder, so the five add up to
the error. The effect of the table's errors on a part, with and without compensation, is computed separately. Metal
that no wire of this radius and gap could remove is out of reach.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam.file import PATH, PLACES
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.geometry import Floats, Polyline, arc_lengths, interpolated, left_of
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import CORNER_REACH_MM, ProfileError, edge_corners
from edmsim.plant.axes.geometric_errors import StillTable
from edmsim.program.offset import REACH_TOLERANCE_MM, distances
from edmsim.program.outline import chords_of
from edmsim.program.path import WireContour

_PASSED_UM = 20.0  # a pass was at a place if it came within its programmed distance plus this (ours)
SHARES = ("path", "planner", "drive", "wire", "gap")  # names of the shares, in the order of `error_shares`


def error_shares(
    profile: ProfileError, contour: WireContour, tracks_um: Sequence[Floats], last_pass: int | None = None
) -> Floats:
    """Split the profile error of a contour, offset above 0, into `SHARES` (5, places), which sum to ``mean_um``."""
    # `tracks_um` has the positions of command, guides and wire in order of time, in um on the table, with NaN where a
    # track is interrupted. Shares are NaN where the error is NaN, and everywhere if the contour was not begun. Of
    # several passes, shares are those of `last_pass`, the last pass that was begun (default: the last), and NaN where
    # this pass has not been
    points = profile.points_mm * 1000
    planned = np.concatenate([chords_of(line) for line in _programmed_um(contour, last_pass)])
    away = np.stack([distances(points, chords) for chords in (planned, *map(_joined, tracks_um))])
    last = profile.mean_um + contour.offset_um - away[-1]
    shares = np.concatenate([np.diff(away, axis=0, prepend=contour.offset_um), [last]])
    passed = np.isfinite(shares[-1])
    if contour.passes:
        passed &= away[1] - away[0] < _PASSED_UM
    return np.where(passed, shares, np.nan)


def _programmed_um(contour: WireContour, number: int | None = None) -> list[Floats]:
    """Return the programmed paths (n, 2) along a contour; of several passes, one (default: the last) with its tab."""
    if not contour.passes:
        return [contour.points_um[contour.lead_in_moves :].astype(np.float64)]
    number = contour.passes[-1].number if number is None else number
    passes = [one for one in contour.passes if one.number == number]
    return [one.points_um[one.approach_moves :].astype(np.float64) for one in passes]


def _joined(track: Floats) -> NDArray[np.object_]:
    """Return the chords of a measured path, which NaN interrupt."""
    chords = np.stack([track[:-1], track[1:]], axis=1)
    return np.asarray(shapely.linestrings(chords[np.isfinite(chords).all(axis=(1, 2))]), np.object_)


def share_stats(shares_um: Floats, error_um: Floats) -> dict[str, dict[str, float]]:
    """Return for every share its ``mean``, ``rms``, ``max`` (of the magnitude) and ``of_mean_square``."""
    # ``of_mean_square`` is the mean of share times error, divided by the mean square of the error: these add up to 1,
    # and that of a share which compensates for others is negative
    known = np.isfinite(shares_um).all(axis=0)
    shares, error = shares_um[:, known], error_um[known]
    if not len(error):
        return {name: dict.fromkeys(("mean", "rms", "max", "of_mean_square"), float("nan")) for name in SHARES}
    square = float(np.mean(error**2))
    return {
        name: {
            "mean": float(share.mean()), "rms": float(np.sqrt(np.mean(share**2))), "max": float(np.abs(share).max()),
            "of_mean_square": float(np.mean(share * error)) / square if square > 0 else float("nan"),
        }
        for name, share in zip(SHARES, shares, strict=True)
    }  # fmt: skip


_PATH = PLACES.index(PATH)
_TANGENT_MM = 1e-3  # a tangent is the chord from this distance before a point to this distance after it (ours)


@dataclass(frozen=True)
class TableError:
    """Displacement of a part's wall by the table's errors at a `ProfileError`'s points; positive if metal is left."""

    without_um: Floats  # (n,): with the table alone
    left_um: Floats  # (n,): with the compensation that was in force; the same if there was none


def table_error(
    machine: Machine, contour: WireContour, profile: ProfileError, elcam: Elcam | None, starts_um: Floats,
    last_pass: int | None = None,
) -> TableError:
    """Return the contribution of the table's errors to a profile error, from its positions when the wire passes."""
    # errors are those of the table at rest, without backlash. `starts_um` has the length of path before each pass.
    # The wall is that of `last_pass`, the last pass that was begun (default: the last)
    line = Polyline(contour.at_mid_height().nominal_mm, contour.closed)
    towards_left = left_of(line.tangent(profile.s_mm, _TANGENT_MM))
    away = -towards_left if contour.part_side == "left" else towards_left
    passed_um = _when_passed(contour, profile.points_mm * 1e3, starts_um, last_pass)
    return TableError(
        (_displaced_um(machine, *passed_um, None) * away).sum(axis=1),
        (_displaced_um(machine, *passed_um, elcam) * away).sum(axis=1),
    )


def _when_passed(
    contour: WireContour, points_um: Floats, starts_um: Floats, last_pass: int | None
) -> tuple[Floats, Floats, Floats]:
    """Return positions and leads (n, 2) when the wire is nearest to points, and path lengths (n,) there."""
    numbers = [one.number for one in contour.passes] or [1]
    last_pass = numbers[-1] if last_pass is None else last_pass
    nearest_um, path_um = np.full(len(points_um), np.inf), np.zeros(len(points_um))
    places_um, leads_um = np.zeros((2, len(points_um), 2))
    points = shapely.points(points_um)
    for path, number, start_um in zip(contour.wire_paths, numbers, starts_um, strict=True):
        along_um, middle_um = path.along_um, path.at_mid_height()
        line, known = shapely.LineString(middle_um), arc_lengths(middle_um)
        away_um, passed = shapely.distance(line, points), shapely.line_locate_point(line, points)
        here = (away_um < nearest_um) & (number == last_pass)
        nearest_um[here] = away_um[here]
        places_um[here] = interpolated(passed, known, path.points_um)[here]
        if path.lean is not None:
            leads_um[here] = interpolated(passed, known, path.lean.upper_um)[here]
        path_um[here] = start_um + np.interp(passed, known, along_um)[here]
    return places_um, leads_um, path_um


def _displaced_um(
    machine: Machine, points_um: Floats, leads_um: Floats, path_um: Floats, elcam: Elcam | None
) -> Floats:
    """Return the wire's true displacement from programmed positions and leads (n, 2) at path lengths (n,)."""
    table, step_um = StillTable(machine, nuts=False), machine.base.table.step_um.value
    elcam = copy.deepcopy(elcam)  # the original may be in use
    for one in () if elcam is None else elcam.tables.values():
        one.reversal = 0.0  # omitted, as is the backlash that it corrects
    compensation = None if elcam is None else StepCompensation(elcam, step_um)
    found = []
    for (x, y), (u, v), path in zip(points_um.tolist(), leads_um.tolist(), path_um.tolist(), strict=True):
        motors = (x, y) if compensation is None else compensation.begin((x, y), path, (u, v))
        found.append(table.move(motors, u if compensation is None else u + compensation.upper_um[0]))
    return np.array(found).reshape(-1, 2) - points_um


def motor_offsets_um(
    machine: Machine, motors_um: Floats, program_um: Floats, path_um: Floats, elcam: Elcam | None
) -> tuple[Floats, Floats]:
    """Return the offsets of motor positions (n, 2), in order of time, from the program and from the table."""
    # the compensation is looked up at the motor positions, which differ from the programmed ones only by the
    # compensation itself, and at the path lengths (n,). If it depends on direction, programmed positions are needed
    table = StillTable(machine, nuts=False)
    tables = [] if elcam is None else elcam.tables.values()
    reverses = any(one.reversal for one in tables)
    by_path = reverses or any(_PATH in (one.master, one.row_axis) for one in tables)
    looked_up_um = program_um if reverses else motors_um
    states = np.column_stack([motors_um, looked_up_um, path_um if by_path else np.zeros(len(motors_um))])
    places, which = (states, np.arange(len(states))) if reverses else np.unique(states, axis=0, return_inverse=True)
    program, offsets = np.zeros((len(places), 2)), np.zeros((len(places), 2))
    compensation = None
    if elcam is not None:
        compensation = StepCompensation(copy.deepcopy(elcam), machine.base.table.step_um.value)
    for k, (x, y, at_x, at_y, path) in enumerate(places.tolist()):
        if compensation is not None:
            compensation.begin((at_x, at_y), path)
            program[k] = compensation.offset_um
        offsets[k] = places[k, :2] - table.move((x, y), 0.0 if compensation is None else compensation.upper_um[0])
    return program[which.reshape(-1)], offsets[which.reshape(-1)]


@dataclass(frozen=True)
class WorstPlace:
    """Place of the largest error, on the table; the error is positive if metal is left."""

    x_mm: float
    y_mm: float
    error_um: float
    why: str  # start mark, out of reach (the round wire leaves most of it), inner corner, outer corner or edge
    made_by: str | None  # name of the error's largest share (`SHARES`); None if they are unknown


def unreachable_um(profile: ProfileError, contour: WireContour) -> Floats:
    """Return the metal (n,) in um that a wire exactly on its path leaves at the edge; 0 within the tolerance."""
    path = shapely.MultiLineString([line / 1000 for line in _programmed_um(contour)])
    left_um = shapely.distance(path, shapely.points(profile.points_mm)) * 1e3 - contour.offset_um
    return np.where(left_um > REACH_TOLERANCE_MM * 1e3, left_um, 0.0)


def mean_error_um(
    contours: Sequence[WireContour], profiles: Sequence[ProfileError], unreachable: Sequence[Floats]
) -> float:
    """Return the mean error in um of walls, without corners, start marks and places out of reach.

    The offset was too large by this error. Uncompensated contours do not count; NaN if nothing was measured.
    """
    known = []
    for contour, profile, left_um in zip(contours, profiles, unreachable, strict=True):
        if not contour.compensated:
            continue
        line = Polyline(contour.nominal_mm, contour.closed)
        corner = line.distance_along(profile.s_mm, line.s[edge_corners(contour, line)]) <= CORNER_REACH_MM
        error = profile.error_um[:, ~corner & ~profile.at_lead_in & (left_um == 0)]
        known.append(error[np.isfinite(error)])
    every = np.concatenate([np.zeros(0), *known])
    return float(every.mean()) if len(every) else math.nan


def worst_place(
    contours: Sequence[WireContour], profiles: Sequence[ProfileError], unreachable: Sequence[Floats],
    shares: Sequence[Floats | None], reachable: bool,
) -> WorstPlace | None:
    """Find the largest error over all contours and slices; metal out of reach does not count if `reachable`."""
    worst: WorstPlace | None = None
    for contour, profile, left_um, split in zip(contours, profiles, unreachable, shares, strict=True):
        error = profile.error_um - left_um if reachable else profile.error_um
        if not np.isfinite(error).any():
            continue
        row, place = np.unravel_index(np.nanargmax(np.abs(error)), error.shape)
        largest = float(error[row, place])
        if worst is None or abs(largest) > abs(worst.error_um):
            x, y = profile.points_mm[place].tolist()
            out_of_reach = not reachable and left_um[place] > abs(largest) / 2
            why = "out of reach" if out_of_reach else _what_lies_at(contour, profile, int(place))
            made_by = None
            if split is not None and np.isfinite(split[:, place]).all():
                parts = dict(zip(SHARES, split[:, place].tolist(), strict=True))
                parts["path"] -= left_um[place] if reachable else 0.0
                made_by = max(SHARES, key=lambda name: abs(parts[name]))
            worst = WorstPlace(x, y, largest, why, made_by)
    return worst


def _what_lies_at(contour: WireContour, profile: ProfileError, place: int) -> str:
    if profile.at_lead_in[place]:
        return "start mark"
    line = Polyline(contour.nominal_mm, contour.closed)
    vertices = edge_corners(contour, line)
    away = np.array([line.distance_along(profile.s_mm[[place]], line.s[[k]])[0] for k in vertices])
    if not len(away) or away.min() > CORNER_REACH_MM:
        return "edge"
    left_turn = line.turn_deg[vertices[away.argmin()]] > 0
    return "outer corner" if left_turn == (contour.part_side == "left") else "inner corner"
