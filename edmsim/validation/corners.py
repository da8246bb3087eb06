"""Corner error of a wire that trails its guides at a constant lag."""

import math

import numpy as np
from shapely import LineString, Point, Polygon

from edmsim import models
from edmsim.geometry import pursuit
from edmsim.validation.rows import Checks, Row, Seeds, worst

TRACTRIX = "constant-lag pursuit through a sharp corner, derived: lengths in units of the lag"
COLUMNS = {
    "min_distance_corner_to_wire_path_over_delta": "nearest approach",
    "undercut_area_over_delta2": "undercut area",
    "max_normal_deviation_over_delta": "largest distance from the path",
}
REACH = 20.0  # length of the corner's sides in lags: long enough for the wire to return to the path


def corner(turn_deg: float) -> tuple[float, float, float]:
    """Return nearest approach to the corner, uncut area inside it, and largest distance from the path, at lag 1."""
    turn = math.radians(turn_deg)
    end = (REACH * math.cos(turn), REACH * math.sin(turn))
    guides = LineString([(-REACH, 0.0), (0.0, 0.0), end])
    wire = pursuit(guides.coords, 1.0)[1:]  # without the motion to the first point
    undercut = Polygon([*wire, end, (0.0, 0.0)]).area
    path = LineString(wire).segmentize(1e-3)
    off = max(Point(point).distance(guides) for point in path.coords[1:] if np.hypot(*point) < REACH / 2)
    return path.distance(Point(0.0, 0.0)), undercut, off


def check_corners(seeds: Seeds) -> list[Row]:
    """Compare all 8 rows of the table; for every turn the quantity that differs most is shown."""
    rows = []
    for row in models.published("analytic_corner_pursuit_model"):
        turn = float(row["path_turn_deg"])
        compared = [
            (float(row[column]), simulated, name)
            for (column, name), simulated in zip(COLUMNS.items(), corner(turn), strict=True)
        ]
        published, simulated, name = worst(compared)
        rows.append(Row.value(
            "corner", f"turn of {turn:g} degrees at constant lag (worst of {len(compared)}: {name})", TRACTRIX,
            published=published, simulated=simulated, within=0.002,
        ))
    return rows


CHECKS: Checks = dict.fromkeys((check_corners,), ("corner",))
