"""A servo module on the bench, as its tests set it up."""

import re

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis import servo_module as at
from edmsim.controllers.axis.drive import axis_row

NO_TRIP = 40_000
"""An error limit above 32767."""


def on_bench(axis="table", changes=None, law=None, extensions=None, **stored):
    """A module on an axis, powered up, its parameters by field in the EEPROM, and its message read."""
    drive = ServoModule(axis_row(axis, **(changes or {})), stored, law=law or {})
    drive.extensions.update(extensions or {})
    bench = AxisBench({"x": drive})
    bench.run(0.02)
    bench.received("x")
    return bench


def say(bench, text, run_s=0.0):
    """What the module answers a line, without the last line end; the bench then runs for some time."""
    answer = bench.talk(text.encode("ascii") + b"\r", axis="x").decode("ascii")
    assert answer == "" or answer.endswith("\r\n")
    bench.run(run_s)
    return answer.removesuffix("\r\n")


def get(bench, letters):
    """The number that a G command shows."""
    return int(re.fullmatch(r"[\w ]+: (-?\d+)", say(bench, letters))[1])


def words(bench, letters):
    """The number that a G command shows as two words."""
    high, low = re.fullmatch(r"\w+: (\d+), (\d+)", say(bench, letters)).groups()
    value = (int(high) << 16) + int(low)
    return value - (1 << 32) if value >> 31 else value


def status(bench):
    """The bits that are set in the status."""
    bits = re.fullmatch(r"Status: ([01]{16})", say(bench, "GS"))[1]
    return {15 - place for place, bit in enumerate(bits) if bit == "1"}


def locked(bench, *moves):
    """Hold the rotor and step the setpoint, so that the error is what was asked for."""
    bench.hold("x", True)
    for move in moves:
        say(bench, f"{move:+d}")
    return bench


def preset(bench, position):
    """Set the position and the setpoint, as if the axis had come from far."""
    reg = bench.drive("x").record["reg"][0]
    here = int(reg[at.POSITION])
    reg[at.ORIGIN] += here - position
    for register in (at.SETPOINT, at.LAST_SETPOINT, at.POSITION, at.LAST_POSITION):
        reg[register] = position
