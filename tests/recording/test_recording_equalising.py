"""Equalising pulses in what is recorded of a cut: table, sums, traces, oscilloscope, figure, report."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers.feed.laws import FixedController
from edmsim.job.result import recorders_for
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import SHORT
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.figures.cut import pulses_figure
from edmsim.recording.report import build_report, summary
from edmsim.recording.rerun.logs import SCOPE_PULSES, VOLTAGE_HEIGHT
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.windows import NAMES, Closeups, WindowTable, column, read_windows, traces, write_windows


def cut_of(generator):
    """Some windows of a straight cut from its start hole, recorded as a cut is."""
    points = np.array([(30_000, 30_000), (31_000, 30_000)])
    contour = WireContour(points, 0, points * 1e-3, False, "left", ((1, 0.05),), (1, 1))
    path = CutPath((contour,), (25.0, 25.0, 40.0, 40.0), 0.15, (30.0, 30.0), (), "test")
    machine = Machine.load(height_mm=5, generator=generator)
    store = recorders_for(machine, (), "fast")
    run = Simulation(machine, path, FixedController(33.0), seed=1, resolution="fast", recorders=list(store))
    for _ in range(60):
        run.step()
    return SimpleNamespace(machine=machine, run=run, table=store.windows.to_arrow(), store=store)


@pytest.fixture(scope="module")
def equalised():
    return cut_of("equalising")


# T-12, T-86
def test_the_table_has_what_is_left_and_what_it_takes_and_a_plain_one_does_not(equalised, tmp_path):
    table, plain = equalised.table, cut_of("iso-pulse")
    assert table.column_names == [*NAMES, "net_voltage_V", "equalising_W"]
    np.testing.assert_allclose(column(table, "net_voltage_V"), 0.0, atol=1e-9)
    assert column(table, "mean_voltage_V").min() > 5.0
    assert plain.table.column_names == list(NAMES)
    for name in NAMES:  # the cut itself is the same, to the bit
        np.testing.assert_array_equal(column(table, name), column(plain.table, name))
    write_windows(table, tmp_path / "windows.parquet")
    read = read_windows(tmp_path / "windows.parquet")
    assert read.schema.equals(table.schema, check_metadata=True)
    for name in table.column_names:
        np.testing.assert_array_equal(column(read, name), column(table, name))
    resumed = WindowTable(equalising=True)
    resumed.restore(equalised.store.windows.snapshot())
    np.testing.assert_array_equal(resumed.rows, equalised.store.windows.rows)


# T-86
def test_sums_have_the_voltage_with_its_sign_and_the_energy_of_the_supply(equalised):
    table, sums = equalised.table, equalised.run.sums
    seconds = np.diff(column(table, "t_s"), prepend=0.0)
    assert abs(sums.voltage_s) < 1e-9
    assert sums.equalising_J == pytest.approx((column(table, "equalising_W") * seconds).sum())
    assert sums.equalising_J > 0.0


# T-12
def test_traces_show_them_and_their_mean_is_0(equalised):
    rows = equalised.store.closeups.table()
    count = int(rows["count"].min())
    time, voltage, current = traces(rows, count)
    assert time.shape == (len(rows), count, 9)
    assert np.all(np.diff(time.reshape(len(rows), -1), axis=1) >= 0.0)
    over = np.trapezoid(voltage[:, :-1], time[:, :-1], axis=-1).sum(axis=1)  # the last pulse ends before its pause
    np.testing.assert_allclose(over / time[:, -1, 0], 0.0, atol=1e-3)  # times are kept in single precision
    low = voltage.min(axis=(1, 2))
    np.testing.assert_allclose(low, rows["opposite_V"])
    assert np.all((low >= -60.0) & (low < -55.0))
    flows = current < 0.0
    assert np.all(voltage[flows] < 0.0)
    np.testing.assert_allclose(current.min(axis=(1, 2)), rows["opposite_A"])
    kinds = rows["pulses"]["kind"][:, -count:]
    assert not flows[kinds == SHORT].any()


def made_up(opposite_V):
    """Two pulses, 20 us of 90 V and 10 us of 30 V, then one to end with: periods of 80 us."""
    store = Closeups(3, 8, 1)
    row = store.row
    row["t_s"], row["burning_V"], row["current_A"] = 1.0, 30.0, 6.0
    row["opposite_V"], row["opposite_A"] = opposite_V, -0.02
    pulses = row["pulses"][:3]
    pulses["kind"], pulses["start_us"], pulses["delay_us"], pulses["conducting_us"] = 1, (0, 80, 160), 20, 10
    pulses["open_V"], row["count"] = 90.0, 3
    store.keep()
    return store.table()


@pytest.mark.parametrize(("opposite_V", "first_us", "second_us"), [(-70.0, 30.0, 30.0), (-40.0, 50.0, 50.0)])
def test_a_trace_by_hand(opposite_V, first_us, second_us):
    # 2100 V us a pulse, and 50 us of room: what 40 V have not balanced is owed
    time, voltage, current = traces(made_up(opposite_V), 3)
    for number, lasts in enumerate((first_us, second_us)):
        t, u, i = (values[0, number] for values in (time, voltage, current))
        assert np.trapezoid(np.minimum(u, 0.0), t) == pytest.approx(opposite_V * lasts)
        assert np.trapezoid(np.minimum(i, 0.0), t) == pytest.approx(-0.02 * lasts)
        assert np.trapezoid(np.maximum(u, 0.0), t) == pytest.approx(2100.0)
        assert t[6] - t[5] == pytest.approx(lasts)


def test_the_figure_has_a_second_voltage(equalised):
    panel = pulses_figure(equalised.table).axes[1]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["with equalising pulses"]
    assert len(panel.lines) == 2
    np.testing.assert_allclose(panel.lines[1].get_ydata(), 0.0, atol=1e-9)


def test_the_report_says_what_is_left_and_what_it_takes(equalised, cut):
    totals = replace(cut.totals, sums=replace(cut.totals.sums, equalising_J=2.5))
    report = build_report(
        cut.part, equalised.table, totals, outcome="finished", reason=None, notices=(), seed=1, settings={},
        version="0",
    )  # fmt: skip
    assert report["equalising"]["net_voltage_V"] == pytest.approx(0.0, abs=1e-9)
    assert report["equalising"]["power_W"] == pytest.approx(column(equalised.table, "equalising_W").mean())
    assert report["equalising"]["energy_J"] == 2.5
    line = dict(summary(report))["equalising"]
    assert "0.00 V of the mean gap voltage" in line.replace("-", "")
    assert "2.50 J" in line
    assert cut.report["equalising"] is None
    assert "equalising" not in dict(summary(cut.report))


def test_the_oscilloscope_has_its_0_above_the_pulses_of_the_other_polarity(equalised, record, tmp_path):
    store = equalised.store
    file = record(
        tmp_path / "cut.rrd", windows=equalised.table, frames=store.frames, closeups=store.closeups,
        machine=equalised.machine,
    )  # fmt: skip
    play = Playback(file)
    t_s = float(store.closeups.table()["t_s"][-1])
    strips = np.array(play.strips("/scope/voltage", "LineStrips2D:strips", t_s))
    assert strips.shape == (SCOPE_PULSES, 9, 2)
    marks = play.points("/scope/scale", "Points2D:labels", 0.0)
    places = dict(zip(marks, play.points("/scope/scale", "Points2D:positions", 0.0)[:, 1], strict=True))
    assert places["50 V"] < places["0 V"] < places["-50 V"] < VOLTAGE_HEIGHT
    lowest = strips[..., 1].max()
    assert places["-50 V"] < lowest <= VOLTAGE_HEIGHT
    assert lowest == pytest.approx(VOLTAGE_HEIGHT, abs=1.0)  # where the water leaked least
    np.testing.assert_allclose(play.series("/voltage/net_voltage_V")[1], 0.0, atol=1e-9)
