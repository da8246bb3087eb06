"""``edmsim gap`` without ports, and ``edmsim export``: files, defaults, refusals."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from edmsim.calibration import read_log
from edmsim.cli import app as cli
from edmsim.hil import delays


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["edmsim", *words])
    with pytest.raises(SystemExit) as left:
        cli.main()
    return int(left.value.code or 0)


def test_samples_and_a_log_of_a_cut_at_a_feed(tmp_path, monkeypatch, capfd):
    files = ("--samples", f"{tmp_path}/out/gap.parquet", "--log", f"{tmp_path}/out/ratios.csv")
    options = ("--seconds", "0.6", "--rate", "10000", "--feed", "12", "--log-rate", "50", "--height", "10")
    assert run(monkeypatch, "gap", *files, *options) == 0
    assert pq.read_table(tmp_path / "out" / "gap.parquet").num_rows == pytest.approx(6000, abs=100)
    log = read_log(tmp_path / "out" / "ratios.csv")
    assert len(log) == pytest.approx(0.6 / 0.0255, abs=2)
    assert "samples of" in capfd.readouterr().err


def test_a_table_of_delays(tmp_path, monkeypatch):
    monkeypatch.setattr(delays.delay_table, "__kwdefaults__", {
        **delays.delay_table.__kwdefaults__, "draws": 2, "gaps_um": (8.0,), "voltages_V": (80.0,),
    })  # fmt: skip
    assert run(monkeypatch, "gap", "--delays", f"{tmp_path}/delays.csv") == 0
    assert len((tmp_path / "delays.csv").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give --serial BOARD"), (("--serial", "uhu"), "there is no board 'uhu'"),
        (("--serial", "spark", "--speed", "0"), "--speed is above 0"),
        (("--samples", "a.csv"), "written as .parquet or .wav"),
        (("--log", "a.csv", "--log-rate", "1"), "2 to 100 rows"),
        (("--samples", "a.wav", "--rate", "1"), "10000 to 100000 Hz"),
        (("--samples", "a.wav", "--gap", "0"), "the gap is"),
        (("--log", "a.csv", "--generator", "steam"), "steam"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(tmp_path, monkeypatch, capfd, words, said):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "gap", *words) == 2
    err = capfd.readouterr().err
    assert said in err
    assert not [file for file in Path().rglob("*") if file.is_file()]


def test_an_export_of_another_kind_is_refused(tmp_path, monkeypatch, capfd):
    assert run(monkeypatch, "export", "spice", "--out", f"{tmp_path}/gap.cir") == 2
    assert "there is no export 'spice': choose fmu" in capfd.readouterr().err


@pytest.mark.slow
def test_an_fmu_is_written_and_its_step_said(tmp_path, monkeypatch, capfd):
    pytest.importorskip("pythonfmu3")
    assert run(monkeypatch, "export", "fmu", "--height", "10", "--out", f"{tmp_path}/gap.fmu") == 0
    assert "its step is 0.0255 s" in capfd.readouterr().out.replace("\n", " ")
    assert (tmp_path / "gap.fmu").is_file()
