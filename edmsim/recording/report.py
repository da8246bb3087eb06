"""The report of a cut: ``report.json`` and its picture on the terminal, with how far the part is from its drawing."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from edmsim.files import replacing
from edmsim.metrology.reach import WorstPlace
from edmsim.recording.quality import Quality, Totals
from edmsim.recording.windows import column, lag_along_um

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import RenderableType


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
    """Return the report's fields ``profile_error_um``, ``offset`` and ``elements``, in the program's coordinates."""
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


def build_report(
    *,
    outcome: str,
    reason: str | None,
    windows: pa.Table,
    totals: Totals,
    quality: Quality,
    notices: Iterable[str],
    seed: int,
    settings: Mapping[str, Any],
    version: str,
    origin_mm: tuple[float, float],
) -> dict[str, Any]:
    """Return the report of a cut, ready for JSON; a figure that could not be obtained is None, never NaN."""
    # means over machine time are weighted by the pulse period, as windows count pulses
    report = {
        "outcome": outcome,
        "reason": reason,
        **_machining(windows, totals),
        "origin_mm": dict(zip("xy", origin_mm, strict=True)),
        **_part(quality, origin_mm),
        "heights": [asdict(row) for row in quality.heights],
        "passes": [asdict(row) for row in quality.passes],
        "wire": _wire(windows, totals),
        "following_error_um": _following(windows),
        "coverage": {"mean": _mean(windows, "coverage"), "max": _most(windows, "coverage")},
        "surface": {name: getattr(quality, name) for name in ("ra_um", "heat_affected_um", "electrolysed_um")},
        "energy_J": totals.energy,
        "removed_mm3": totals.removed_mm3,
        "mean_current_A": _mean(windows, "mean_current_A"),
        "mean_voltage_V": _mean(windows, "mean_voltage_V"),
        "equalising": _equalising(windows, totals),
        "seed": seed,
        "settings": dict(settings),
        "notices": list(notices),
        "edmsim_version": version,
    }
    cleaned: dict[str, Any] = _jsonable(report)
    return cleaned


def _machining(windows: pa.Table, totals: Totals) -> dict[str, Any]:
    pulses = totals.short + totals.open + totals.spark + totals.arc
    return {
        "machining_time_s": totals.machining_time_s,
        "wall_time_s": totals.wall_time_s,
        "realtime_factor": _ratio(totals.machining_time_s, totals.wall_time_s),
        "pulses": pulses,
        "path_length_mm": totals.path_length_mm,
        "feed_um_s": {
            "mean": _mean(windows, "feed_um_s"), "max": _most(windows, "feed_um_s"), "limit": totals.feed_limit_um_s,
            "share_at_limit": totals.limited_share,
        },
        "cutting_time_s": totals.cutting_time_s,
        "cutting_rate_mm2_min": _rate(totals.cut_area_mm2, totals.cutting_time_s),
        "overall_rate_mm2_min": _rate(totals.cut_area_mm2, totals.machining_time_s),
        "pulse_share": {
            kind: _ratio(getattr(totals, kind), pulses) for kind in ("spark", "arc", "short", "open")
        },
    }


def _part(quality: Quality, origin_mm: tuple[float, float]) -> dict[str, Any]:
    return {
        "kerf_um": {"mean": quality.kerf_mean_um, "min": quality.kerf_min_um, "max": quality.kerf_max_um},
        "kerf_section": [asdict(row) for row in quality.section],
        **deviation(quality, origin_mm),
        "table_error_um": None if quality.table is None else asdict(quality.table),
        "corners": [
            {
                "program_x_mm": c.x_mm - origin_mm[0], "program_y_mm": c.y_mm - origin_mm[1],
                "x_mm": c.x_mm, "y_mm": c.y_mm, "turn_deg": c.turn_deg, "error_um": c.error_um,
            }
            for c in quality.corners
        ],
    }


def _wire(windows: pa.Table, totals: Totals) -> dict[str, Any]:
    return {
        "lag_um": _weighted(lag_along_um(windows), column(windows, "t_period_us")),
        "vibration_um_rms": totals.vibration_um_rms,
        "temperature_K_max": _most(windows, "wire_temperature_K"),
    }


def _equalising(windows: pa.Table, totals: Totals) -> dict[str, float | None] | None:
    """What equalising pulses left of the mean voltage, and what they took; None for a generator without any."""
    if "net_voltage_V" not in windows.column_names:
        return None
    return {
        "net_voltage_V": _mean(windows, "net_voltage_V"), "power_W": _mean(windows, "equalising_W"),
        "energy_J": totals.equalising_J,
    }  # fmt: skip


def _following(windows: pa.Table) -> dict[str, float | None]:
    """Following error of the axes, both together: greatest and root mean square."""
    error2 = column(windows, "following_x_um") ** 2 + column(windows, "following_y_um") ** 2
    mean2 = _weighted(error2, column(windows, "t_period_us"))
    return {
        "max": math.sqrt(float(error2.max())) if len(error2) else None,
        "rms": None if mean2 is None else math.sqrt(mean2),
    }


def _ratio(value: float, by: float) -> float | None:
    return value / by if by > 0 else None


def _rate(area_mm2: float, seconds: float) -> float | None:
    """Return an area per minute; what was never cut has no rate."""
    return 60.0 * area_mm2 / seconds if area_mm2 > 0 else None


def _mean(windows: pa.Table, name: str) -> float | None:
    return _weighted(column(windows, name), column(windows, "t_period_us"))


def _most(windows: pa.Table, name: str) -> float | None:
    values = column(windows, name)
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _weighted(
    values: np.ndarray[Any, np.dtype[np.float64]], weights: np.ndarray[Any, np.dtype[np.float64]]
) -> float | None:
    total = float(weights.sum())
    return float(values @ weights) / total if total > 0 else None


def _jsonable(value: Any) -> Any:
    """Return plain JSON types: numpy scalars unpacked, paths as text, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _jsonable(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def cut_id(report: Mapping[str, Any]) -> str:
    """Return which cut a report is of: a digest of all it says but the computer's time."""
    figures = {name: value for name, value in report.items() if name not in ("wall_time_s", "realtime_factor")}
    return hashlib.sha256(json.dumps(figures, sort_keys=True).encode()).hexdigest()[:16]


def write_json(report: Mapping[str, Any], file: str | Path) -> None:
    """Write a report; a file of that name is replaced whole or not at all."""
    text = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    with replacing(file) as partial:
        # what no encoding has, of a file name that is not UTF-8, stands in JSON behind a backslash
        partial.write_bytes((text + "\n").encode("utf-8", "backslashreplace"))


def duration_text(seconds: float | None) -> str:
    """Return a duration as a person says it: ``48.2 s``, ``12 min 05 s``, ``3 h 20 min``."""
    if seconds is None:
        return "unknown"
    if round(seconds, 1) < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min"


def figure_text(value: float | None, unit: str, digits: int = 1) -> str:
    """Return ``12.3 um``, or ``-`` if the value could not be obtained."""
    return "–" if value is None else f"{value:.{digits}f} {unit}"


def render_table(report: Mapping[str, Any]) -> RenderableType:
    """Return the report for the terminal: the key figures, the worst corners, the notices."""
    from rich.console import Group
    from rich.text import Text

    from edmsim.screen import ScreenTable

    head = Text(f"{report['outcome']}", style="bold green" if report["reason"] is None else "bold red")
    if report["reason"] is not None:
        head.append(f"  {report['reason']}", style="default")
    table = ScreenTable(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    for name, text in summary(report):
        table.add_row(name, text)
    return Group(head, table, *(Text(f"note: {notice}", style="yellow") for notice in report["notices"]))


def outcome_text(report: Mapping[str, Any]) -> str:
    """Return how a cut ended, and why if the machine stopped."""
    reason = report["reason"]
    return str(report["outcome"]) + ("" if reason is None else f": {reason}")


def summary(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the key figures of a report as a person reads them: names and texts."""
    say = figure_text
    feed, kerf, profile, wire = (report[k] for k in ("feed_um_s", "kerf_um", "profile_error_um", "wire"))
    shares = (f"{kind} {say(_percent(share), '%')}" for kind, share in report["pulse_share"].items())
    times = [duration_text(report[k]) for k in ("machining_time_s", "wall_time_s")]
    speed = say(report["realtime_factor"], "times real time", 2)
    least, largest = say(kerf["min"], "µm"), say(kerf["max"], "µm")
    lag, vibration = say(wire["lag_um"], "µm"), say(wire["vibration_um_rms"], "µm", 2)
    follow = report["following_error_um"]
    covered = [say(_percent(report["coverage"][k]), "%") for k in ("mean", "max")]
    energy, removed = say(report["energy_J"], "J"), say(report["removed_mm3"], "mm³", 3)
    current, voltage = say(report["mean_current_A"], "A", 2), say(report["mean_voltage_V"], "V")
    return [
        ("machining time", f"{times[0]}  (computed in {times[1]}, {speed})"),
        ("path", say(report["path_length_mm"], "mm", 2)),
        ("cutting rate", _rate_line(report)),
        ("feed", f"{say(feed['mean'], 'µm/s')} mean, {say(feed['max'], 'µm/s')} max{_limit_text(feed)}"),
        ("pulses", "  ".join([f"{report['pulses']:,}", *shares])),
        ("kerf", f"{say(kerf['mean'], 'µm')} mean, {least} to {largest}"),
        ("profile error", _profile_line(profile)),
        ("made by", _shares_line(profile["shares"])),
        *deviation_lines(report),
        *_table_lines(report),
        ("corners", _corner_line(report["corners"])),
        ("wire", f"lag {lag}, vibration {vibration} rms, at most {say(wire['temperature_K_max'], 'K', 0)}"),
        ("axes", f"{say(follow['max'], 'µm')} behind at most, {say(follow['rms'], 'µm')} rms"),
        ("gas", f"covers {covered[0]} of the wire's front in the mean, at most {covered[1]}"),
        ("surface", _surface_line(report["surface"])),
        ("energy", f"{energy}, {removed} removed, {current}, {voltage} mean"),
        *_equalising_lines(report),
        *pass_lines(report),
    ]


def pass_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Say of each pass what it did; reports of cuts in one pass, and of earlier versions, have none."""
    say, found = figure_text, report.get("passes") or []
    several = len({row["contour"] for row in found}) > 1
    lines = []
    for row in found:
        name = f"pass {row['number']}" + (" tab" if row["piece"] == "tab" else "")
        where = f"contour {row['contour']}: " if several else ""
        took = "" if row["stock_um"] is None else f", {say(row['stock_um'], 'µm')} taken"
        offset, better = (row[k] and row[k] / 1e3 for k in ("offset_um", "offset_to_use_um"))
        lines.append((name, (
            f"{where}{duration_text(row['end_s'] - row['begin_s'])}, {say(row['rate_mm2_min'], 'mm²/min', 0)}{took}, "
            f"Ra {say(row['ra_um'], 'µm', 2)}, straight within {say(row['straightness_um'], 'µm')}, offset "
            f"{say(offset, 'mm', 3)}, as the last {say(better, 'mm', 3)}"
        )))  # fmt: skip
    return lines


def rate_text(report: Mapping[str, Any]) -> str:
    """Return the rate over the cut alone as a heading has it."""
    rate = report["cutting_rate_mm2_min"]
    return "no cutting rate" if rate is None else figure_text(rate, "mm²/min")


def _rate_line(report: Mapping[str, Any]) -> str:
    """Say both rates; reports of earlier versions have one, over the whole time."""
    rate, overall = report["cutting_rate_mm2_min"], report.get("overall_rate_mm2_min")
    if rate is None:
        return "none: nothing was cut beyond a start hole"
    if overall is None:
        return f"{figure_text(rate, 'mm²/min')} over the whole time"
    alone = f"{figure_text(rate, 'mm²/min')} over the cut alone, {duration_text(report['cutting_time_s'])}"
    return f"{alone}; {figure_text(overall, 'mm²/min')} over the whole time"


def _profile_line(profile: Mapping[str, Any]) -> str:
    if profile["max"] is None:
        return "not measured"
    most, rms, p95 = (figure_text(profile[k], "µm") for k in ("max", "rms", "p95"))
    return f"{most} max, {rms} rms, {p95} for 95 %"


def _limit_text(feed: Mapping[str, float | None]) -> str:
    """Say for how long the machine's greatest feed held the cut back, if for a tenth of the time or more."""
    share, limit = feed.get("share_at_limit"), feed.get("limit")
    if share is None or limit is None or share < 0.1:
        return ""
    return f"; limited by the machine's greatest feed, {limit:.1f} µm/s, for {100 * share:.0f} % of the cut"


def _table_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Say what the table's errors do, if it has any; reports of earlier versions do not know."""
    found, say = report.get("table_error_um"), figure_text
    if found is None:
        return []
    bare, left, profile = found["without_um"], found["left_um"], found["profile_without_um"]
    text = f"moves the wall by {say(bare['max'], 'µm')} max, {say(bare['rms'], 'µm')} rms"
    if not found["compensated"]:
        return [("table", text)]
    rest = f"{say(left['max'], 'µm')} max, {say(left['rms'], 'µm')} rms"
    without = f"{say(profile['max'], 'µm')} max, {say(profile['rms'], 'µm')} rms"
    return [("table", f"{text}; compensated to {rest}"), ("profile error without compensation", without)]


def _equalising_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Say what equalising pulses do, if there are any; reports of earlier versions do not know."""
    found, say = report.get("equalising"), figure_text
    if found is None:
        return []
    left, power = say(found["net_voltage_V"], "V", 2), say(found["power_W"], "W", 2)
    energy = say(found["energy_J"], "J", 2)
    return [("equalising", f"its pulses leave {left} of the mean gap voltage and take {power}, {energy} in all")]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _shares_line(shares: Mapping[str, Mapping[str, float | None]] | None) -> str:
    if shares is None:
        return "not split: the wire leans, or its centre was to run on the edge"
    return ", ".join(f"{name} {figure_text(share['rms'], 'µm')}" for name, share in shares.items()) + " rms"


def _surface_line(surface: Mapping[str, float | None]) -> str:
    """Say what the cut face is like; reports of earlier versions do not know its layers."""
    say, heat, water = figure_text, surface.get("heat_affected_um"), surface.get("electrolysed_um")
    return f"Ra {say(surface['ra_um'], 'µm', 2)}, heat-affected {say(heat, 'µm')}, electrolysed {say(water, 'µm', 2)}"


def _corner_line(corners: Sequence[Mapping[str, float | None]]) -> str:
    known = [c for c in corners if c["error_um"] is not None]
    if not known:
        return f"{len(corners)}, none measured" if corners else "none"
    worst = max(known, key=lambda c: abs(c["error_um"] or 0.0))
    x_mm, y_mm = corner_mm(worst)
    place = f"X {x_mm:.3f} Y {y_mm:.3f} mm ({worst['turn_deg']:+.0f}°)"
    return f"{len(corners)}, worst {worst['error_um']:+.1f} µm at {place}"


def corner_mm(corner: Mapping[str, Any]) -> tuple[float, float]:
    """Return where a corner is in the program, in mm; reports of earlier versions only know where on the table."""
    # 0.0 +: a hair below zero would read -0.000
    x, y = (corner.get(f"program_{axis}_mm", corner[f"{axis}_mm"]) for axis in "xy")
    return round(x, 6) + 0.0, round(y, 6) + 0.0
