"""Logs of counts and of ratios: what is read of them, what is refused, and which stretches of it are steady."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

import edmsim
from edmsim.calibration import Log, read_log
from edmsim.calibration.comparison import settle_um
from edmsim.calibration.fit import spread
from edmsim.calibration.log import BATCH_WINDOWS, COLUMNS, NEEDED, STRETCH_WINDOWS, Stretch, statistics, stretches
from edmsim.calibration.output import causes
from edmsim.errors import InputError
from edmsim.hil import Rig
from edmsim.hil.boards import PlainGenerator
from edmsim.hil.samples import RatioLog

SETTLE = 100
"""Windows of 25.5 ms at 20 um/s in a travel of 51 um."""
SETTLE_UM = 50.99


def rows(count, **values):
    """Return columns of a number of windows, of plausible values unless others are given."""
    usual = {"feed_um_s": 20.0, "short": 10.0, "open": 100.0, "mean_voltage_V": 21.0, "mean_current_A": 0.7,
             "mean_delay_us": 11.0, "t_on_us": 30.0, "t_period_us": 100.0}  # fmt: skip
    return {name: np.broadcast_to(np.asarray((usual | values)[name], float), count).copy() for name in COLUMNS}


def log_of(*parts):
    return Log("made up", {name: np.concatenate([part[name] for part in parts]) for name in COLUMNS})


def test_parquet_and_csv_are_read_alike(tmp_path):
    delays, short = np.array([0.0, np.nan, 3.0, 4.0, 5.0]), np.arange(5.0)
    table = pa.table(rows(5, mean_delay_us=delays, short=short, open=255.0 - short))  # all that there can be
    table = table.append_column("z_um", pa.array(range(5)))  # what is not needed is not looked at
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    pa.csv.write_csv(table, tmp_path / "log.csv")
    for name in ("log.parquet", "log.csv"):
        log = read_log(tmp_path / name)
        assert len(log) == 5
        assert list(log.columns) == list(COLUMNS)
        for column in COLUMNS:
            np.testing.assert_array_equal(log.columns[column], table[column].to_numpy())


@pytest.mark.slow
def test_a_log_of_a_cut_has_its_columns_and_its_settings(cut_small, tmp_path):
    result = cut_small(out=tmp_path, max_time_s=0.5)
    log = read_log(tmp_path / "windows.parquet")
    assert len(log) == result.windows.num_rows
    assert (log.settings.height_mm, log.settings.resolution, log.settings.seed) == (5.0, "fast", 1)
    pa.csv.write_csv(result.windows, tmp_path / "log.csv")
    assert read_log(tmp_path / "log.csv").settings is None


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ('{"colour": "red"}', "metadata cannot be read: a cut has no option 'colour'"),
        ('{"passes": 2}', "it is the log of a cut in 2 passes: .* give the log of a cut in one pass"),
    ],
)
def test_settings_that_are_none_of_a_cut_in_one_pass_are_refused_in_one_line(tmp_path, settings, said):
    table = pa.table(rows(5)).replace_schema_metadata({"edmsim": settings})
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(InputError, match=said) as refused:
        read_log(tmp_path / "log.parquet")
    assert str(tmp_path) in str(refused.value)
    assert "\n" not in str(refused.value)


POINTS = """\
feed_um_s,short,open,mean_voltage_V,mean_current_A,mean_delay_us,t_on_us,t_period_us,operator
20.5,3,120,41.25,0.75,11.5,30,100,M\u00fcller
21,4,118,41,0.5,,30,100,"Meier, jun."
"""
COMMAS = """\
feed_um_s;short;open;mean_voltage_V;mean_current_A;mean_delay_us;t_on_us;t_period_us;operator
20,5;3;120;41,25;0,75;11,5;30;100;M\u00fcller
21;4;118;41;0,5;;30;100;"Meier; jun."
"""


@pytest.mark.parametrize("content", [
    POINTS.encode(), COMMAS.encode(), COMMAS.encode("cp1252"), COMMAS.encode("utf-8-sig"), COMMAS.encode("utf-16"),
    COMMAS.encode("utf-16-le"), COMMAS.encode("utf-16-be"), POINTS.encode("utf-16"), POINTS.encode("utf-32"),
    COMMAS.replace(";", "\t").encode(), COMMAS.replace(",", ".").encode(), COMMAS.replace("\n", "\r\n").encode(),
    b"sep=;\r\n" + COMMAS.encode(), b"\n" + POINTS.replace("\n", "\n\n").encode(),
    POINTS.replace("20.5,", '"20,5",').replace("41.25", '"41,25"').replace("0.75", '"0,75"').replace("11.5", '"11,5"')
    .encode(),
    POINTS.replace("short", " short ").replace(",,", ",NaN,").encode(),
], ids=lambda content: ascii(content[:12]) + str(len(content)))  # fmt: skip
def test_csv_of_spreadsheets_is_read(tmp_path, content):
    (tmp_path / "log.csv").write_bytes(content)
    columns = read_log(tmp_path / "log.csv").columns
    assert columns["feed_um_s"].tolist() == [20.5, 21.0]
    assert columns["mean_voltage_V"].tolist() == [41.25, 41.0]
    assert columns["mean_current_A"].tolist() == [0.75, 0.5]
    assert columns["short"].tolist() == [3.0, 4.0]
    np.testing.assert_array_equal(columns["mean_delay_us"], [11.5, np.nan])


def test_parquet_is_known_by_what_it_holds(tmp_path):
    pa.parquet.write_table(pa.table(rows(3)), tmp_path / "log.dat")
    assert len(read_log(tmp_path / "log.dat")) == 3


HEADING = ",".join(COLUMNS) + "\n"


RESTING = "20,1,2,20,1,9,30,100,0,0\n" * 9


@pytest.mark.parametrize(("name", "content", "said"), [
    ("log.csv", None, "no such file"), ("log.csv", b"", "is empty"), ("log.csv", b" \n\n", "is empty"),
    ("log.csv", b"\xff\xfe", "is empty"),
    ("log.parquet", b"feed_um_s\n1\n", "is not a Parquet file; a log as CSV has a name that ends in .csv"),
    ("log.parquet", b"PAR1 and nothing", "is a damaged Parquet file"),
    ("log.csv", b"PK\x03\x04\x14\x00\x06\x00\x08\x00\x00\x00!\x00", "save a spreadsheet as CSV"),
    ("log.csv", b"\x1f\x8b\x08\xff\xfe", "is not text"),
    ("log.csv", b"\xff\xfea\x00b", "its encoding is not that of its byte order mark"),
    ("log.csv", b"feed_um_s,short\n1,2\n", "column open is missing; a log needs feed_um_s short open"),
    ("log.csv", b"20,1,2,20,1,9,30,100\n",
     "column feed_um_s is missing; .* its first line has: 20, 1, 2.*; a log of ratios needs t_s x_um"),
    ("log.csv", HEADING.encode(), "no windows in it: it has a heading only"),
    ("log.csv", HEADING.replace(",", ";").encode("utf-16"), "no windows in it: it has a heading only"),
    ("log.csv", f"{HEADING}20,1,2,20,1,x,30,100\n".encode(), "log.csv:2: mean_delay_us is 'x': give a number"),
    ("log.csv", f"um/s{HEADING[9:]}20,1\n".encode(), "column feed_um_s is missing"),
    ("log.csv", f"{HEADING}20,1,2,20,1,9,30,100\n\n20,1,2,1_0,1,9,30,100\n".encode(),
     "log.csv:4: mean_voltage_V is '1_0'"),
    ("log.csv", f"{HEADING}20,5,1,2,20,1,9,30,100\n".encode(), "csv:2: it has 9 fields where the heading has 8"),
    ("log.csv", f"{HEADING}20,1,2\n".encode(), "log.csv:2: it has 3 fields"),
    ("log.csv", f"{HEADING.replace(',', ';')}1.020,5;1;2;20;1;9;30;100\n".encode(), "feed_um_s is '1.020,5'"),
    ("log.csv", f"{HEADING[:-1]},short\n20,1,2,20,1,9,30,100,1\n".encode(), "column short is there 2 times"),
    ("log.csv", f"{HEADING}20,200,100,20,1,9,30,100\n".encode(), "window 1: short 200 cannot be"),
    ("log.csv", f"{HEADING}20,0.1,0.6,20,1,9,30,100\n".encode(), "open 0.6 cannot be; short and open are counts"),
    ("log.csv", f"{HEADING}20,4,59.5,20,1,9,30,100\n".encode(), "open 59.5 cannot be; short and open are counts"),
    ("log.csv", f"{HEADING}20,1,2,20,1,9,30,100\n20,1,2,20,1,9,30,30\n".encode(), "window 2: t_period_us 30"),
    ("log.csv", f"{HEADING}20,1,2,,1,9,30,100\n20,1,2,20,1,9,30,100\n".encode(), "window 1: mean_voltage_V nan"),
    ("log.csv", f"{HEADING[:-1]},x_um,y_um\n{RESTING}".encode(), "y_um move by 0 um, feed_um_s leads over"),
    ("log.csv", f"{HEADING}20,1,2,inf,1,9,30,100\n".encode(), "window 1: mean_voltage_V inf"),
    ("log.csv", f"{HEADING}20,1,2,20,1,-9,30,100\n".encode(), "window 1: mean_delay_us -9"),
    ("log.csv", f"{HEADING}20,1,2,20,1,1e300,30,100\n".encode(), "window 1: mean_delay_us 1e.300"),
    ("log.csv", f"{HEADING}20,1,2,-1e300,1,9,30,100\n".encode(), "window 1: mean_voltage_V -1e.300"),
    ("log.csv", f"{HEADING}20,1,2,20,1,9,30,1e300\n".encode(), "window 1: t_period_us 1e.300"),
    ("log.csv", f"{HEADING}20,1,2,20,1,9,30,inf\n".encode(), "window 1: t_period_us inf"),
    ("log.csv", f"{HEADING}20,{10**30},2,20,1,9,30,100\n".encode(), "window 1: short 1e.30 cannot be"),
    ("log.csv", f"{HEADING}20,inf,2,20,1,9,30,100\n".encode(), "window 1: short inf cannot be"),
    ("log.csv", f"{HEADING}{'ü,' * 7}1\n".encode("latin-1"), "log.csv:2: feed_um_s is 'ü': give a number"),
    ("log.csv", b"\x00\xff" * 500, "column feed_um_s is missing"),
    ("log.parquet", b"\x00\xff" * 500, "is not a Parquet file"),
    ("log.csv", f"{HEADING[:-1]},höhe\n".encode("latin-1"), "no windows in it"),
])  # fmt: skip
def test_what_is_no_log_is_refused_in_one_line(tmp_path, name, content, said):
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=said) as refused:
        read_log(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_folder_and_text_in_parquet_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_log(tmp_path)
    table = pa.table({**rows(2), "short": ["a", "b"]})
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(InputError, match="column short holds something that is not a number"):
        read_log(tmp_path / "log.parquet")


def test_delays_are_weighted_by_what_ignited():
    short, open_ = np.zeros(BATCH_WINDOWS), np.full(BATCH_WINDOWS, 155.0)
    delay = np.full(BATCH_WINDOWS, 10.0)
    open_[0], delay[0] = 255.0, np.nan  # nothing ignited here
    open_[1], delay[1] = 55.0, 4.0  # and twice as much here
    (batch,) = statistics(short, open_, np.full(40, 20.0), np.full(40, 1.0), delay)
    assert batch[1] == pytest.approx((38 * 155 + 255 + 55) / 40 / 255)
    assert batch[4] == pytest.approx((38 * 100 * 10 + 200 * 4) / (38 * 100 + 200))
    assert np.isnan(statistics(short, np.full(40, 255.0), short, short, np.full(40, np.nan))[0, 4])


def test_stretches_begin_after_each_change_has_settled():
    count = SETTLE + STRETCH_WINDOWS + 20
    log = log_of(rows(count), rows(count, feed_um_s=30.0), rows(count, feed_um_s=30.0, t_on_us=20.0))
    found = stretches(log, SETTLE_UM)
    assert [s.feed_um_s for s in found] == [20.0, 30.0, 30.0]
    assert [s.t_on_us for s in found] == [30.0, 30.0, 20.0]
    assert [s.first for s in found] == [99, count + 66, 2 * count + 66]  # 100 and 66.7 windows of travel
    np.testing.assert_allclose(found[0].mean, [10 / 255, 100 / 255, 21.0, 0.7, 11.0])
    first, second = stretches(log_of(rows(count + STRETCH_WINDOWS)), SETTLE_UM)
    assert first.travelled_um == pytest.approx(SETTLE_UM, abs=1.0)
    assert second.travelled_um == pytest.approx(SETTLE_UM + STRETCH_WINDOWS * 20.0 * 25.5e-3, abs=1.0)


def test_a_setting_that_differs_by_rounding_errors_is_the_same(tmp_path):
    count = SETTLE + STRETCH_WINDOWS + 20
    period_us = 30.0 + 70.0 * (1.0 + 1e-12 * np.arange(count))  # as sums of on-time and pause are
    found = stretches(log_of(rows(count, t_period_us=period_us)), SETTLE_UM)
    assert [stretch.first for stretch in found] == [99]
    lines = [line.replace(",100", f",{100 + 1e-9 * k:.9f}") for k, line in enumerate(steady(0.1, 0.2, 20.0, 2.0))]
    assert len(read_log(written(tmp_path, lines))) == len(read_log(written(tmp_path, steady(0.1, 0.2, 20.0, 2.0))))


def test_air_rest_and_unsteady_feeds_are_left_out():
    count = SETTLE + STRETCH_WINDOWS
    restless = 20.0 + 15.0 * (-1.0) ** np.arange(count)
    log = log_of(
        rows(count, open=250.0, short=0.0), rows(count, feed_um_s=0.0, t_on_us=29.0), rows(count, t_on_us=28.0),
        rows(count, feed_um_s=restless, t_on_us=27.0), rows(count, feed_um_s=-20.0, t_on_us=26.0),
    )  # fmt: skip
    assert [s.t_on_us for s in stretches(log, SETTLE_UM)] == [28.0]


def test_what_a_machine_does_not_measure_is_an_empty_column_and_not_0(tmp_path):
    count = SETTLE + STRETCH_WINDOWS
    pa.csv.write_csv(pa.table(rows(count, mean_current_A=np.nan)), tmp_path / "log.csv")
    (found,) = stretches(read_log(tmp_path / "log.csv"), SETTLE_UM)
    assert np.isfinite(found.mean).tolist() == [True, True, True, False, True]
    with pytest.raises(InputError, match=r"windows 100 to 499: mean_current_A is 0 in all of them; leave the column"):
        stretches(log_of(rows(count, mean_current_A=0.0)), SETTLE_UM)


def test_a_stretch_too_short_to_turn_counts_as_straight():
    log = log_of(rows(2 * STRETCH_WINDOWS, feed_um_s=1.0))
    placed = Log("made up", {**log.columns, "x_um": np.arange(len(log)) * 0.0255, "y_um": np.zeros(len(log))})
    assert len(stretches(placed, 5.0)) == len(stretches(log, 5.0)) == 1


def test_of_many_stretches_those_that_differ_are_compared():
    steady = [Stretch(n, feed, 30.0, 100.0, np.zeros((10, 5))) for n, feed in enumerate([20.0] * 6 + [30.0, 10.0])]
    assert [s.feed_um_s for s in spread(steady, 3)] == [20.0, 30.0, 10.0]
    assert spread(steady, 99) == steady


@pytest.mark.parametrize(
    ("turn_deg", "radius_um", "expected"),
    [(0, 1, [0, 1, 2]), (90, 1, [0, 2]), (30, 1, [0, 1, 2]), (90, 100, [0, 2]), (30, 20_000, [0, 1, 2])],
)
def test_stretches_in_which_the_path_turns_are_left_out(turn_deg, radius_um, expected):
    """The turn begins in window 600; a wire settles over 50 um, so the stretch after a corner counts again."""
    count = SETTLE + 3 * STRETCH_WINDOWS
    log = log_of(rows(count))
    travel = np.arange(count) * 20.0 * 0.0255
    turned = np.clip((travel - travel[600]) / radius_um, 0.0, np.radians(turn_deg))
    steps = np.exp(1j * turned[:-1]) * np.diff(travel)
    places = np.concatenate([[0.0], np.cumsum(steps)])
    with_places = Log("made up", {**log.columns, "x_um": 2 * np.round(places.real / 2), "y_um": places.imag.round()})
    everywhere = [s.first for s in stretches(log, SETTLE_UM)]
    assert len(everywhere) == 3
    assert [s.first for s in stretches(with_places, SETTLE_UM)] == [everywhere[k] for k in expected]


@pytest.mark.parametrize(
    ("misfit", "resolution", "named"), [(9.0, "fast", "default or --resolution fine"), (2.0, "fast", "")]
)
def test_a_large_misfit_names_its_likely_causes_another_resolution_first(misfit, resolution, named):
    found = causes(SimpleNamespace(misfit=misfit), resolution)
    assert bool(found) == bool(named)
    assert not found or (named in found[1] and "--fit" in found[3])


RATIOS_HEADING = ",".join(NEEDED)
LATER = "1,0,0,0,0,30,100"


def written(folder, rows, heading=RATIOS_HEADING):
    file = folder / "ratios.csv"
    file.write_text("\n".join([heading, *rows]) + "\n")
    return file


def steady(short, open_, rate_Hz, seconds, feed_um_s=5.0):
    times = np.arange(0.0, seconds, 1.0 / rate_Hz)
    return [f"{t:.6f},{2 * (feed_um_s * t // 2):g},0,{short},{open_},30,100" for t in times]


@pytest.mark.parametrize("rate_Hz", [2.0, 10.0, 100.0])
def test_a_steady_log_comes_to_steady_windows_whatever_its_rate(tmp_path, rate_Hz):
    log = read_log(written(tmp_path, steady(0.2, 0.4, rate_Hz, 200.0)))
    assert len(log) == pytest.approx(200.0 / 0.0255, abs=25)
    assert np.allclose(log.columns["short"], 51.0)
    assert np.allclose(log.columns["open"], 102.0)
    assert log.columns["feed_um_s"][100:-100].mean() == pytest.approx(5.0, rel=0.02)
    assert log.columns["feed_um_s"][100:-100].std() < 0.1 * 5.0
    assert np.isnan(log.columns["mean_voltage_V"]).all()
    found = stretches(log, 300.0)
    assert len(found) >= 10
    assert np.allclose(found[0].mean[:2], [0.2, 0.4])
    assert np.isnan(found[0].mean[2:]).all()


def test_a_window_gets_the_mean_over_its_time(tmp_path):
    rows = [f"{t:g},0,0,{short},0,30,100" for t, short in ((0.0, 1.0), (0.02, 0.5), (0.03, 0.1), (0.06, 0.1))]
    log = read_log(written(tmp_path, rows))
    first = (0.02 * 0.5 + 0.0055 * 0.1) / 0.0255  # what the first row is of began before the log
    assert np.allclose(log.columns["short"], [255 * first, 25.5])


def test_another_setting_begins_its_windows_anew(tmp_path):
    rows = steady(0.1, 0.2, 20.0, 2.0)
    rows += [f"{2.0 + k / 20:g},10,0,0.3,0.2,20,200" for k in range(40)]
    log = read_log(written(tmp_path, rows))
    assert set(log.columns["t_period_us"]) == {100.0, 200.0}
    assert np.allclose(log.columns["short"][log.columns["t_period_us"] == 200.0], 76.5)


def test_a_jump_of_the_feed_in_a_log_of_ratios_ends_a_stretch(tmp_path):
    times = np.arange(0.0, 60.0, 0.2)
    places = np.where(times < 30.0, 20.0 * times, 600.0 + 25.0 * (times - 30.0))
    rows = [f"{t:.1f},{x:.1f},0,0.1,0.2,30,100" for t, x in zip(times, places, strict=True)]
    log = read_log(written(tmp_path, rows))
    found = stretches(log, 100.0)
    assert [round(s.feed_um_s, 3) for s in found] == [20.0, 20.0, 25.0, 25.0]
    assert found[2].travelled_um == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("pause_s", [3.0, 1.7e9])  # the clock of the log was set, too
def test_of_a_pause_nothing_is_known(tmp_path, pause_s):
    before, after = steady(0.1, 0.2, 10.0, 10.0), steady(0.3, 0.2, 10.0, 10.0)
    after = [f"{float(row.split(',')[0]) + 10.0 + pause_s:.6f},{row.split(',', 1)[1]}" for row in after]
    log = read_log(written(tmp_path, [*before, *after]))
    assert len(log) == pytest.approx(2 * 9.9 / 0.0255, abs=2)
    assert set(np.round(log.columns["short"], 1)) == {25.5, 76.5}


@pytest.mark.slow
def test_a_bench_s_log_has_the_statistics_of_its_own_counts(tmp_path):
    machine = edmsim.Machine.load(height_mm=10.0)
    rig = Rig(PlainGenerator(machine), machine, seed=1)
    counts = np.zeros(3)
    with RatioLog(tmp_path / "ratios.csv", rig, 10.0) as log:
        rig.watch(log.frame)
        while rig.time_s < 60.0:
            rig.gap.setpoints.move_at((12.0, 0.0), rig.gap.plant.time_ns)
            window = rig.frame().window
            counts += np.array([window.short, window.open, window.pulses]) * (rig.time_s > 40.0)
    assert log.count == 600
    found = stretches(read_log(tmp_path / "ratios.csv"), settle_um(machine))
    late = [stretch for stretch in found if stretch.first * 0.0255 > 40.0]
    assert late[0].feed_um_s == pytest.approx(12.0, rel=0.03)
    begin = late[0].first
    assert begin + STRETCH_WINDOWS <= 60.0 / 0.0255
    assert np.mean([s.mean[0] for s in late]) == pytest.approx(counts[0] / counts[2], abs=0.02)
    assert np.mean([s.mean[1] for s in late]) == pytest.approx(counts[1] / counts[2], abs=0.03)


@pytest.mark.parametrize(("rows", "said"), [
    (["0,0,0,0.1,0.1,30,100"], "fewer than two rows"), (["0,0,0,1.1,0,30,100", LATER], "row 1: short_ratio 1.1"),
    (["0,0,0,0.5,0.6,30,100", LATER], "row 1: open_ratio 0.6"), (["0,0,0,0,0,30,100"] * 2, "row 2: t_s 0"),
    (["0,0,0,0,0,30,20", "1,0,0,0,0,30,20"], "row 1: t_period_us 20"),
    (["0,nan,0,0,0,30,100", LATER], "row 1: x_um nan"),
    (["0,0,0,0,0,30,100", LATER], "1 rows per second; a log of ratios has 2 to 100"),
    (["0,0,0,0,0,30,100", "0.01,0,0,0,0,30,100"], "is too short"),
    (["0,0,0,0,0,30,100", "inf,0,0,0,0,30,100"], "row 2: t_s inf"),
])  # fmt: skip
def test_what_cannot_have_been_logged_is_refused(tmp_path, rows, said):
    with pytest.raises(InputError, match=said):
        read_log(written(tmp_path, rows))


def test_a_missing_column_is_named(tmp_path):
    for name in NEEDED:
        if name == "short_ratio":
            continue  # without it, it is taken for a log of counts
        heading = RATIOS_HEADING.replace(name, f"no_{name}")
        with pytest.raises(InputError, match=f"column {name} is missing; a log of ratios needs"):
            read_log(written(tmp_path, ["0,0,0,0,0,30,100"] * 2, heading))


@pytest.mark.parametrize(("name", "rate", "said"), [("a.csv", 1.0, "2 to 100 rows"), ("a.txt", 10.0, r"as \.csv")])
def test_a_log_of_the_bench_at_no_rate_or_under_another_name_is_refused(tmp_path, name, rate, said):
    with pytest.raises(InputError, match=said):
        RatioLog(tmp_path / name, Rig("powercore", seed=1), rate)
