"""Samples of gap voltage and current: against their pulses, filters, noise, files, a firmware in C; the command."""

import ctypes
import math
import re
import shutil
import signal
import subprocess
import wave
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from edmsim.calibration import read_log
from edmsim.errors import InputError
from edmsim.hil import Rig, SampleReader, Sensing, delay_table
from edmsim.hil.gap import QUANTILES, Frame, write_delays
from edmsim.hil.samples import COUNT_A, COUNT_V, SampleFile, Sampler
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import OPEN, PULSE, SHORT, SPARK

FIRMWARE = r"""
#include <stdint.h>
#include <stdlib.h>
typedef int64_t (*read_t)(float *, float *, int64_t);
/* a firmware's filters: a fast and a slow mean of 12-bit samples of the gap voltage */
int run(read_t read, int64_t count, int32_t *fast, int32_t *slow) {
    float voltage[64], current[64];
    int32_t f = 0, s = 0;
    for (int64_t done = 0; done < count; done += 64) {
        if (read(voltage, current, 64) != 64) return 1;
        for (int k = 0; k < 64; k++) {
            int32_t adc = (int32_t)(voltage[k] / 128.0f * 4095.0f);
            f += ((adc << 8) - f) / 16;
            s += ((adc << 8) - s) / 512;
        }
    }
    *fast = f >> 8;
    *slow = s >> 8;
    return 0;
}
"""


def made(kinds, on_us=20.0, period_us=100.0, delay_us=5.0):
    """A frame of pulses whose every corner is known, at 80 V, 22 V, 10 A and shorts of 12 A."""
    rig = Rig("powercore", seed=1)
    real = rig.frame()
    rows = np.zeros(len(kinds), PULSE)
    rows["kind"], rows["start_us"] = kinds, np.arange(len(kinds)) * period_us
    rows["open_V"] = 80.0
    rows["delay_us"] = np.select([rows["kind"] == OPEN, rows["kind"] == SHORT], [on_us, 0.0], delay_us)
    rows["conducting_us"] = np.select([rows["kind"] == OPEN, rows["kind"] == SHORT], [0.0, on_us], on_us - delay_us)
    window = real.window._replace(start_ns=0, duration_ns=round(len(kinds) * period_us * 1e3))
    timing = real.timing._replace(burning_V=22.0, current_A=10.0, short_A=12.0)
    return Frame(window, rows, timing, True)


def test_a_sample_is_the_value_at_its_instant():
    time, voltage, current = Sampler(Sensing(rate_Hz=1e5)).samples(made([SPARK, OPEN, SHORT]))
    assert np.allclose(time, np.arange(30) * 1e-5)
    expected_V, expected_A = np.zeros(30), np.zeros(30)
    expected_V[:2] = 80.0, 22.0  # at 10 us, 5 us after its ignition, it burns
    expected_A[1] = 10.0
    expected_V[10:12] = 80.0, 80.0  # at 110 us the next one is still waited for
    expected_A[20:22] = 12.0, 12.0
    assert np.array_equal(voltage, expected_V)
    assert np.array_equal(current, expected_A)


def test_frames_join_without_a_seam_whatever_their_length():
    whole = made([SPARK, OPEN, SHORT, SPARK])
    for sensing in (Sensing(rate_Hz=3e4), Sensing(rate_Hz=3e4, low_pass_Hz=2e3)):
        sampler, parts = Sampler(sensing), []
        for k in range(4):
            row = whole.pulses[k : k + 1].copy()
            row["start_us"] = 0.0
            window = whole.window._replace(start_ns=k * 100_000, duration_ns=100_000)
            parts.append(sampler.samples(whole._replace(window=window, pulses=row)))
        joined = [np.concatenate(rows) for rows in zip(*parts, strict=True)]
        for one, other in zip(joined, Sampler(sensing).samples(whole), strict=True):
            assert np.allclose(one, other, atol=1e-6)


def test_the_low_pass_follows_its_closed_form():
    tau_us, steps = 1e6 / (2 * math.pi * 5e3), made([OPEN], on_us=90.0, period_us=200.0)
    _, voltage, _ = Sampler(Sensing(rate_Hz=1e5, low_pass_Hz=5e3)).samples(steps)
    at = np.arange(10.0, 90.1, 10.0)
    assert np.allclose(voltage[1:10], 80.0 * (1 - np.exp(-at / tau_us)), atol=0.02)
    assert voltage[10] == pytest.approx(80.0 * (1 - math.exp(-90.0 / tau_us)) * math.exp(-10.0 / tau_us), abs=0.02)


def test_a_slow_filter_shows_the_window_s_mean_voltage_and_current():
    rig = Rig("powercore-v2", seed=4)
    rig.run(0.05)
    sampler = Sampler(Sensing(rate_Hz=1e4, low_pass_Hz=50.0), rig.time_s * 1e6)
    charge, volts, seconds, parts = 0.0, 0.0, 0.0, []
    rig.move("VEL 4 0")
    while seconds < 1.0:
        frame = rig.frame()
        spent = frame.window.duration_ns * 1e-9
        seconds += spent
        volts += frame.window.mean_voltage_V * spent
        charge += frame.window.mean_current_A * spent
        parts.append(sampler.samples(frame)[1:])
    voltage, current = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    assert voltage[300:].mean() == pytest.approx(volts / seconds, rel=0.05)
    assert current[300:].mean() == pytest.approx(charge / seconds, rel=0.15)


def test_noise_is_added_with_its_seed_and_only_it():
    frame = made([OPEN] * 200)
    quiet, noisy, again = (
        Sampler(Sensing(1e5, noise_V=rms, noise_A=2 * rms, seed=7)).samples(frame) for rms in (0.0, 1.5, 1.5)
    )
    assert (noisy[1] - quiet[1]).std() == pytest.approx(1.5, rel=0.1)
    assert (noisy[2] - quiet[2]).std() == pytest.approx(3.0, rel=0.1)
    assert np.array_equal(noisy[1], again[1])


def test_a_reader_returns_as_many_as_requested_in_any_portions():
    readers = [SampleReader(Rig("powercore", seed=2), Sensing(2e4, 4e3, 0.5, 0.1, 3)) for _ in range(3)]
    at_once = readers[0].read(500)
    taken = [readers[1].read(n) for n in (1, 0, 7, 192, 300)]
    portions = [np.concatenate([part[k] for part in taken]) for k in (0, 1)]
    one_by_one = [pair for pair, _ in zip(readers[2], range(500), strict=False)]
    assert np.array_equal(at_once, portions)
    assert np.array_equal(np.array(at_once).T, np.array(one_by_one, np.float32))
    with pytest.raises(InputError, match="-1 samples"):
        readers[0].read(-1)


def test_what_the_rig_runs_between_two_reads_is_read_as_well():
    rigs = [Rig("powercore", seed=2) for _ in range(2)]
    readers = [SampleReader(rig, Sensing(2e4)) for rig in rigs]
    first = readers[1].read(40)
    rigs[1].run(0.01)
    assert np.array_equal(readers[0].read(400), np.concatenate([first, readers[1].read(360)], axis=1))


def test_reads_after_a_long_run_do_not_copy_what_is_still_unread():
    rig = Rig("powercore-v2", seed=2)
    reader = SampleReader(rig, Sensing(2e4))
    rig.run(0.1)
    first, second = (reader.read(64)[0] for _ in range(2))
    assert first.base is second.base


def test_counts_and_rigs_of_a_wrong_kind_are_refused_in_a_line():
    with pytest.raises(InputError, match=r"count cannot be 2\.5: give int"):
        SampleReader(Rig("powercore", seed=1)).read(2.5)
    with pytest.raises(InputError, match="rig cannot be 3: give Rig"):
        SampleReader(3)
    with pytest.raises(InputError, match=r"gaps_um cannot be 5\.0: give Sequence"):
        delay_table(Machine.load(), gaps_um=5.0)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
def test_a_firmware_in_c_filters_what_it_reads(tmp_path):
    source, library = tmp_path / "firmware.c", tmp_path / "firmware.so"
    source.write_text(FIRMWARE)
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    reader, same = (SampleReader(Rig("powercore-v2", seed=6), Sensing(rate_Hz=5e4)) for _ in range(2))
    fast, slow = ctypes.c_int32(), ctypes.c_int32()
    assert ctypes.CDLL(str(library)).run(reader.c_read, 6400, ctypes.byref(fast), ctypes.byref(slow)) == 0
    f = s = 0
    for volts in same.read(6400)[0].tolist():
        adc = int(np.float32(volts) / np.float32(128.0) * np.float32(4095.0))
        f += int(((adc << 8) - f) / 16)
        s += int(((adc << 8) - s) / 512)
    assert (fast.value, slow.value) == (f >> 8, s >> 8)
    assert slow.value > 0


def test_both_files_hold_the_same_samples(tmp_path):
    for name in ("gap.wav", "gap.parquet"):
        rig = Rig("powercore", seed=2)
        with SampleFile(tmp_path / name, Sensing(rate_Hz=2e4)) as file:
            rig.watch(file.frame)
            rig.run(0.3)
        assert file.notice == ""
    table = pq.read_table(tmp_path / "gap.parquet")
    with wave.open(str(tmp_path / "gap.wav")) as sound:
        assert (sound.getframerate(), sound.getnchannels()) == (20_000, 2)
        counts = np.frombuffer(sound.readframes(sound.getnframes()), "<i2").reshape(-1, 2)
    assert len(counts) == table.num_rows == pytest.approx(6000, abs=30)
    assert np.allclose(counts[:, 0] * COUNT_V, table["voltage_V"].to_numpy(), atol=COUNT_V)
    assert np.allclose(counts[:, 1] * COUNT_A, table["current_A"].to_numpy(), atol=COUNT_A)
    assert table["voltage_V"].to_numpy().max() == pytest.approx(80.0, abs=0.1)


@pytest.mark.parametrize(
    ("sensing", "said"),
    [
        (Sensing(rate_Hz=5e3), "10000 to 100000 Hz, not 5000"), (Sensing(rate_Hz=math.nan), "is nan"),
        (Sensing(low_pass_Hz=-1.0), "low_pass_Hz"), (Sensing(seed=-1), "seed is -1"),
        (Sensing(noise_V=math.inf), "noise_V"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured_is_refused(tmp_path, sensing, said):
    with pytest.raises(InputError, match=said):
        SampleFile(tmp_path / "gap.parquet", sensing)
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_or_in_no_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.parquet \.wav"):
        SampleFile(tmp_path / "gap.csv", Sensing())
    with pytest.raises(InputError, match="cannot be written"):
        SampleFile(tmp_path / "none" / "gap.wav", Sensing())


def test_samples_beyond_what_a_wav_file_holds_are_counted(tmp_path):
    with SampleFile(tmp_path / "gap.wav", Sensing(noise_V=1e4)) as file:
        file.frame(made([OPEN] * 10))
    assert re.fullmatch(r"\d+ samples are beyond 327.67 V or 327.67 A, which .*", file.notice)


@pytest.mark.slow
def test_a_wav_file_that_is_full_ends_there_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("edmsim.hil.samples._MOST_SAMPLES", 400)
    rig = Rig("powercore-v2", seed=1)
    with SampleFile(tmp_path / "gap.wav", Sensing()) as file:
        for _ in range(300):
            file.frame(rig.frame())
    assert file.count == 400
    assert re.search(r"ends at 4 GB: \d+ samples after these", file.notice)
    with wave.open(str(tmp_path / "gap.wav")) as read:
        assert read.getnframes() == 400


def test_delays_grow_with_the_gap_and_fall_with_the_voltage(tmp_path):
    rows = delay_table(Machine.load(), gaps_um=np.array([6.0, 12.0, 20.0]), voltages_V=(80.0, 120.0), draws=60)
    median = {(row.gap_um, row.open_V): row.us[QUANTILES.index(0.5)] for row in rows}
    assert median[6.0, 80.0] < median[12.0, 80.0] < median[20.0, 80.0]
    assert median[20.0, 120.0] < median[20.0, 80.0]
    assert all(list(row.us) == sorted(row.us) for row in rows if not np.isnan(row.us).any())
    write_delays(rows, tmp_path / "delays.csv")
    lines = (tmp_path / "delays.csv").read_text().splitlines()
    assert lines[0].startswith("gap_um,open_V,short_share,ignited_share,p05_us,p10_us")
    assert len(lines) == 7
    with pytest.raises(InputError, match="20 V ignite nothing"):
        delay_table(Machine.load(), voltages_V=(20.0,))
    with pytest.raises(InputError, match="the gap is 1 to 250 um, a wire's diameter, not -10"):
        delay_table(Machine.load(), gaps_um=(10.0, -10.0))


def test_samples_and_a_log_of_a_cut_at_a_feed(tmp_path, edmsim):
    files = ("--samples", f"{tmp_path}/out/gap.parquet", "--log", f"{tmp_path}/out/ratios.csv")
    options = ("--seconds", "0.6", "--rate", "10000", "--feed", "12", "--log-rate", "50", "--height", "10")
    status, _, said = edmsim("gap", *files, *options)
    assert status == 0
    assert pq.read_table(tmp_path / "out" / "gap.parquet").num_rows == pytest.approx(6000, abs=100)
    log = read_log(tmp_path / "out" / "ratios.csv")
    assert len(log) == pytest.approx(0.6 / 0.0255, abs=2)
    assert "samples in" in said
    assert f"{len((tmp_path / 'out' / 'ratios.csv').read_text().splitlines()) - 1} rows in" in said


def test_a_run_that_sigterm_ends_says_what_its_files_hold(tmp_path, monkeypatch, edmsim):
    whole, frames = Rig.frame, []

    def frame(rig):
        frames.append(whole(rig))
        if len(frames) == 20:
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(Rig, "frame", frame)
    log, samples = tmp_path / "ratios.csv", tmp_path / "gap.parquet"
    words = ("--samples", str(samples), "--log", str(log), "--seconds", "60", "--log-rate", "50", "--height", "10")
    status, _, said = edmsim("gap", *words)
    assert status == 128 + signal.SIGTERM
    assert f"{pq.read_table(samples).num_rows} samples in {samples}" in said
    assert f"{len(log.read_text().splitlines()) - 1} rows in {log}" in said


def test_a_table_of_delays(tmp_path, monkeypatch, edmsim):
    drawn = delay_table.__wrapped__
    monkeypatch.setattr(drawn, "__kwdefaults__", {
        **drawn.__kwdefaults__, "draws": 2, "gaps_um": (8.0,), "voltages_V": (80.0,),
    })  # fmt: skip
    assert edmsim("gap", "--delays", f"{tmp_path}/delays.csv").status == 0
    assert len((tmp_path / "delays.csv").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give --serial BOARD"), (("--serial", "uhu"), "there is no board 'uhu'"),
        (("--serial", "spark", "--speed", "0"), "--speed is above 0"),
        (("--samples", "a.csv"), "written as .parquet .wav"),
        (("--samples", "a.wav", "--speed", "3"), "--speed is that of ports"),
        (("--delays", "a.csv", "--seconds", "3"), "--seconds and --feed are those of a run"),
        (("--log", "b.csv", "--current-noise", "0.2"), "give the file with --samples"),
        (("--samples", "a.wav", "--log-rate", "5"), "give the file with --log"),
        (("--serial", "spark", "--feed", "3"), "--feed is that of a run without ports"),
        (("--serial", "spark", "--peak-current", "2"), "--peak-current has no effect, as the board spark sets it"),
        (("--log", "a.csv", "--log-rate", "1"), "2 to 100 rows"), (("--log", "b.txt"), "written as .csv"),
        (("--fmu", "gap.cir"), "written as .fmu"),
        (("--samples", "a.wav", "--rate", "1"), "10000 to 100000 Hz"),
        (("--samples", "a.wav", "--gap", "0"), "the gap is"),
        (("--log", "a.csv", "--generator", "steam"), "steam"), (("--delays", "a.txt"), "delays is written as .csv"),
        (("--samples", "a.wav", "--log", "b.csv", "--log-rate", "nan"), "2 to 100 rows"),
        (("--samples", "a.wav", "--log", "b.csv", "--seconds", "nan"), "--seconds is above 0, not nan"),
        (("--samples", "a.wav", "--log", "b.csv", "--feed", "nan"), "a feed in um/s must be a number, not nan"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("old", [{}, {"a.wav": "samples of the last run", "b.csv": "its log"}])
def test_what_cannot_be_is_refused_in_one_line_and_loses_nothing(tmp_path, monkeypatch, edmsim, words, said, old):
    monkeypatch.chdir(tmp_path)
    for name, text in old.items():
        Path(name).write_text(text)
    status, _, err = edmsim("gap", *words)
    assert (status, err.count("\n")) == (2, 1)
    assert said in err
    assert {str(file): file.read_text() for file in Path().rglob("*") if file.is_file()} == old


@pytest.mark.slow
def test_an_fmu_is_written_and_its_step_said(tmp_path, edmsim):
    pytest.importorskip("pythonfmu3")
    status, _, said = edmsim("gap", "--height", "10", "--fmu", f"{tmp_path}/gap.fmu")
    assert status == 0
    assert "its step is 0.0255 s" in said
    assert (tmp_path / "gap.fmu").is_file()
