"""A drive that does what a test puts into its registers, and a bench with one."""

from typing import Any

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FAULT_IN, FREEWHEEL, carray, put_byte, sample
from edmsim.controllers.axis.drive import axis_row, new_record

COMMAND, LINES, DELAY, BUSY, CALLS, STREAMS = range(6)


@sample
def _puppet(drive_at: Any, axis_at: Any) -> None:
    """Put out what the test has put into its registers; note what it sees."""
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    drive.command = drive.real[COMMAND]
    drive.lines = drive.reg[LINES]
    drive.delay_ns = drive.reg[DELAY]
    drive.busy_ns = drive.reg[BUSY]
    drive.reg[CALLS] += 1
    if axis.lines & FAULT_IN:
        drive.lines |= FREEWHEEL
    if drive.reg[CALLS] % 5 == 0 and drive.reg[STREAMS] != 0:
        put_byte(drive, 191)


class Puppet:
    """A drive that does what its registers say."""

    name = "puppet"
    sample = _puppet
    baud = 38400.0

    def __init__(self, motor=None) -> None:
        self.record = new_record((500_000, 1))
        self.motor = axis_row("bench") if motor is None else motor
        self.errors = 0

    def line(self, text: bytes) -> bytes:
        return text.upper()

    def power_up(self) -> bytes:
        self.record["reg"] = 0
        self.record["real"] = 0
        return b"on"

    def receive_error(self) -> None:
        self.errors += 1


def bench_of(**changes):
    return AxisBench({"x": Puppet(axis_row("bench", **changes))})


def command(bench, duty, axis="x", run_s=0.0):
    """Let the drive command a share of its supply, and run for some time."""
    bench.drive(axis).record["real"][0, COMMAND] = duty
    bench.run(run_s)


def put_out(bench, bits, axis="x", run_s=0.0):
    """Let the drive put out lines, and run for some time."""
    bench.drive(axis).record["reg"][0, LINES] = bits
    bench.run(run_s)
