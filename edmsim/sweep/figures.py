"""What a run is said to be worth: one list of figures for cuts and for episodes of environments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from edmsim.evaluation.episode import Result


class RunFigure(NamedTuple):
    """A figure: what it is called, and where a cut's report and an episode's result have it, if they do."""

    name: str
    report: str
    result: str
    meaning: str


FIGURES = (
    RunFigure("machining_time_s", "machining_time_s", "time_s", "machine time"),
    RunFigure("path_length_mm", "path_length_mm", "length_mm", "length cut"),
    RunFigure("cutting_rate_mm2_min", "cutting_rate_mm2_min", "rate_mm2_min", "cutting rate"),
    RunFigure("feed_um_s", "feed_um_s.mean", "", "mean feed"),
    RunFigure("pulses", "pulses", "", "pulses of the generator"),
    RunFigure("spark_share", "pulse_share.spark", "", "sparks of all pulses"),
    RunFigure("arc_share", "pulse_share.arc", "", "arcs"),
    RunFigure("short_share", "pulse_share.short", "short_share", "shorts"),
    RunFigure("open_share", "pulse_share.open", "open_share", "open pulses"),
    RunFigure("kerf_um", "kerf_um.mean", "", "mean width of the kerf"),
    RunFigure("error_max_um", "profile_error_um.max", "", "greatest profile error"),
    RunFigure("error_rms_um", "profile_error_um.rms", "edge_error_um", "profile error, root mean square"),
    RunFigure("error_p95_um", "profile_error_um.p95", "", "profile error that 95 % stay below"),
    RunFigure("path_error_um", "", "error_um", "distance of the wire from its path, root mean square"),
    RunFigure("ra_um", "surface.ra_um", "", "roughness Ra"),
    RunFigure("lag_um", "wire.lag_um", "", "lag of the wire"),
    RunFigure("vibration_um", "wire.vibration_um_rms", "", "vibration of the wire, root mean square"),
    RunFigure("wire_temperature_K", "wire.temperature_K_max", "hottest_K", "highest temperature of the wire"),
    RunFigure("following_um", "following_error_um.max", "", "greatest following error of the axes"),
    RunFigure("coverage", "coverage.mean", "", "share of the wire's front covered by gas"),
    RunFigure("energy_J", "energy_J", "", "energy of all discharges"),
    RunFigure("removed_mm3", "removed_mm3", "", "metal removed"),
    RunFigure("mean_current_A", "mean_current_A", "", "mean current"),
    RunFigure("mean_voltage_V", "mean_voltage_V", "", "mean voltage"),
    RunFigure("total_return", "", "total_return", "return of the episode"),
)
"""Figures of a run, in order; one that could not be measured, or is not of this kind of run, is null."""
NAMES = tuple(figure.name for figure in FIGURES)
CLOCKS = "wall_time_s", "realtime_factor"
"""Fields of a report that belong to the computer: they are kept out of what two engines must agree on."""


def of_report(report: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the figures of a cut."""
    return {figure.name: _number(_at(report, figure.report)) for figure in FIGURES}


def of_result(result: Result) -> dict[str, float | None]:
    """Return the figures of an episode."""
    return {figure.name: _number(getattr(result, figure.result, None)) for figure in FIGURES}


def _at(report: Mapping[str, Any], path: str) -> Any:
    value: Any = report
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _number(value: Any) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
