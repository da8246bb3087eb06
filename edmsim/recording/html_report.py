"""``report.html``: a cut's report with its figures in one self-contained file, also for a phone."""

import base64
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
from matplotlib.figure import Figure

from edmsim.closed_loop.straight import PulseSample
from edmsim.files import replacing
from edmsim.recording.figures import cut
from edmsim.recording.figures.profile import PROFILE_DOTS, profile_figure
from edmsim.recording.figures.style import EmptyFigure, figure_png
from edmsim.recording.report import Element, Report, duration_text, mm_text, outcome_text, settings_in_words, summary
from edmsim.recording.scene import Scene

# All figures of a cut with their captions, for ``report.html`` and ``edmsim report``.


class Picture(NamedTuple):
    """One figure of a cut, with a caption and a name that can be a file's."""

    name: str
    caption: str
    figure: Figure


OF_CUT: dict[str, Callable[[Report, pa.Table, Scene], Figure]] = {
    "profile": lambda report, windows, scene: profile_figure(scene, windows, report, report.title),
    "profile-error": lambda report, windows, scene: cut.error_figure(scene),
    "error-shares": lambda report, windows, scene: cut.shares_figure(scene),
    "corner": lambda report, windows, scene: cut.corner_figure(scene, windows),
    "kerf-section": lambda report, windows, scene: cut.kerf_figure(report),
    "face": lambda report, windows, scene: cut.face_figure(scene),
    "passes": lambda report, windows, scene: cut.passes_figure(report),
    "pulses": lambda report, windows, scene: cut.pulses_figure(windows),
    "short-open": lambda report, windows, scene: cut.plane_figure(windows),
}
"""Functions that draw a cut's figures, by name of the figure."""
OF_SAMPLE: dict[str, Callable[[PulseSample, pa.Table, Report], Figure]] = {
    "ignition-delay": lambda sample, windows, report: cut.delay_figure(sample, windows),
    "wire-spectrum": lambda sample, windows, report: cut.spectrum_figure([sample], report.settings["resolution"]),
}
"""Functions that draw figures of single pulses, by name of the figure."""
_CAPTIONS = {
    "profile": "The cut from above, the error along its edge drawn large, and the process over machine time.",
    "profile-error": "Profile error along the nominal edge.",
    "error-shares":
        "The profile error, and what path, planner, drive, wire and gap have of it, along the edge.",
    "corner": "The corner with the largest error: paths and metal to scale, deviations below.",
    "kerf-section": "Cross-section of the kerf over the workpiece's height.",
    "face": "The cut face unrolled: profile error over path and height.",
    "passes": "Passes: the wall each left over the height, time, metal left and roughness.",
    "pulses": "What became of the pulses, and the share of the wire's front under gas, over machine time.",
    "short-open": "Short and open pulses, and the controller's path among them.",
    "ignition-delay": "Ignition delays: {made}.",
    "wire-spectrum": "Wire vibration: frequencies of its modes over tension, and the spectrum of {made}.",
}


def pictures(
    report: Report, windows: pa.Table, scene: Scene, sample: PulseSample | str, leave_out: Callable[[str], None]
) -> Iterator[Picture]:
    """Yield all figures of a cut but ``profile``; `leave_out` is called with a sentence for each omitted figure."""
    drawn = [
        (name, draw(report, windows, scene)) for name, draw in OF_CUT.items()
        if name != "profile" and (name != "corner" or scene.corners) and (name != "passes" or report.passes)
    ]  # fmt: skip
    made = ""
    if isinstance(sample, str):
        leave_out(f"ignition delays and the wire's spectrum are not drawn: {sample}")
    else:
        made = f"single pulses of a straight cut of the same set-up, simulated at {sample.feed_um_s:.1f} µm/s"
        drawn += [(name, draw_sample(sample, windows, report)) for name, draw_sample in OF_SAMPLE.items()]
    for name, figure in drawn:
        if isinstance(figure, EmptyFigure):
            leave_out(f"the figure {name} is left out ({figure.why})")
        else:
            yield Picture(name, _CAPTIONS[name].format(made=made), figure)


_COLUMNS = (
    "contour", "line", "element", "from X, mm", "Y, mm", "to X, mm", "Y, mm", "length, mm", "mean, µm", "least, µm",
    "greatest, µm",
)
_MOST = 200  # rows shown (ours); a drawing with more elements has only its worst ones listed


def elements_table(elements: Sequence[Element]) -> str:
    """Return the table of the elements in order; of more than `_MOST`, only those with the largest errors."""
    shown, more = list(elements), ""
    if len(shown) > _MOST:
        shown.sort(key=lambda row: -max(abs(row.low_um or 0.0), abs(row.high_um or 0.0)))
        shown = sorted(shown[:_MOST], key=lambda row: (row.contour, row.element))
        more = f" The {_MOST} of {len(elements)} with the largest error are shown; report.json has all."
    note = f"<p>Profile error of each line and arc, without what is out of the round wire's reach.{more}</p>"
    return f'{note}<div style="overflow-x: auto">{_table(_COLUMNS, map(_cells, shown))}</div>'


def _table(names: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{name}</th>" for name in names)
    lines = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{lines}</table>".replace("<td>-", "<td>−")


def _cells(row: Element) -> list[str]:
    kind = row.kind if row.radius_mm is None else f"{row.kind} R {row.radius_mm:.3f}"
    places = [mm_text(row[f"program_{name}_mm"]) for name in ("x", "y", "end_x", "end_y")]
    errors = [_error(row[name]) for name in ("mean_um", "low_um", "high_um")]
    line = "–" if row.line is None else str(row.line)
    return [str(row.contour), line, kind, *places, f"{row.length_mm:.3f}", *errors]


def _error(um: float | None) -> str:
    return "–" if um is None else f"{um:+.1f}"


CARD_DPI = 80
"""Dots per inch of the picture in a notebook (ours: as wide as a notebook's column, a tenth of a megabyte)."""
COLUMN_DPI = 320
"""Dots per inch of the figures in columns, enough to enlarge them (ours: 1120 dots wide)."""


def write_html(
    report: Report, windows: pa.Table, scene: Scene, sample: PulseSample | str, file: str | Path
) -> bytes:
    """Write the page of a cut, and return ``profile.png``; an existing file is replaced only when complete."""
    left_out: list[str] = []
    profile = profile_png(report, windows, scene)
    drawn = [*pictures(report, windows, scene, sample, left_out.append)]
    with replacing(file) as partial:
        partial.write_bytes(page(report, profile, drawn, left_out).encode("utf-8", "replace"))
    return profile


def profile_png(report: Report, windows: pa.Table, scene: Scene) -> bytes:
    """Return the first picture of the page: ``profile.png``."""
    return figure_png(OF_CUT["profile"](report, windows, scene))


def page(report: Report, profile: bytes, drawn: Iterable[Picture], left_out: Iterable[str]) -> str:
    """Return the page, with its pictures as PNG; the first is as wide as the page, and a click enlarges each."""
    notices = "".join(f"<li>{escape(notice)}</li>" for notice in (*report.notices, *left_out))
    first = _enlarged("profile", _CAPTIONS["profile"], _address(profile), *PROFILE_DOTS)
    others = "".join(_picture(picture) for picture in drawn)
    # figures keep their white background on a dark page, because they are the same as for a paper
    style = (resources.files("edmsim.recording") / "report.css").read_text(encoding="utf-8")
    return "\n".join([
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(report.title)} – edmsim</title>\n<style>\n{style}</style>\n</head>\n<body>",
        f"<h1>{escape(report.title)}</h1>",
        f'<p class="outcome {"good" if report.reason is None else "bad"}">{escape(outcome_text(report))}</p>',
        _tiles(report),
        _section("The cut", first + _HINT),
        _section("Result", _pairs(summary(report))),
        _section("Notices", f'<ul class="notices">{notices}</ul>') if notices else "",
        _section("Figures", f'<div class="figures">{others}</div>') if others else "",
        _section("Corners", _corners(report)) if report.corners else "",
        _section("Lines and arcs", elements_table(report.elements)) if report.elements else "",
        _section("Settings", _pairs(settings_in_words(report))),
        f"<footer>edmsim {escape(report.edmsim_version)}</footer>\n</body>\n</html>\n",
    ])  # fmt: skip


def card(report: Report, figure: Figure) -> str:
    """Return the HTML of a cut in a notebook, in its style: outcome, table, notices and one picture."""
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name)}</th><td style="text-align: left">{escape(text)}</td></tr>'
        for name, text in summary(report)
    )
    notices = "".join(f"<p>note: {escape(notice)}</p>" for notice in report.notices)
    address = _address(figure_png(figure, CARD_DPI))
    image = f'<img src="{address}" alt="{escape(report.title)} from above, and the process over time">'
    heading = f"<p><b>{escape(report.title)}: {escape(outcome_text(report))}</b></p>"
    return f"<div>{heading}<table>{rows}</table>{notices}{image}</div>"


def _tiles(report: Report) -> str:
    facts = (
        ("machining time", duration_text(report.machining_time_s)),
        ("cutting rate", report.text("cutting_rate_mm2_min")),
        ("kerf", report.text("kerf_um.mean")),
        ("profile error, rms", report.text("profile_error_um.rms")),
    )
    tiles = (f'<div class="tile"><span>{name}</span><b>{escape(value)}</b></div>' for name, value in facts)
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _section(name: str, content: str) -> str:
    return f"<section>\n<h2>{name}</h2>\n{content}\n</section>"


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f'<table class="pairs">{"".join(cells)}</table>'


_HINT = '<p class="hint">Click a figure to enlarge it, and click it again to close it.</p>'


def _picture(picture: Picture) -> str:
    width, height = (round(inches * COLUMN_DPI) for inches in picture.figure.get_size_inches())
    address = _address(figure_png(picture.figure, COLUMN_DPI))
    return _enlarged(picture.name, picture.caption, address, width, height)


def _enlarged(name: str, words: str, address: str, width: int, height: int) -> str:
    caption = escape(words)
    image = f'<img src="{address}" alt="{caption}" width="{width}" height="{height}">'
    switch = f'<input type="checkbox" aria-label="enlarge: {caption}">'
    enlarged = f'<label class="enlarge">{switch}<span>{image}</span></label>'
    return f'<figure id="{name}">{enlarged}<figcaption>{caption}</figcaption></figure>'


def _address(png: bytes) -> str:
    """Return the data URL of a picture."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def _corners(report: Report) -> str:
    rows = (
        (mm_text(c.program_x_mm), mm_text(c.program_y_mm), f"{c.turn_deg:+.0f}", _error(c.error_um))
        for c in report.corners
    )
    return _table(("X, mm", "Y, mm", "turn, °", "error, µm"), rows)
