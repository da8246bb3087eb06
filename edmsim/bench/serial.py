"""Figures of ``edmsim bench --serial``: response times and real-time factors of ``edmsim gap --serial``."""

import os
import re
import select
import subprocess
import sys
import time
import tty
from collections.abc import Callable

import numpy as np

from edmsim.errors import EdmsimError
from edmsim.hil.boards import BOARDS, Rig

ROUND_TRIPS, PAUSE_S = 1000, 0.003
"""Queries, and the pause between two (ours: not a multiple of a frame, so that they come at any time in it)."""
MACHINE_S, SETTLE_S = 20.0, 1.0
FEED_UM_S = 4.0
_WAIT_S = 10.0


def measure(watch: Callable[[str], None]) -> dict[str, float]:
    """Return every board's machine time over processor time, and round trips at a serial port and the axes' port."""
    found: dict[str, float] = {}
    for name in BOARDS:
        watch(f"{name}: {MACHINE_S:g} s of machine time")
        found[f"{name}_realtime_factor"] = _speed(name)
    for name, port, line in (
        ("spark", "the board's serial port", b"r 1\n"), ("powercore", "the axes' port", b"?\n")
    ):  # fmt: skip
        watch(f"{name}: {ROUND_TRIPS} questions")
        times_ms = 1e3 * _round_trips(name, port, line)
        for title, share in (("median", 0.5), ("p99", 0.99), ("greatest", 1.0)):
            found[f"{name}_round_trip_{title}_ms"] = float(np.quantile(times_ms, share))
    return found


def _speed(name: str) -> float:
    rig = Rig(name, seed=1)
    rig.send("w 1 1")  # because a pulser is off at first
    rig.move(f"VEL {FEED_UM_S} 0")
    rig.run(SETTLE_S)
    began_s, from_s = rig.time_s, time.process_time()
    while rig.time_s < began_s + MACHINE_S:
        rig.move(f"VEL {FEED_UM_S} 0")
        rig.run(0.1)
        rig.board.unsolicited()
    return (rig.time_s - began_s) / (time.process_time() - from_s)


def _round_trips(name: str, port: str, line: bytes) -> np.ndarray:
    command = [sys.executable, "-m", "edmsim", "gap", "--serial", name]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as bench:
        try:
            assert bench.stderr is not None
            said = [bench.stderr.readline() for _ in range(2)]
            place = next((match[1] for one in said if (match := re.search(rf"{port} is (/dev/[^\s;]+)", one))), None)
            if place is None:
                raise EdmsimError(f"the bench did not begin: {said[0].strip()}")
            return _query(place, line)
        finally:
            bench.terminate()


def _query(place: str, line: bytes) -> np.ndarray:
    end = os.open(place, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(end)
        time.sleep(0.5)
        times = np.empty(ROUND_TRIPS)
        for k in range(ROUND_TRIPS):
            began, heard = time.perf_counter(), b""
            os.write(end, line)
            while not heard.endswith(b"\n"):
                if not select.select([end], [], [], _WAIT_S)[0]:
                    raise EdmsimError(f"no answer within {_WAIT_S:g} s")
                heard += os.read(end, 4096)
            times[k] = time.perf_counter() - began
            time.sleep(PAUSE_S)
        return times
    finally:
        os.close(end)
