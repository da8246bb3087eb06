"""The report of a cut: a class of figures with unit and meaning, their text for a terminal, and the cut's folder."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, dataclass_transform, get_args, get_type_hints

import numpy as np

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import folder_of, replacing
from edmsim.geometry import Floats
from edmsim.metrology.kerf import KERF_CLEARANCE_MM
from edmsim.metrology.profile import BLANK_EDGE_MM
from edmsim.recording.scene import Scene, read_scene
from edmsim.recording.windows import CUT_KEY, column, durations_s, lag_along_um, read_windows

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import RenderableType

    from edmsim.closed_loop.passes import Sums


class FigureKind(NamedTuple):
    """A number's unit (shares in ``%`` are stored as 0 to 1), meaning, decimals and name in a table of runs."""

    unit: str
    meaning: str
    digits: int = 1
    column: str = ""

    def text(self, value: float | None, digits: int | None = None) -> str:
        """Return ``12.3 µm``, or a dash if the value could not be obtained."""
        shown = value if value is None or self.unit != "%" else 100.0 * value
        return figure_text(shown, self.unit, self.digits if digits is None else digits)

    @property
    def heading(self) -> str:
        """Meaning and unit over a column, in ASCII; shares have their unit in the cells."""
        unit = self.unit.replace("²", "2").replace("µ", "u")
        return self.meaning if unit in ("", "%") else f"{self.meaning}, {unit}"


TIME = FigureKind("s", "machine time", column="machining_time_s")
LENGTH = FigureKind("mm", "length cut", 2, "path_length_mm")
RATE = FigureKind("mm²/min", "cutting rate", column="cutting_rate_mm2_min")
SHORTS = FigureKind("%", "short pulses", column="short_share")
OPENS = FigureKind("%", "open pulses", column="open_share")
RA = FigureKind("µm", "Ra", 2, "ra_um")
HOTTEST = FigureKind("K", "highest temperature of the wire", 0, "wire_temperature_K")
"""Kinds of figures that both a cut and an episode of an environment have."""
_Number = float | None


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
class Figures(Mapping[str, Any]):
    """A record that is read by attribute, or by name as in JSON; unknown values are None, never NaN."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False)(cls)

    def __post_init__(self) -> None:
        for name, kind in _kinds(type(self)).items():
            object.__setattr__(self, name, _plain(getattr(self, name), kind))

    def __getitem__(self, name: str) -> Any:
        if name not in _kinds(type(self)):
            raise KeyError(name)
        return _as_json(getattr(self, name))

    def __iter__(self) -> Iterator[str]:
        return iter(_kinds(type(self)))

    def __len__(self) -> int:
        return len(_kinds(type(self)))

    def text(self, place: str, digits: int | None = None) -> str:
        """Return the text, with unit, of the figure at a place such as ``kerf_um.mean``."""
        return kinds_of(type(self))[place].text(attrgetter(place)(self), digits)


def _as_json(value: Any) -> Any:
    if isinstance(value, list):
        return [_as_json(entry) for entry in value]
    return dict(value) if isinstance(value, Figures) else value


@cache
def _kinds(record: type[Figures]) -> dict[str, type[Figures] | None]:
    """Return a record's fields, each with the record class of its value or of its list's entries, or None."""

    def kind_of(hint: Any) -> type[Figures] | None:
        if isinstance(hint, type) and issubclass(hint, Figures):
            return hint
        return next((kind for part in get_args(hint) if (kind := kind_of(part)) is not None), None)

    return {name: kind_of(hint) for name, hint in get_type_hints(record).items()}


@cache
def kinds_of(record: type) -> dict[str, FigureKind]:
    """Return the figures that a record declares, by place, without those in lists and in optional records."""
    found: dict[str, FigureKind] = {}
    for name, hint in get_type_hints(record, include_extras=True).items():
        if isinstance(hint, type) and issubclass(hint, Figures):
            found |= {f"{name}.{place}": kind for place, kind in kinds_of(hint).items()}
        else:
            for kind in getattr(hint, "__metadata__", ()):
                found[name] = kind
    return found


def _plain(value: Any, kind: type[Figures] | None = None) -> Any:
    """Return plain JSON types: numpy scalars unpacked, paths as text, NaN and infinity as None."""
    if isinstance(value, Figures):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()} if kind is None else kind(**value)
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item, kind) for item in value]
    if kind is not None and value is not None:
        raise ValueError(f"{value!r} where figures belong")
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


class Feed(Figures):
    """Feed of the cut, and the share of the cut at the greatest feed of machine and planner."""

    mean: Annotated[_Number, FigureKind("µm/s", "mean feed", column="feed_um_s")] = None
    max: Annotated[_Number, FigureKind("µm/s", "greatest feed")] = None
    limit: Annotated[_Number, FigureKind("µm/s", "greatest feed of machine and planner")] = None
    share_at_limit: Annotated[
        _Number, FigureKind("%", "share of the cut at that feed", 0, column="share_at_limit")
    ] = None


class PulseShare(Figures):
    """Pulses of each class, as shares of all pulses of the generator."""

    spark: Annotated[_Number, FigureKind("%", "sparks of all pulses", column="spark_share")] = None
    arc: Annotated[_Number, FigureKind("%", "arcs", column="arc_share")] = None
    short: Annotated[_Number, SHORTS] = None
    open: Annotated[_Number, OPENS] = None


class Kerf(Figures):
    """Width of the kerf over all places and heights."""

    mean: Annotated[_Number, FigureKind("µm", "mean width of the kerf", column="kerf_um")] = None
    min: Annotated[_Number, FigureKind("µm", "least width of the kerf")] = None
    max: Annotated[_Number, FigureKind("µm", "greatest width of the kerf")] = None


class Wall(Figures):
    """A wall of the kerf in one slice: mean, 5 % and 95 % of its distances from the wire's path."""

    mean_um: _Number = None
    p5_um: _Number = None
    p95_um: _Number = None


class KerfSlice(Figures):
    """The kerf at one height over the lower face: number of measured places, the part's wall and the opposite one."""

    height_mm: float
    places: int
    part: Wall
    rest: Wall


class Spread(Figures):
    """Statistics of the magnitudes of errors."""

    max: Annotated[_Number, FigureKind("µm", "greatest")] = None
    rms: Annotated[_Number, FigureKind("µm", "root mean square")] = None
    p95: Annotated[_Number, FigureKind("µm", "what 95 % stay below")] = None

    @property
    def worst_and_rms(self) -> str:
        """Greatest and rms error as text."""
        if self.max is None:
            return "not measured"
        return f"{self.text('max')} max, {self.text('rms')} rms"

    @property
    def in_words(self) -> str:
        """All three figures as text."""
        return f"{self.worst_and_rms}, {self.text('p95')} for 95 %"


class ErrorPlace(Figures):
    """Place of the largest error in the program, and its cause: see `edmsim.metrology.error_budget.WorstPlace`."""

    program_x_mm: _Number = None
    program_y_mm: _Number = None
    error_um: _Number = None
    why: str | None = None
    made_by: str | None = None

    def __str__(self) -> str:
        if self.why is None:
            return "not measured"
        share = None if self.why == "out of reach" else self.made_by
        made_by = "" if share is None else f", most of it by {_MADE_BY[share]}"
        return f"{self.error_um:+.1f} µm at {place_text(self)}: {_WORDS[self.why]}{made_by}"


_WORDS = {
    "start mark": "the start mark", "out of reach": "a place out of the round wire's reach",
    "inner corner": "an inner corner", "outer corner": "an outer corner", "edge": "between corners",
}
_MADE_BY = {
    "path": "the programmed path", "planner": "the planner", "drive": "the drive", "wire": "the wire's deflection",
    "gap": "the gap",
}


class ReachableError(Spread):
    """The profile error without the metal that the round wire leaves in inner corners."""

    at: ErrorPlace = field(default_factory=ErrorPlace)


class ProfileErrors(ReachableError):
    """The profile error, its part within the wire's reach, and its shares by cause (None if it was not split)."""

    max: Annotated[_Number, FigureKind("µm", "greatest profile error", column="error_max_um")] = None
    rms: Annotated[_Number, FigureKind("µm", "profile error rms", column="error_rms_um")] = None
    p95: Annotated[_Number, FigureKind("µm", "profile error that 95 % stay below", column="error_p95_um")] = None
    reachable: ReachableError = field(default_factory=ReachableError)
    shares: dict[str, Any] | None = None


class Offset(Figures):
    """The applied offset (None if contours have different ones), the mean error, and the offset to use instead."""

    applied_mm: Annotated[_Number, FigureKind("mm", "offset applied", 3)] = None
    mean_error_um: Annotated[_Number, FigureKind("µm", "mean error of the walls between corners")] = None
    to_use_mm: Annotated[_Number, FigureKind("mm", "offset without that error", 3)] = None

    def __str__(self) -> str:
        applied, mean, better = self.text("applied_mm"), self.mean_error_um, self.to_use_mm
        if mean is None:
            return applied
        left = "metal left" if mean > 0 else "undercut"
        if self.applied_mm is None or better is None:
            return f"different ones by contour, {mean:+.1f} µm in the mean ({left})"
        if abs(mean) < _RIGHT_UM or self.text("to_use_mm") == applied:
            return f"{applied}, right within {_RIGHT_UM:g} µm in the mean"
        advice = f"use --offset {better:.3f}" if better > 0 else "more than the whole offset"
        return f"{applied}, {mean:+.1f} µm in the mean ({left}): {advice}"


_RIGHT_UM = 0.5  # a mean error below half the path's resolution cannot be corrected by the offset


class Element(Figures):
    """A line or arc of the edge as drawn, in the program's coordinates; see `edmsim.metrology.profile`."""

    contour: int
    element: int
    line: int | None
    kind: str
    radius_mm: _Number
    length_mm: float
    mean_um: _Number
    rms_um: _Number
    low_um: _Number
    high_um: _Number
    program_x_mm: float
    program_y_mm: float
    program_end_x_mm: float
    program_end_y_mm: float


class TableShare(Figures):
    """Effect of the errors of the table's screws and ways on the part."""

    without_um: Spread  # displacement of the wall by the table alone
    left_um: Spread  # the same after compensation
    profile_without_um: Spread  # profile error without compensation
    compensated: bool


class Corner(Figures):
    """A corner of the nominal edge, in the program and on the table; the error is None if it was not measured."""

    program_x_mm: float
    program_y_mm: float
    x_mm: float
    y_mm: float
    turn_deg: float
    error_um: Annotated[_Number, FigureKind("µm", "error of the corner, above 0: metal left")]


class HeightError(Figures):
    """The profile error at one height, mid-slice over the lower face."""

    height_mm: float
    mean_um: _Number
    rms_um: _Number


class PassFigures(Figures):
    """Figures of a pass, and of the wall and face after it."""

    contour: int  # contour, number: counted from 1
    number: int
    piece: str
    reversed: bool  # whether it ran against the contour's direction
    begin_s: float  # of machine time
    end_s: float
    length_mm: float
    rate_mm2_min: Annotated[_Number, RATE]
    offset_um: float
    # offset with which its wall would be on the drawing, if it were the last pass
    offset_to_use_um: _Number
    left_um: Annotated[_Number, FigureKind("µm", "metal that its wall leaves on the drawing in the mean")]
    stock_um: Annotated[_Number, FigureKind("µm", "what it took of the pass before")]
    # of the wall over the height: range, and mid height over the mean of both ends
    straightness_um: Annotated[_Number, FigureKind("µm", "straightness of the wall")]
    bow_um: _Number
    ripple_um: _Number  # scatter of the wall along the path
    ripple_mm: _Number  # wavelength of that
    slices_um: list[float]  # metal left on the drawing at every height, from below
    # of the face after the pass, with the remaining marks of the passes before
    ra_um: Annotated[_Number, RA]
    heat_affected_um: _Number
    short_share: float
    open_share: float


class WireFigures(Figures):
    """The wire over the cut."""

    lag_um: Annotated[_Number, FigureKind("µm", "lag of the wire", column="lag_um")] = None
    vibration_um_rms: Annotated[
        _Number, FigureKind("µm", "vibration of the wire, root mean square", 2, "vibration_um")
    ] = None
    temperature_K_max: Annotated[_Number, HOTTEST] = None


class Following(Figures):
    """Following error of both axes together."""

    max: Annotated[_Number, FigureKind("µm", "greatest following error of the axes", column="following_um")] = None
    rms: Annotated[_Number, FigureKind("µm", "following error of the axes, root mean square")] = None


class Coverage(Figures):
    """Gas on the wire's front."""

    mean: Annotated[_Number, FigureKind("%", "share of the wire's front covered by gas", column="coverage")] = None
    max: Annotated[_Number, FigureKind("%", "greatest such share")] = None


class Surface(Figures):
    """The cut face: roughness, the layer changed by heat, and the layer dissolved by the water."""

    ra_um: Annotated[_Number, RA] = None
    heat_affected_um: Annotated[_Number, FigureKind("µm", "heat-affected layer")] = None
    electrolysed_um: Annotated[_Number, FigureKind("µm", "electrolysed layer", 2)] = None


class Equalising(Figures):
    """The mean voltage that remains with equalising pulses, and their power and energy."""

    net_voltage_V: Annotated[_Number, FigureKind("V", "mean gap voltage left", 2)]
    power_W: Annotated[_Number, FigureKind("W", "mean power of the equalising pulses", 2)]
    energy_J: Annotated[_Number, FigureKind("J", "energy of the equalising pulses", 2)]


class Origin(Figures):
    """The program's zero on the table, in mm."""

    x: float = 0.0
    y: float = 0.0


class Report(Figures):
    """The report of a cut, as ``report.json`` holds it.

    Read a field by attribute or by name, ``report.kerf_um.mean`` or ``report["kerf_um"]["mean"]``; ``dict(report)``
    is plain JSON. Unknown values are None, never NaN. Means over machine time weight every window by its duration.
    `rich.print` shows its key figures.
    """

    outcome: str = ""  # "finished", or one or two words for what stopped the machine
    reason: str | None = None  # why the machine stopped, as a sentence
    machining_time_s: Annotated[_Number, TIME] = None
    wall_time_s: Annotated[_Number, FigureKind("s", "time of the computer")] = None
    realtime_factor: Annotated[_Number, FigureKind("times real time", "speed of the simulation", 2)] = None
    pulses: Annotated[int, FigureKind("", "pulses of the generator", 0, "pulses")] = 0
    path_length_mm: Annotated[_Number, LENGTH] = None
    feed_um_s: Feed = field(default_factory=Feed)
    cutting_time_s: Annotated[_Number, FigureKind("s", "time of the cut alone")] = None
    cutting_rate_mm2_min: Annotated[_Number, RATE] = None
    overall_rate_mm2_min: Annotated[_Number, FigureKind("mm²/min", "cutting rate over the whole time")] = None
    pulse_share: PulseShare = field(default_factory=PulseShare)
    origin_mm: Origin = field(default_factory=Origin)
    kerf_um: Kerf = field(default_factory=Kerf)
    kerf_section: list[KerfSlice] = field(default_factory=list)  # slice by slice, from the bottom
    profile_error_um: ProfileErrors = field(default_factory=ProfileErrors)
    offset: Offset = field(default_factory=Offset)
    elements: list[Element] = field(default_factory=list)  # lines and arcs in the order of the program
    table_error_um: TableShare | None = None  # None for a perfect table
    corners: list[Corner] = field(default_factory=list)
    heights: list[HeightError] = field(default_factory=list)  # slice by slice, from the bottom
    passes: list[PassFigures] = field(default_factory=list)  # empty for a cut in one pass
    wire: WireFigures = field(default_factory=WireFigures)
    following_error_um: Following = field(default_factory=Following)
    coverage: Coverage = field(default_factory=Coverage)
    surface: Surface = field(default_factory=Surface)
    energy_J: Annotated[_Number, FigureKind("J", "energy of all discharges", column="energy_J")] = None
    removed_mm3: Annotated[_Number, FigureKind("mm³", "metal removed", 3, "removed_mm3")] = None
    mean_current_A: Annotated[_Number, FigureKind("A", "mean current", 2, "mean_current_A")] = None
    mean_voltage_V: Annotated[_Number, FigureKind("V", "mean voltage", column="mean_voltage_V")] = None
    equalising: Equalising | None = None  # None if the generator has no such pulses
    seed: int = 0
    settings: dict[str, Any] = field(default_factory=dict)  # the options the cut was made with
    notices: list[str] = field(default_factory=list)  # sentences for the user
    edmsim_version: str = ""

    @property
    def title(self) -> str:
        """The program's name."""
        return str(self.settings["program"])

    def __rich__(self) -> RenderableType:
        return render_table(self)


CLOCKS = "wall_time_s", "realtime_factor"
"""Fields that depend on the computer, and so are ignored when two cuts are compared."""


@dataclass(frozen=True)
class Totals:
    """Counts and sums over the whole cut; NaN if unknown."""

    machining_time_s: float
    wall_time_s: float
    sums: Sums  # over all pulses of the generator, also those that the analyser did not count
    path_length_mm: float
    # of the cut alone (`edmsim.recording.windows`): path length times the local height of the workpiece, and time
    cut_area_mm2: float
    cutting_time_s: float
    removed_mm3: float
    feed_limit_um_s: float = math.nan
    limited_share: float = math.nan  # of the cut alone, at the greatest feed


def build_report(
    part: Report, windows: pa.Table, totals: Totals, *, outcome: str, reason: str | None, notices: Iterable[str],
    seed: int, settings: Mapping[str, Any], version: str,
) -> Report:
    """Return the report of a cut; `part` has the figures measured on the part."""
    sums, pulses = totals.sums, totals.sums.pulses
    timing = "t_s", "t_period_us", "short", "open", "spark", "arc"
    took_s = durations_s({name: column(windows, name) for name in timing})

    def mean(name: str) -> float | None:
        return _weighted(column(windows, name), took_s)

    return replace(
        part, outcome=outcome, reason=reason,
        machining_time_s=totals.machining_time_s, wall_time_s=totals.wall_time_s,
        realtime_factor=_ratio(totals.machining_time_s, totals.wall_time_s), pulses=pulses,
        path_length_mm=totals.path_length_mm,
        feed_um_s=Feed(
            mean("feed_um_s"), _most(windows, "feed_um_s"), totals.feed_limit_um_s, totals.limited_share
        ),
        cutting_time_s=totals.cutting_time_s,
        cutting_rate_mm2_min=_rate(totals.cut_area_mm2, totals.cutting_time_s),
        overall_rate_mm2_min=_rate(totals.cut_area_mm2, totals.machining_time_s),
        pulse_share=PulseShare(*(_ratio(count, pulses) for count in (sums.spark, sums.arc, sums.short, sums.open))),
        wire=WireFigures(
            _weighted(lag_along_um(windows), took_s),
            math.sqrt(sums.vibration2_pulses / pulses) if pulses else None, _most(windows, "wire_temperature_K"),
        ),
        following_error_um=_following(windows, took_s),
        coverage=Coverage(mean("coverage"), _most(windows, "coverage")),
        energy_J=sums.energy, removed_mm3=totals.removed_mm3,
        mean_current_A=mean("mean_current_A"), mean_voltage_V=mean("mean_voltage_V"),
        equalising=None if "net_voltage_V" not in windows.column_names else Equalising(
            mean("net_voltage_V"), mean("equalising_W"), sums.equalising_J
        ),
        seed=seed, settings=dict(settings), notices=list(notices), edmsim_version=version,
    )  # fmt: skip


def _following(windows: pa.Table, took_s: Floats) -> Following:
    error2 = column(windows, "following_x_um") ** 2 + column(windows, "following_y_um") ** 2
    mean2 = _weighted(error2, took_s)
    return Following(
        math.sqrt(float(error2.max())) if len(error2) else None, None if mean2 is None else math.sqrt(mean2)
    )


def _ratio(value: float, by: float) -> float | None:
    return value / by if by > 0 else None


def _rate(area_mm2: float, seconds: float) -> float | None:
    """Return an area per minute; None if nothing was cut."""
    return 60.0 * area_mm2 / seconds if area_mm2 > 0 else None


def _most(windows: pa.Table, name: str) -> float | None:
    values = column(windows, name)
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _weighted(values: Floats, weights: Floats) -> float | None:
    total = float(weights.sum())
    # not `@`, because its order of additions depends on the number of threads; rounding may leave the values' range
    mean = float((values * weights).sum()) / total if total > 0 else None
    return None if mean is None else float(np.clip(mean, values.min(), values.max()))


def cut_id(report: Report) -> str:
    """Return the identity of a report's cut: a digest of all fields but `CLOCKS`."""
    figures = {name: value for name, value in report.items() if name not in CLOCKS}
    return hashlib.sha256(json.dumps(figures, sort_keys=True).encode()).hexdigest()[:16]


def write_json(report: Report, file: str | Path) -> None:
    """Write a report; an existing file is replaced only when complete."""
    text = json.dumps(dict(report), allow_nan=False, indent=2, ensure_ascii=False)
    with replacing(file) as partial:
        # surrogates, from file names that are not UTF-8, become escapes of JSON
        partial.write_bytes((text + "\n").encode("utf-8", "backslashreplace"))


def duration_text(seconds: float | None) -> str:
    """Return a duration as text: ``48.2 s``, ``12 min 05 s``, ``3 h 20 min``."""
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
    """Return ``12.3 um``, or a dash if the value could not be obtained."""
    return "–" if value is None else f"{value:.{digits}f} {unit}"


def place_text(of: Corner | ErrorPlace) -> str:
    """Return the text of a place in the program."""
    return f"X {mm_text(of.program_x_mm or 0.0)} Y {mm_text(of.program_y_mm or 0.0)} mm"


def mm_text(mm: float) -> str:
    """Return a coordinate as text, rounded to um, without the sign of -0.000."""
    return f"{round(mm, 3) + 0.0:.3f}"


def render_table(report: Report) -> RenderableType:
    """Return the report for the terminal: the key figures, the worst corners, the notices."""
    from rich.console import Group
    from rich.text import Text

    from edmsim.screen import ScreenTable

    head = Text(report.outcome, style="bold green" if report.reason is None else "bold red")
    if report.reason is not None:
        head.append(f"  {report.reason}", style="default")
    table = ScreenTable(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    for name, text in summary(report):
        table.add_row(name, text)
    return Group(head, table, *(Text(f"note: {notice}", style="yellow") for notice in report.notices))


def outcome_text(report: Report) -> str:
    """Return how a cut ended, and why if the machine stopped."""
    return report.outcome + ("" if report.reason is None else f": {report.reason}")


def rate_text(report: Report) -> str:
    """Return the rate over the cut alone as text for a heading."""
    return "no cutting rate" if report.cutting_rate_mm2_min is None else report.text("cutting_rate_mm2_min")


def summary(report: Report) -> list[tuple[str, str]]:
    """Return the key figures of a report: names and texts."""
    say, profile = report.text, report.profile_error_um
    simulated, computed = duration_text(report.machining_time_s), duration_text(report.wall_time_s)
    shares = (f"{kind} {report.pulse_share.text(kind)}" for kind in report.pulse_share)
    made_by = "not split: the wire is tilted, or its centre follows the contour"
    if profile.shares is not None:
        made_by = ", ".join(f"{name} {figure_text(of['rms'], 'µm')}" for name, of in profile.shares.items()) + " rms"
    kerf = f"{say('kerf_um.mean')} mean, {say('kerf_um.min')} to {say('kerf_um.max')}"
    no_edge = f"{_NO_EDGE}, so passes have no stock" if report.passes else _NO_EDGE
    no_error = "the wire's centre follows the contour" if report.offset.applied_mm == 0 else no_edge
    layer_um = report.surface.electrolysed_um
    electrolysed = "" if layer_um is None else f", electrolysed {say('surface.electrolysed_um')}"
    return [
        ("machining time", f"{simulated}  (computed in {computed}, {say('realtime_factor')})"),
        ("path", say("path_length_mm")),
        ("cutting rate", _rate_line(report)),
        ("feed", f"{say('feed_um_s.mean')} mean, {say('feed_um_s.max')} max{_limit_text(report.feed_um_s)}"),
        ("pulses", "  ".join([f"{report.pulses:,}", *shares])),
        ("kerf", f"not measured: {_NO_KERF}" if report.kerf_um.mean is None else kerf),
        *([("profile error", f"not measured: {no_error}")] if profile.max is None else [
            ("profile error", profile.in_words), ("made by", made_by), ("largest error", str(profile.at)),
        ]),
        *([
            ("within the wire's reach", profile.reachable.in_words),
            ("largest error there", str(profile.reachable.at)),
        ] if profile.at.why == "out of reach" else []),
        ("offset", str(report.offset)),
        *_table_lines(report.table_error_um),
        ("corners", _corner_line(report.corners)),
        ("wire", f"lag {say('wire.lag_um')}, vibration {say('wire.vibration_um_rms')} rms, at most "
                 f"{say('wire.temperature_K_max')}"),
        ("axes", f"{say('following_error_um.max')} behind at most, {say('following_error_um.rms')} rms"),
        ("gas", f"covers {say('coverage.mean')} of the wire's front in the mean, at most {say('coverage.max')}"),
        ("surface", f"Ra {say('surface.ra_um')}, heat-affected {say('surface.heat_affected_um')}{electrolysed}"),
        ("energy", f"{say('energy_J')}, {say('removed_mm3')} removed, {say('mean_current_A')}, "
                   f"{say('mean_voltage_V')} mean"),
        *([] if (equalising := report.equalising) is None else [(
            "equalising", f"its pulses leave {equalising.text('net_voltage_V')} of the mean gap voltage and take "
            f"{equalising.text('power_W')}, {equalising.text('energy_J')} in all",
        )]),
        *_pass_lines(report.passes),
    ]  # fmt: skip


_NO_KERF = f"it was cut nowhere {KERF_CLEARANCE_MM:g} mm or more from start holes, corners and small arcs"
_NO_EDGE = f"no edge was cut {BLANK_EDGE_MM:g} mm or more from start holes"


def settings_in_words(report: Report) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of a cut's settings, without those that were not set."""
    for name, value in report.settings.items():
        if value is not None and value != []:
            yield name, f"{value:g}" if isinstance(value, float) else str(value)
    yield "seed", str(report.seed)


def _pass_lines(passes: Sequence[PassFigures]) -> list[tuple[str, str]]:
    several = len({one.contour for one in passes}) > 1
    lines = []
    for one in passes:
        name = f"pass {one.number}" + (" tab" if one.piece == "tab" else "")
        where = f"contour {one.contour}: " if several else ""
        took = "" if one.stock_um is None else f", {one.text('stock_um')} taken"
        offset, better = (
            figure_text(None if um is None else um / 1e3, "mm", 3) for um in (one.offset_um, one.offset_to_use_um)
        )
        lines.append((name, (
            f"{where}{duration_text(one.end_s - one.begin_s)}, {one.text('rate_mm2_min', 0)}{took}, "
            f"Ra {one.text('ra_um')}, straight within {one.text('straightness_um')}, offset "
            f"{offset}, as the last {better}"
        )))  # fmt: skip
    return lines


def _rate_line(report: Report) -> str:
    if report.cutting_rate_mm2_min is None:
        return "none: nothing was cut beyond a start hole"
    alone = f"{report.text('cutting_rate_mm2_min')} over the cut alone, {duration_text(report.cutting_time_s)}"
    return f"{alone}; {report.text('overall_rate_mm2_min')} over the whole time"


def _limit_text(feed: Feed) -> str:
    """Return the share of the cut that the machine's greatest feed limited, as text; empty below a tenth."""
    if feed.share_at_limit is None or feed.limit is None or feed.share_at_limit < 0.1:
        return ""
    share = feed.text("share_at_limit")
    return f"; limited by the machine's greatest feed, {feed.text('limit')}, for {share} of the cut"


def _table_lines(found: TableShare | None) -> list[tuple[str, str]]:
    """Return the lines on the effect of the table's errors, if it has any."""
    if found is None or found.without_um.max is None:
        return []
    text = f"moves the wall by {found.without_um.worst_and_rms}"
    if not found.compensated:
        return [("table", text)]
    return [
        ("table", f"{text}; compensated to {found.left_um.worst_and_rms}"),
        ("profile error without compensation", found.profile_without_um.worst_and_rms),
    ]


def _corner_line(corners: Sequence[Corner]) -> str:
    known = [corner for corner in corners if corner.error_um is not None]
    if not known:
        return f"{len(corners)}, none measured" if corners else "none"
    worst = max(known, key=lambda corner: abs(corner.error_um or 0.0))
    return f"{len(corners)}, worst {worst.error_um:+.1f} µm at {place_text(worst)} ({worst.turn_deg:+.0f}°)"


# Reading the folder of a cut.

RECORDING = "cut.rrd"  # file name of the recording for rerun


class RecordedCut(NamedTuple):
    """Contents of a cut's folder: ``report.json``, ``windows.parquet``, ``part.npz``."""

    report: Report
    windows: pa.Table
    scene: Scene

    def __repr__(self) -> str:
        """Return title, outcome and number of windows only, because report and windows would fill pages."""
        return f"<RecordedCut of {self.report.title}: {outcome_text(self.report)}, {self.windows.num_rows} windows>"


@refuses_wrong_types
def read_cut(directory: str | Path) -> RecordedCut:
    """Read a folder that ``edmsim cut`` has written.

    Raises
    ------
    InputError
        If a file is missing, damaged, or of another version, or the cuts differ.
    """
    folder = folder_of(directory)
    cut = RecordedCut(
        _read_report(folder / "report.json"), read_windows(folder / "windows.parquet"),
        read_scene(folder / "part.npz"),
    )  # fmt: skip
    in_windows = (cut.windows.schema.metadata or {}).get(CUT_KEY)
    whose = None if in_windows is None else in_windows.decode("ascii", "replace")
    if (whose or cut.scene.cut) and {whose, cut.scene.cut} != {cut_id(cut.report)}:
        raise InputError("report.json, windows.parquet and part.npz in it are not of one cut: cut again", folder)
    return cut


def _read_report(file: Path) -> Report:
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(report, dict) or "settings" not in report:
            raise ValueError("no settings in it")
        if missing := [name for name in Report() if name not in report]:
            made_by = report.get("edmsim_version")
            raise InputError(f"written by edmsim {made_by} without {missing[0]}: cut again", file)
        return Report(**report)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("no such file, the folder of a finished cut is needed", file) from None
    except (OSError, ValueError, TypeError, RecursionError) as error:  # also for deeply nested brackets
        raise InputError(f"not the report of a cut ({error})", file) from None
