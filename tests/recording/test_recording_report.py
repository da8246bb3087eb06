"""The report: right sums, and never a NaN. Its fields are those of a page, see test_guide_pages.py."""

import dataclasses
import io
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from edmsim.closed_loop.passes import Sums
from edmsim.recording.report import (
    Corner,
    Coverage,
    Feed,
    Following,
    Kerf,
    Offset,
    ProfileErrors,
    Report,
    Totals,
    build_report,
    cut_id,
    duration_text,
    figure_text,
    outcome_text,
    rate_text,
    render_table,
    summary,
    write_json,
)
from edmsim.recording.windows import WindowTable

from .conftest import table_of

NAN = math.nan


def text_of(report):
    written = io.StringIO()
    Console(width=200, file=written).print(render_table(report))
    return written.getvalue()


def test_the_same_offset_is_not_advised_again():
    assert str(Offset(0.164, 0.537, 0.1635)) == "0.164 mm, right within 0.5 µm in the mean"
    assert str(Offset(0.164, 0.9, 0.1631)) == "0.164 mm, +0.9 µm in the mean (metal left): use --offset 0.163"


def nothing_known():
    totals = Totals(NAN, 0.0, Sums(), NAN, 0.0, 0.0, 0.0)
    return made_of(
        totals, WindowTable().to_arrow(), offset=Offset(NAN, NAN, NAN), outcome="stopped", reason="persistent short",
        settings={"out": Path("x"), "t": NAN},
    )  # fmt: skip


def of_windows(*rows, totals=None):
    """A report of windows of which only some figures matter."""
    return made_of(totals or Totals(1.0, 1.0, Sums(spark=1), 1.0, 1.0, 1.0, 1.0), table_of(rows))


def made_of(totals, windows, offset=None, **changes):
    made = {
        "outcome": "finished", "reason": None, "notices": (), "seed": 1, "settings": {}, "version": "0", **changes
    }
    return build_report(Report(offset=offset or Offset()), windows, totals, **made)


MANY_WINDOWS = """
import json
import numpy as np, pyarrow as pa
from edmsim.closed_loop.passes import Sums
from edmsim.recording.report import Report, Totals, build_report
from edmsim.recording.windows import WindowTable
draw = np.random.default_rng(1)
schema = WindowTable().to_arrow().schema
columns = [pa.array(np.sort(1e3 * draw.random(40_000))).cast(kind, safe=False) for kind in schema.types]
windows = pa.table(columns, schema.names)
totals = Totals(60.0, 1.0, Sums(1, 1, 1, 1), 1.0, 1.0, 1.0, 1.0)
more = dict(outcome="finished", reason=None, notices=(), seed=1, settings={}, version="0")
print(json.dumps(dict(build_report(Report(), windows, totals, **more))))
"""


@pytest.mark.slow
def test_figures_do_not_depend_on_the_number_of_threads(capfd):
    exec(MANY_WINDOWS, {})  # with as many as this process has
    here, counts = capfd.readouterr().out, {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    if os.environ.get("OMP_NUM_THREADS") == "1":
        counts = dict.fromkeys(counts, "2")
    subprocess.run([sys.executable, "-c", MANY_WINDOWS], check=True, env={**os.environ, **counts})
    assert capfd.readouterr().out == here
    assert json.loads(here)["mean_current_A"] > 0.0


def test_derived_figures(cut):
    report, totals = cut.report, cut.totals
    assert report["pulses"] == 3_000_000
    assert report["pulse_share"] == {"spark": 0.55, "arc": 0.02, "short": 0.03, "open": 0.4}
    assert report["realtime_factor"] == pytest.approx(1650 / 41)
    assert report["cutting_rate_mm2_min"] == pytest.approx(33.2 * 20 / (1500 / 60))
    assert report["overall_rate_mm2_min"] == pytest.approx(33.2 * 20 / (1650 / 60))
    assert report["wire"]["lag_um"] == pytest.approx(4.0, abs=0.05)
    assert report["wire"]["temperature_K_max"] == pytest.approx(350, abs=0.1)
    assert report["energy_J"] == totals.sums.energy
    assert report["reason"] is None


def test_means_are_weighted_by_the_time_a_window_takes():
    limit = Totals(1.0, 1.0, Sums(spark=1), 1.0, 1.0, 1.0, 1.0, feed_limit_um_s=40.0, limited_share=1 / 3)
    # the period says nothing about it where pulses also wait for their ignition
    ends = ((10.0, 0.1), (40.0, 0.15))
    rows = [{"feed_um_s": u, "mean_current_A": u / 10, "t_period_us": 9.0, "t_s": t} for u, t in ends]
    report = of_windows(*rows, totals=limit)
    assert report["feed_um_s"] == {
        "mean": pytest.approx(20.0), "max": 40.0, "limit": 40.0, "share_at_limit": pytest.approx(1 / 3)
    }
    assert report["mean_current_A"] == pytest.approx(2.0)
    away = {"following_x_um": 3.0, "following_y_um": 4.0, "t_s": 0.1}  # of both axes together
    report = of_windows(away, {"t_s": 0.4})
    assert report["following_error_um"] == {"max": pytest.approx(5.0), "rms": pytest.approx(2.5)}
    # a pause belongs to no window: the first one after it counts with its 200 periods
    ends = ((10.0, 0.1), (40.0, 60.1), (10.0, 60.2))
    report = of_windows(*({"mean_current_A": i, "spark": 200, "t_period_us": 500.0, "t_s": t} for i, t in ends))
    assert report["mean_current_A"] == pytest.approx(20.0)


def test_what_could_not_be_obtained_is_null(tmp_path):
    report = nothing_known()
    write_json(report, tmp_path / "report.json")
    text = (tmp_path / "report.json").read_text(encoding="utf-8")
    assert "NaN" not in text
    back = json.loads(text)
    assert back == json.loads(json.dumps(dict(report)))
    assert back["kerf_um"] == {"mean": None, "min": None, "max": None}
    assert set(back["feed_um_s"].values()) == {None}
    at = dict.fromkeys(("program_x_mm", "program_y_mm", "error_um", "why", "made_by"))
    assert back["profile_error_um"]["at"] == at
    assert back["profile_error_um"]["reachable"] == {"max": None, "rms": None, "p95": None, "at": at}
    assert set(back["offset"].values()) == {None}
    assert back["pulse_share"] == dict.fromkeys(("spark", "arc", "short", "open"))
    assert back["settings"] == {"out": "x", "t": None}
    assert back["wire"] == {"lag_um": None, "vibration_um_rms": None, "temperature_K_max": None}


def test_numpy_values_become_plain_json(cut, tmp_path):
    totals = dataclasses.replace(cut.totals, sums=Sums(spark=np.int64(10), energy=np.float64(3.5)))
    report = made_of(totals, cut.windows, settings={"sizes": np.array([1.0, np.nan])})
    write_json(report, tmp_path / "report.json")
    back = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert back["energy_J"] == 3.5
    assert back["settings"] == {"sizes": [1.0, None]}
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_terminal_shows_the_figures(cut):
    text = text_of(cut.report)
    for piece in (
        "finished", "27 min 30 s", "26.6 mm²/min over the cut alone", "24.1 mm²/min over the whole",
        "10.2 µm max", "X 10.000 Y 6.000", "made up",
    ):  # fmt: skip
        assert piece in text
    stopped = text_of(nothing_known())
    assert "persistent short" in stopped
    assert "none: nothing was cut beyond a start hole" in stopped
    assert "nan" not in stopped.lower()
    assert nothing_known().profile_error_um.worst_and_rms == "not measured"


def test_the_summary_reads_as_a_person_says_it(cut):
    report = dataclasses.replace(
        cut.report, following_error_um=Following(3.25, 0.75), coverage={"mean": 0.125, "max": 0.5},
        surface={"ra_um": 1.9, "heat_affected_um": 12.0, "electrolysed_um": None},
    )  # fmt: skip
    said = dict(summary(report))
    assert said["machining time"] == "27 min 30 s  (computed in 41.0 s, 40.24 times real time)"
    assert said["path"] == "33.20 mm"
    assert said["cutting rate"] == "26.6 mm²/min over the cut alone, 25 min 00 s; 24.1 mm²/min over the whole time"
    assert said["pulses"] == "3,000,000  spark 55.0 %  arc 2.0 %  short 3.0 %  open 40.0 %"
    assert said["kerf"] == "308.0 µm mean, 301.0 µm to 314.0 µm"
    assert said["profile error"] == "10.2 µm max, 2.1 µm rms, 4.0 µm for 95 %"
    assert said["made by"] == "not split: the wire is tilted, or its centre follows the contour"
    assert said["corners"] == "4, worst -10.2 µm at X 10.000 Y 6.000 mm (+90°)"
    assert said["wire"] == "lag 4.0 µm, vibration 0.80 µm rms, at most 350 K"
    assert said["axes"] == "3.2 µm behind at most, 0.8 µm rms"
    assert said["gas"] == "covers 12.5 % of the wire's front in the mean, at most 50.0 %"
    assert said["surface"] == "Ra 1.90 µm, heat-affected 12.0 µm"
    assert said["energy"] == "1800.0 J, 205.000 mm³ removed, 1.40 A, 55.0 V mean"
    assert not {"table", "equalising"} & set(said)


def test_the_summary_tells_what_only_some_cuts_have(cut):
    bare, left, profile = ({"max": 4.0 * k, "rms": 1.0 * k} for k in (1, 2, 3))
    table = {"without_um": bare, "left_um": left, "profile_without_um": profile, "compensated": False}
    equalising = {"net_voltage_V": -0.125, "power_W": 2.0, "energy_J": 30.0}
    shares = {"lag": {"rms": 1.5}, "gap": {"rms": None}}
    edge = {**cut.report["profile_error_um"], "shares": shares}
    changes = {"table_error_um": table, "equalising": equalising, "profile_error_um": edge}
    said = dict(summary(dataclasses.replace(cut.report, **changes)))
    assert said["table"] == "moves the wall by 4.0 µm max, 1.0 µm rms"
    assert said["equalising"] == "its pulses leave -0.12 V of the mean gap voltage and take 2.00 W, 30.00 J in all"
    assert said["made by"] == "lag 1.5 µm, gap – rms"
    unmeasured = {**table, "without_um": {"max": None, "rms": None}}
    assert "table" not in dict(summary(dataclasses.replace(cut.report, table_error_um=unmeasured)))
    unknown = {"kerf_um": Kerf(), "profile_error_um": ProfileErrors(), "coverage": Coverage()}
    said = dict(summary(dataclasses.replace(cut.report, **unknown)))
    assert said["gas"].startswith("covers – of the wire's front")
    assert said["kerf"].startswith("not measured: it was cut nowhere 0.5 mm or more from start holes")
    assert said["profile error"].startswith("not measured: no edge was cut 0.15 mm or more from start holes")
    assert not {"made by", "largest error"} & set(said)
    centred = dataclasses.replace(cut.report, **unknown, offset=Offset(0.0))
    assert dict(summary(centred))["profile error"] == "not measured: the wire's centre follows the contour"
    said = dict(summary(dataclasses.replace(cut.report, table_error_um={**table, "compensated": True})))
    assert said["table"] == "moves the wall by 4.0 µm max, 1.0 µm rms; compensated to 8.0 µm max, 2.0 µm rms"
    assert said["profile error without compensation"] == "12.0 µm max, 3.0 µm rms"


@pytest.mark.parametrize(("share", "said"), [
    (0.099, ""), (0.1, "; limited by the machine's greatest feed, 40.0 µm/s, for 10 % of the cut"), (None, ""),
])  # fmt: skip
def test_a_feed_that_held_the_cut_back_is_said_from_a_tenth_on(cut, share, said):
    report = dataclasses.replace(cut.report, feed_um_s=Feed(20.0, 40.0, 40.0, share))
    assert dict(summary(report))["feed"] == f"20.0 µm/s mean, 40.0 µm/s max{said}"


def test_corners_are_placed_in_the_program(cut):
    def said(*errors_um):
        corners = [Corner(30.0, -4e-4, 50.0, 20.0, -90.0, error_um) for error_um in errors_um]
        return dict(summary(dataclasses.replace(cut.report, corners=corners)))["corners"]

    assert said(1.0, 3.0, None) == "3, worst +3.0 µm at X 30.000 Y 0.000 mm (-90°)"
    assert said(None) == "1, none measured"
    assert said() == "none"


def test_a_report_is_read_by_attribute_and_by_name(cut):
    back = Report(**json.loads(json.dumps(cut.report, default=dict)))
    assert back == cut.report
    assert back.kerf_um.mean == back["kerf_um"]["mean"] == 308.0
    assert back.text("kerf_um.mean") == "308.0 µm"
    with pytest.raises(KeyError):
        back["text"]
    with pytest.raises(ValueError, match="5 where figures belong"):
        Report(kerf_um=5)


def test_a_cut_is_the_same_whatever_the_computer_s_time_was(cut):
    number = cut_id(cut.report)
    assert len(number) == 16
    assert cut_id(dataclasses.replace(cut.report, wall_time_s=1e3, realtime_factor=2.0)) == number
    assert cut_id(dataclasses.replace(cut.report, machining_time_s=1e3)) != number
    assert cut_id(dataclasses.replace(cut.report, seed=8)) != number


def test_a_heading_tells_outcome_and_rate(cut):
    assert outcome_text(cut.report) == "finished"
    assert outcome_text(nothing_known()) == "stopped: persistent short"
    assert rate_text(cut.report) == "26.6 mm²/min"
    assert rate_text(nothing_known()) == "no cutting rate"
    assert (figure_text(None, "µm"), figure_text(1.25, "µm", 2)) == ("–", "1.25 µm")


@pytest.mark.parametrize(("seconds", "text"), [
    (48.24, "48.2 s"), (59.97, "1 min 00 s"), (725, "12 min 05 s"), (3599.6, "1 h 00 min"), (12_030, "3 h 20 min"),
    (None, "unknown"),
])  # fmt: skip
def test_durations_read_as_people_say_them(seconds, text):
    assert duration_text(seconds) == text
