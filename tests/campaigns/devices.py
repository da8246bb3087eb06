"""What a machine's devices read: programs of QCL, tapes, lines of terminals, calls of the object interface."""

import math
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edmsim import Machine
from edmsim.consoles.computer_1982.monitor import read_tape
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import Session
from edmsim.consoles.devices import Interrupts
from edmsim.controllers.axis import make
from edmsim.controllers.axis.elcam.module import CamPlace, Descriptor, Elcam
from edmsim.controllers.qcl import Control, read_configuration, read_program

ROOT = Path(__file__).parents[2]
Read = Callable[[bytes, Path], object]
TERMINAL_S = 2.0
"""Of the machine that an operator has (ours): 80 windows of a cut, far less than a second of the processor."""


def qcl(data: bytes, _folder: Path) -> object:
    text = data.decode("latin-1")
    configuration = read_configuration((ROOT / "examples/positioner/table.cnf").read_text(encoding="latin-1"))
    if "INTDEVICE" in text:
        return read_configuration(text)
    control = Control(configuration, read_program(text, configuration), {n: _Device() for n in configuration.devices})
    for _ in range(3):
        control.run_pass()
    return control.variables


class _Device:
    """A device that takes all and does nothing."""

    def __init__(self) -> None:
        self.parameters, self.states, self.pending = _Any(), _Any(), False

    def command(self, name: str) -> None:
        pass


class _Any(dict[str, int]):
    def __missing__(self, name: str) -> int:
        return 1


def tape(data: bytes, _folder: Path) -> object:
    return read_tape(data)


def drive(name: str) -> Read:
    made: list[Any] = []

    def read(data: bytes, _folder: Path) -> object:
        if not made or random.Random(data).random() < 0.001:
            made[:] = [make(name)]
        return made[0].line(data[:200])  # 0.2 s of a serial line

    return read


def terminal(data: bytes, folder: Path) -> object:
    """Let an operator type it, in the monitor if it begins so; the machine has `TERMINAL_S`."""

    class LosesPatience(Interrupts):
        """Ctrl-C after some time of the machine: a cut, a jog and WAIT take as long as they are said to."""

        def take(self) -> bool:
            return super().take() or rig.time_ns > TERMINAL_S * 1e9

    rig = Rig(Machine.load(height_mm=5.0), seed=1, resolution="fast")
    typed = data[:400]
    session = Session(rig, _Typing(typed), LosesPatience(), monitor=typed[:1] == b"G", tapes=folder)
    return session.run()


class _Typing:
    def __init__(self, typed: bytes) -> None:
        self._typed, self.at_end = typed, False

    def read(self, timeout_s: float | None) -> bytes:
        data, self._typed = self._typed, b""
        self.at_end = not data
        return data

    def write(self, data: bytes) -> None:
        pass

    def refresh(self, operation: object) -> None:
        pass


CALL = struct.Struct("<BBhhd")
"""A call of the object interface: which, bus and device, index, sub-index, value."""


def elcam(data: bytes, _folder: Path) -> object:
    """Call the object interface: every record of `CALL` is a call."""
    places = [CamPlace(), CamPlace(1.0, 1.5), CamPlace(2.0, 2.0, 2.5)]
    elcam = Elcam(places, buffer_bytes=4096)
    for which, where, index, sub, value in CALL.iter_unpack(data[: len(data) // CALL.size * CALL.size]):
        what = Descriptor(1200 if where & 1 else where, where >> 1 & 1, index, sub)
        kind = which % 7
        if kind == 0:
            elcam.write_int(what, int(value) if math.isfinite(value) else 0)
        elif kind == 1:
            elcam.write_double(what, value)
        elif kind == 2:
            elcam.read_int(what)
        elif kind == 3:
            elcam.read_double(what)
        elif kind == 4:
            elcam.load(index, data[: max(sub, 0) % 256], single=bool(where & 4))
        elif kind == 5:
            elcam.follow()
            elcam.compensation(index)
        else:
            places[which % 3].setpoint = value if abs(value) < 1e9 else 0.0  # an axis is somewhere
    return elcam.follow()


def good_calls() -> list[bytes]:
    def table(axis: int, master: int, mode: int) -> bytes:
        sets = [(0, 4, axis), (0, 5, master), (0, 3, 4)]
        points = [(1, 11 + k % 2, float(k // 2)) for k in range(8)]
        calls = [(kind, 3, 1, sub, float(value)) for kind, sub, value in (*sets, *points, (0, 10, mode))]
        looks = (5, 3, 0, 0, 0.0), (3, 3, 1, 19, 0.0), (6, 0, 0, 0, 1.5)
        return b"".join(CALL.pack(*call) for call in (*calls, *looks))

    return [table(1, 0, 1), table(2, 0, 3), table(1, 0, 33), table(0, 1, 1) + table(1, 0, 17)]
