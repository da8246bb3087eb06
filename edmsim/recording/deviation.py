"""How far a cut is from its drawing, in the report: where and why, by element, and which offset would be right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from edmsim.metrology.reach import WorstPlace
from edmsim.recording.quality import Quality

_WORDS = {
    "start mark": "the start mark", "out of reach": "an inner corner out of the round wire's reach",
    "inner corner": "an inner corner", "outer corner": "an outer corner", "edge": "between corners",
}
_MADE_BY = {
    "path": "the programmed path", "planner": "the planner", "drive": "the drive", "wire": "the wire's deflection",
    "gap": "the gap",
}
_RIGHT_UM = 0.5
"""A mean error below half the path's resolution cannot be programmed away."""


def deviation(quality: Quality, origin_mm: tuple[float, float]) -> dict[str, Any]:
    """Return the report's fields ``profile_error_um``, ``offset`` and ``elements``.

    Parameters
    ----------
    quality : Quality
    origin_mm : (x, y)
        Where the program's zero lies on the table.
    """
    reach, applied_mm = quality.reach, quality.offset_um * 1e-3
    return {
        "profile_error_um": {
            "max": quality.profile_max_um,
            "rms": quality.profile_rms_um,
            "p95": quality.profile_p95_um,
            "at": _place(reach.worst, origin_mm),
            "reachable": {**reach.reachable_um, "at": _place(reach.worst_reachable, origin_mm)},
            "shares": quality.profile_shares,
        },
        "offset": {
            "applied_mm": applied_mm,
            "mean_error_um": reach.mean_um,
            "to_use_mm": round(applied_mm - reach.mean_um * 1e-3, 4),
        },
        "elements": [_element(asdict(element), origin_mm) for element in reach.elements],
    }


def _place(worst: WorstPlace | None, origin_mm: tuple[float, float]) -> dict[str, Any]:
    if worst is None:
        return dict.fromkeys(("program_x_mm", "program_y_mm", "error_um", "why", "made_by"))
    return {
        "program_x_mm": worst.x_mm - origin_mm[0], "program_y_mm": worst.y_mm - origin_mm[1],
        "error_um": worst.error_um, "why": worst.why, "made_by": worst.made_by,
    }


def _element(row: dict[str, Any], origin_mm: tuple[float, float]) -> dict[str, Any]:
    """Return a row in the program's coordinates."""
    for name, zero in (("x_mm", 0), ("y_mm", 1), ("end_x_mm", 0), ("end_y_mm", 1)):
        row[f"program_{name}"] = row.pop(name) - origin_mm[zero]
    return row


def worst_line(at: Mapping[str, Any]) -> str:
    """Say where an error is largest and why."""
    if at["why"] is None:
        return "not measured"
    # 0.0 +: a hair below zero would read -0.000
    x, y = (round(at[f"program_{axis}_mm"], 6) + 0.0 for axis in "xy")
    share = None if at["why"] == "out of reach" else at["made_by"]
    made_by = "" if share is None else f", most of it by {_MADE_BY[share]}"
    return f"{at['error_um']:+.1f} µm at X {x:.3f} Y {y:.3f} mm: {_WORDS[at['why']]}{made_by}"


def deviation_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and texts for the terminal's table; reports of earlier versions have none of them."""
    profile, offset = report["profile_error_um"], report.get("offset")
    if offset is None:
        return []
    reachable = profile["reachable"]
    lines = [("largest error", worst_line(profile["at"]))]
    if profile["at"]["why"] == "out of reach":
        figures = f"{reachable['max']:.1f} µm max, {reachable['rms']:.1f} µm rms, {reachable['p95']:.1f} µm for 95 %"
        lines += [("within the wire's reach", figures), ("largest error there", worst_line(reachable["at"]))]
    return [*lines, ("offset", offset_line(offset))]


def offset_line(offset: Mapping[str, float | None]) -> str:
    """Say which offset was applied, by how much walls are off in the mean, and which offset to use instead."""
    applied, mean, better = (offset[name] for name in ("applied_mm", "mean_error_um", "to_use_mm"))
    if mean is None:
        return "–" if applied is None else f"{applied:.3f} mm"
    left = "metal left" if mean > 0 else "undercut"
    if applied is None or better is None:
        return f"different ones by contour, {mean:+.1f} µm in the mean ({left})"
    if abs(mean) < _RIGHT_UM:
        return f"{applied:.3f} mm, right within {_RIGHT_UM:g} µm in the mean"
    advice = f"use --offset {better:.3f}" if better > 0 else "more than the whole offset"
    return f"{applied:.3f} mm, {mean:+.1f} µm in the mean ({left}): {advice}"
