"""The UHU Servo Controller 3.00: a position servo on an ATtiny2313, tuned over a serial line.

Source: the manual of 25.9.05 (rows U-1 to U-70). The recalculation is `edmsim.controllers.axis.uhu.law`, the serial
dialogue `edmsim.controllers.axis.uhu.dialogue`; all constants are in ``models/drives/uhu.toml``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import (
    ERROR_LED,
    FAULT,
    FAULT_IN,
    FAULT_OUT,
    FREEWHEEL,
    LED,
    WATCHDOG,
    SampleFunction,
    carray,
    put_byte,
    sample,
)
from edmsim.controllers.axis import eeprom
from edmsim.controllers.axis.drive import Screw, axis_row, data_of, new_record, restart, set_period
from edmsim.controllers.axis.extensions import SETTINGS, Extensions, note_limit, record_sample, start_command
from edmsim.controllers.axis.parameters import Registers, law_with, tuned_values
from edmsim.controllers.axis.uhu import law as loop
from edmsim.controllers.axis.uhu import registers as at
from edmsim.controllers.axis.uhu.dialogue import Dialogue

_DUTY_RANGE = 0  # place in ``real``: the share of the supply that is the full swing of duty, in locked antiphase
_N_BANKS, _LARGEST = 3, 65535
_NOT_STORED = "overruns"


@sample
def _recalculate(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    reg = drive.reg
    output = 0
    if drive.event == WATCHDOG:
        reg[at.LATCHED] |= at.WATCHDOG
        drive.delay_ns = 0
    else:
        interrupts = axis.edges - reg[at.LAST_INTERRUPTS] + abs(drive.setpoint - reg[at.LAST_EDGES])
        reg[at.LAST_INTERRUPTS] = axis.edges
        drive.delay_ns = reg[at.CALCULATION_NS]
        drive.busy_ns = reg[at.CALCULATION_NS] + interrupts * reg[at.INTERRUPT_NS]
        low = axis.lines & FAULT_IN != 0
        if reg[at.RESTART] != 0:
            low = False  # its own error output, let go only now, may hold the net low
            loop.restart(reg, drive.setpoint, axis.count, axis.illegal)
            start_command(reg, reg[at.TARGET])
        loop.take_steps(reg, drive.setpoint)
        loop.measure(reg, axis.count)
        loop.judge(reg, axis.illegal, low)
        if reg[at.LATCHED] == 0:
            output = loop.control(reg, drive.now_ns)
        else:
            note_limit(reg, drive.now_ns, 0)
        error = reg[at.TARGET] - reg[at.POSITION]
        record_sample(reg, drive.memory, error, reg[at.SPEED], output, reg[at.LATCHED] != 0)
        sent = loop.stream_byte(reg)
        if sent != 0:
            put_byte(drive, sent)
    drive.command = drive.real[_DUTY_RANGE] * output / reg[at.CONTROL_FULL]
    if reg[at.LATCHED] == 0:
        drive.lines = LED
    else:
        own = FAULT_OUT if reg[at.LATCHED] & at.OWN_FAULTS else 0
        drive.lines = FAULT | FREEWHEEL | ERROR_LED | own


@cache
def _data() -> dict[str, Any]:
    return data_of("uhu")


def _period_ns(cycle: int) -> tuple[int, int]:
    """Return the recalculation interval as a fraction: C = 50 is 533 333.3 ns; 0 acts as 1 (rows U-4, U-A23)."""
    clock = _data()["clock"]
    num, den = max(cycle, 1) * clock["prescaler"] * 1_000_000_000, clock["crystal_Hz"]
    common = math.gcd(num, den)
    return num // common, den // common


def _fresh(law: Mapping[str, int]) -> NDArray[np.void]:
    """Return the record of a chip that was just reset, with the preset parameters, before its EEPROM was read."""
    data = _data()
    pins = data["pins"]
    values = [parameter["value"] for parameter in data["parameter"]]
    record = new_record(_period_ns(values[at.C]))
    reg = record["reg"][0]
    reg[: len(values)] = values
    reg[list(at.SETTINGS)] = list(law.values())[: len(at.SETTINGS)]
    reg[at.RESTART] = at.HARD
    record["real"][0, _DUTY_RANGE] = pins["duty_high"] - pins["duty_low"]
    record["lines"] = FREEWHEEL
    record["watchdog_ns"] = data["clock"]["watchdog_ms"] * 1_000_000
    record["pwm_ns"] = 1_000_000_000 // law["pwm_Hz"]
    record["count_rate_Hz"] = law["edge_rate_Hz"]
    return record


class Uhu:
    r"""A UHU servo controller.

    Parameters
    ----------
    motor : record array (1,), optional
        Motor, supply and encoder, a row of `edmsim.compiled.axis_rows.MOTOR`; by default those of the table.
    stored : mapping of str to int, optional
        Parameters in bank 0 at power-up, by name; the others have their presets. By default the drive is in its
        condition upon delivery: no bank is valid, and the output is off until a reset by ``R``.
    law : mapping of str to int, optional
        Overrides of the table ``law`` of ``models/drives/uhu.toml``, which the manual leaves open, for example
        ``{"encoder_sense": -1}``.

    Attributes
    ----------
    parameters : mapping of str to int
        Parameters set by the terminal's letters, by name; words 0 to 65535. A ``cycle`` typed at the terminal acts
        from the next interval, one set here from the next reset.
    extensions : Extensions
        Functions beyond its manual, see `edmsim.controllers.axis.extensions`.

    Raises
    ------
    InputError
        `stored` or `law` has an unknown name, or `stored` a number out of range.

    Examples
    --------
    >>> drive = Uhu()
    >>> drive.line(b"R\r")
    b'R\r\nOK\r\n>'
    """

    name = "uhu"

    def __init__(
        self,
        motor: NDArray[np.void] | None = None,
        stored: Mapping[str, int] | None = None,
        law: Mapping[str, int] | None = None,
    ) -> None:
        data = _data()
        self._law = law_with(data["law"], law or {}, "UHU")
        self.record = _fresh(self._law)
        self.motor: NDArray[np.void] | None = axis_row() if motor is None else motor
        self.baud = data["clock"]["crystal_Hz"] / 16 / data["serial"]["baud_divisor"]
        table = data["parameter"]
        self._letters = {row["letter"]: row["name"] for row in table}
        self.parameters = Registers(self, {row["name"]: (place, 0, _LARGEST) for place, row in enumerate(table)})
        self.extensions = Extensions(self, wraps=False)
        self._stored = [row["name"] for row in table if row["name"] != _NOT_STORED]
        self._dialogue = Dialogue({row["letter"]: row["label"] for row in table}, data["identity"]["serial_number"])
        for bank in range(_N_BANKS):
            self.save(bank, false_checksum=True)
        if stored is not None:
            self.parameters.update(stored)
            self.save(0)
        self.power_up()

    @classmethod
    def tuned(
        cls, axis: str = "table", changes: Mapping[str, float] = MappingProxyType({}), screw: Screw | None = None
    ) -> Self:
        """Return a drive tuned for an axis of `axis_row`; bank 0 has its parameters, with overrides by `changes`.

        With a machine's screw, a step is the machine's, rounded to a whole number of counts.

        Raises
        ------
        InputError
            No tuning exists for that axis, or a parameter is unknown.
        """
        values = tuned_values(_data(), "UHU", axis, changes, screw)
        return cls(axis_row(axis), values)

    @property
    def sample(self) -> SampleFunction:
        """The recalculation, the same for every UHU."""
        return _recalculate

    @property
    def counts_per_step(self) -> float:
        """Encoder counts per step edge, M + 1."""
        return float((self._reg[at.M] + 1) * self._reg[at.STEP_SENSE] * self._reg[at.ENCODER_SENSE])

    def why_stopped(self) -> str:
        """Return why its output is off (row U-50)."""
        watchdog_ms = _data()["clock"]["watchdog_ms"]
        causes = {
            at.TRACKING: f"its following error reached the limit E of {self._reg[at.E]} counts",
            at.WATCHDOG: f"its watchdog saw no recalculation for {watchdog_ms} ms",
            at.BAD_BANK: "its parameters could not be read",
        }
        return ", ".join(text for bit, text in causes.items() if self._reg[at.LATCHED] & bit)

    def line(self, text: bytes) -> bytes:
        """Receive typed text; return its echo and the answers."""
        return b"".join(self._dialogue.take(self, byte) for byte in text)

    def receive_error(self) -> None:
        """Discard the current line, as a byte came without a stop bit."""
        self._dialogue.receive_error()

    def power_up(self) -> bytes:
        """Start as after power-up, a low reset pin or ``+``: load bank 0 and return the start-up text (row U-39)."""
        fresh = _fresh(self._law)
        fresh["reg"][0, SETTINGS] = self._reg[SETTINGS]
        restart(self.record, fresh)
        stored = self._read(0)
        if stored.words is not None:
            self._use(stored.words)
        set_period(self.record, *_period_ns(self.parameters["cycle"]))
        self._reg[at.LATCHED] = 0 if stored.valid else at.BAD_BANK
        return self._dialogue.start(stored.valid)

    @property
    def position(self) -> int:
        """Position in counts from that at power-up; the terminal prints it as ``COUNTER``."""
        return int(self._reg[at.POSITION])

    def value(self, letter: str) -> int:
        """Return a letter's parameter."""
        return self.parameters[self._letters[letter]]

    def enter(self, letter: str, value: int) -> None:
        """Set a letter's parameter, at once."""
        loop.take_steps(self._reg, int(self.record["setpoint"][0]))
        self.parameters[self._letters[letter]] = value
        self._time_next()

    def load(self, bank: int) -> bool:
        """Load a bank; if it is invalid, leave the parameters and switch the output off (rows U-69, U-A21)."""
        stored = self._read(bank)
        if stored.words is None or not stored.valid:
            self._reg[at.LATCHED] |= at.BAD_BANK
            return False
        loop.take_steps(self._reg, int(self.record["setpoint"][0]))
        self._use(stored.words)
        self._time_next()
        return True

    def save(self, bank: int, *, false_checksum: bool = False) -> None:
        """Save the parameters to a bank without any check (row U-47)."""
        words = [self.parameters[name] for name in self._stored]
        self.record["eeprom"][0, self._place(bank)] = list(eeprom.encode(words, false_checksum=false_checksum))

    def go(self, counts: int) -> None:
        """Move the setpoint; X limits the speed (row U-30)."""
        self._reg[at.TARGET] += counts

    def soft_reset(self) -> None:
        """Switch the output on with the present parameters and the setpoint at the axis (rows U-31, U-A25).

        The timer of the recalculation restarts (log 2.16).
        """
        self._reg[at.LATCHED] = 0
        self._reg[at.RESTART] = max(int(self._reg[at.RESTART]), at.SOFT)
        self.stream(False)
        set_period(self.record, *_period_ns(self.parameters["cycle"]))

    def hard_reset(self) -> bytes:
        """Same as `power_up`."""
        return self.power_up()

    def stream(self, on: bool) -> None:
        """Start or stop the stream of tracking errors (row U-33)."""
        self._reg[at.STREAM_ON], self._reg[at.STREAM_WAIT] = int(on), 0

    @property
    def _reg(self) -> NDArray[np.int64]:
        registers: NDArray[np.int64] = self.record["reg"][0]
        return registers

    def _place(self, bank: int) -> slice:
        size = eeprom.size_of(len(self._stored))
        return slice(bank * size, (bank + 1) * size)

    def _read(self, bank: int) -> eeprom.Stored:
        return eeprom.decode(self.record["eeprom"][0, self._place(bank)].tobytes())

    def _use(self, words: tuple[int, ...]) -> None:
        self.parameters.update(zip(self._stored, words, strict=True))

    def _time_next(self) -> None:
        """Let C be the length of the intervals after the present one."""
        record = self.record
        record["num"], record["den"] = _period_ns(self.parameters["cycle"])
        record["epoch_ns"], record["index"] = record["due_ns"], 0

