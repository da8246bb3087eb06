"""``edmsim bench --serial``."""

import pytest

from edmsim.bench import serial


@pytest.mark.slow
def test_round_trips_and_speeds_of_every_board(monkeypatch):
    monkeypatch.setattr(serial, "ROUND_TRIPS", 20)
    monkeypatch.setattr(serial, "MACHINE_S", 0.2)
    found = serial.measure(lambda name: None)
    assert {name for name in found if name.endswith("_realtime_factor")} == {
        f"{name}_realtime_factor" for name in ("powercore", "powercore-v2", "spark")
    }  # fmt: skip
    for board in ("spark", "powercore"):
        median, high, greatest = (found[f"{board}_round_trip_{title}_ms"] for title in ("median", "p99", "greatest"))
        assert 0 < median <= high <= greatest
