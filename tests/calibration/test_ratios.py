"""Logs of ratios: made into windows, against the same cut's counts, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import edmsim
from edmsim.calibration import read_log
from edmsim.calibration.log import STRETCH_WINDOWS, stretches
from edmsim.calibration.ratios import NEEDED
from edmsim.calibration.simulate import settle_um
from edmsim.errors import InputError
from edmsim.hil import Rig
from edmsim.hil.ratio_log import RatioLog
from edmsim.hil.rig import PlainGenerator

HEADING = ",".join(NEEDED)
LATER = "1,0,0,0,0,30,100"


def written(folder: Path, rows: list[str], heading: str = HEADING) -> Path:
    file = folder / "ratios.csv"
    file.write_text("\n".join([heading, *rows]) + "\n")
    return file


def steady(short: float, open_: float, rate_Hz: float, seconds: float, feed_um_s: float = 5.0) -> list[str]:
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
    found = stretches(read_log(tmp_path / "ratios.csv"), settle_um(machine))
    late = [stretch for stretch in found if stretch.first * 0.0255 > 40.0]
    assert late[0].feed_um_s == pytest.approx(12.0, rel=0.03)
    begin = late[0].first
    assert begin + STRETCH_WINDOWS <= 60.0 / 0.0255
    assert np.mean([s.mean[0] for s in late]) == pytest.approx(counts[0] / counts[2], abs=0.02)
    assert np.mean([s.mean[1] for s in late]) == pytest.approx(counts[1] / counts[2], abs=0.03)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["0,0,0,0.1,0.1,30,100"], "fewer than two rows"), (["0,0,0,1.1,0,30,100", LATER], "row 1: short_ratio 1.1"),
        (["0,0,0,0.5,0.6,30,100", LATER], "row 1: open_ratio 0.6"), (["0,0,0,0,0,30,100"] * 2, "row 2: t_s 0"),
        (["0,0,0,0,0,30,20", "1,0,0,0,0,30,20"], "row 1: t_period_us 20"),
        (["0,nan,0,0,0,30,100", LATER], "row 1: x_um nan"),
        (["0,0,0,0,0,30,100", LATER], "1 rows per second; a log of ratios has 2 to 100"),
        (["0,0,0,0,0,30,100", "0.01,0,0,0,0,30,100"], "is too short"),
    ],
)  # fmt: skip
def test_what_cannot_have_been_logged_is_refused(tmp_path, rows, said):
    with pytest.raises(InputError, match=said):
        read_log(written(tmp_path, rows))


def test_a_missing_column_is_named(tmp_path):
    for name in NEEDED:
        if name == "short_ratio":
            continue  # without it, it is taken for a log of counts
        heading = HEADING.replace(name, f"no_{name}")
        with pytest.raises(InputError, match=f"column {name} is missing; a log of ratios needs"):
            read_log(written(tmp_path, ["0,0,0,0,0,30,100"] * 2, heading))


@pytest.mark.parametrize(("name", "rate", "said"), [("a.csv", 1.0, "2 to 100 rows"), ("a.txt", 10.0, r"as \.csv")])
def test_a_log_of_the_bench_at_no_rate_or_under_another_name_is_refused(tmp_path, name, rate, said):
    with pytest.raises(InputError, match=said):
        RatioLog(tmp_path / name, Rig("powercore", seed=1), rate)
