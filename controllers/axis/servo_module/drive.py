"""The servo processor module, revision A, of 2010: a replacement for the UHU servo chip with faster inputs.

Its loop is `edmsim.controllers.axis.servo_module.law`, its serial dialogue `dialogue`, its recorder
`recorder`. Its parameters, and settings not in its guide, are in ``models/drives/servo_module.toml``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import FAULT, FAULT_IN, FAULT_OUT, FREEWHEEL, LED, SampleFunction, carray, sample
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.drive import Screw, axis_row, new_record, restart, set_period
from edmsim.controllers.axis.eeprom import WORD, decode, encode
from edmsim.controllers.axis.extensions import SETTINGS, Extensions, record_sample
from edmsim.controllers.axis.parameters import Registers, law_with, tuned_values
from edmsim.controllers.axis.serial_line import NEW_LINE, LineEditor
from edmsim.controllers.axis.servo_module import registers as at
from edmsim.controllers.axis.servo_module.dialogue import DATA, answer, words_of
from edmsim.controllers.axis.servo_module.law import Words, cycle, put_duty, take_steps, wrapped
from edmsim.controllers.axis.servo_module.recorder import dump, note

LARGEST_OFFSET = -WORD // 2, WORD // 2 - 1  # the offset is the only signed parameter (row M-46)
_BITS_OF_A_BYTE = 10  # start bit, eight, stop bit
_CHIP = DATA["chip"]


@exactly_compiled
def _lamp(reg: Words) -> int:
    """Return whether the status LED is lit: flashes name the reason of a stop, a running loop blinks evenly."""
    status, now_ns, flash_ns = reg[at.STATUS], reg[at.NOW_NS], reg[at.LED_FLASH_NS]
    if status & at.FAULT_BIT != 0:
        flashes = 3 if status & at.EXTERNAL_BIT != 0 else 2 if status & at.FOLLOWING_BIT != 0 else 1
        since_ns = now_ns % reg[at.LED_REPEAT_NS]
        lit = since_ns < 2 * flashes * flash_ns and since_ns % (2 * flash_ns) < flash_ns
    else:
        period_ns = reg[at.LED_RECORDER_NS] if status & at.RECORDER_BIT != 0 else reg[at.LED_RUN_NS]
        lit = 2 * (now_ns % period_ns) < period_ns
    return LED if lit else 0


@exactly_compiled
def _lines(reg: Words) -> int:
    """Return the output lines; only the module's own fault pulls the fault output (row M-A15)."""
    status = reg[at.STATUS]
    lines = _lamp(reg)
    if status & at.FAULT_BIT != 0:
        lines |= FREEWHEEL
    if status & at.FOLLOWING_BIT != 0:
        lines |= FAULT_OUT
    if status & (at.FOLLOWING_BIT | at.EXTERNAL_BIT) != 0:
        lines |= FAULT
    return lines


@exactly_compiled
def _write(reg: Words, eeprom: NDArray[np.uint8], now_ns: int) -> None:
    """Write what a save's time has been enough for: power that fails meanwhile leaves the rest as it was."""
    if reg[at.SAVING] != 0:
        for k in range(min(at.N_IMAGE * (now_ns - reg[at.SAVED_FROM_NS]) // reg[at.SAVE_NS], at.N_IMAGE)):
            eeprom[k] = reg[at.IMAGE + k // 8] >> 8 * (k % 8) & 255


@sample
def _servo_module(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    reg = drive.reg
    _write(reg, drive.eeprom, drive.now_ns)
    ran, turned = cycle(reg, axis.count, drive.setpoint, axis.lines & FAULT_IN != 0, drive.now_ns)
    if ran:
        note(reg, drive.memory, turned)
    faulty = reg[at.STATUS] & at.FAULT_BIT != 0
    record_sample(reg, drive.memory, reg[at.ERROR], reg[at.VELOCITY], reg[at.OUTPUT], faulty)
    dump(drive)
    drive.command = (reg[at.DUTY] - reg[at.DUTY_CENTRE]) / reg[at.DUTY_CENTRE]
    drive.lines = _lines(reg)


class ServoModule:
    r"""The servo processor module on an axis.

    Parameters
    ----------
    motor : record array (1,), optional
        Motor, supply and encoder (`edmsim.controllers.axis.drive.axis_row`); by default those of the machine's table.
    stored : mapping of str to int, optional
        Parameters in the EEPROM that override the defaults, by name, for example ``{"proportional_gain": 900}``.
    law : mapping of str to int, optional
        Overrides of the table ``law`` of ``models/drives/servo_module.toml``, which the guide leaves open, for
        example ``{"save_ns": 5_000_000}``.

    Attributes
    ----------
    parameters : mapping of str to int
        Parameters set by the terminal's letters, by name. A new loop rate or encoder filter acts from the next call
        of `line`; only ``S`` saves them to the EEPROM.
    extensions : Extensions
        Functions beyond its guide. ``saturating_arithmetic`` is 1 by default (row M-35). In compatible mode all are
        0, and 16 and 32 bits wrap as the guide warns in 4.4.

    Raises
    ------
    InputError
        `stored` or `law` has an unknown name, or `stored` a number out of range.

    Examples
    --------
    >>> ServoModule().line(b"P1250\r")
    b'(P) - Kp: 1250\r\n'
    """

    name = "servo-module"
    sample: SampleFunction = _servo_module
    baud: float = _CHIP["baud"]

    def __init__(
        self, motor: NDArray[np.void] | None = None, stored: Mapping[str, int] | None = None,
        law: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        self.motor: NDArray[np.void] | None = axis_row() if motor is None else motor
        self._law = law_with(DATA["law"], law or {}, "servo module")
        self.record: NDArray[np.void] = _fresh(self._law, None)
        names = [entry["name"] for entry in DATA["parameter"]]
        bounds = [LARGEST_OFFSET if register == at.OFFSET else (0, WORD - 1) for register in at.PARAMETERS]
        self.parameters = Registers(self, {name: (k, *bounds[k]) for k, name in enumerate(names)})
        self.extensions = Extensions(self, wraps=True)
        self.extensions["saturating_arithmetic"] = 1
        self._editor = LineEditor(echo=False)
        self.parameters.update(stored or {})
        self.record["eeprom"][0, : at.N_IMAGE] = list(encode(words_of(self.record["reg"][0])))
        self.power_up()

    @classmethod
    def tuned(
        cls, axis: str = "table", changes: Mapping[str, float] = MappingProxyType({}), screw: Screw | None = None
    ) -> Self:
        """Return a module tuned for an axis: `changes` override the parameters of the table ``tuned``.

        With a machine's screw, a step is the machine's, rounded to a whole number of counts.

        Raises
        ------
        InputError
            No tuning exists for that axis, or a parameter is unknown.
        """
        values = tuned_values(DATA, "servo module", axis, changes, screw)
        return cls(axis_row(axis), values)

    @property
    def counts_per_step(self) -> float:
        """Encoder counts per step edge, X + 1."""
        reg = self.record["reg"][0]
        return float((reg[at.MULTIPLIER] + 1) * reg[at.STEP_SENSE] * reg[at.ENCODER_SENSE])

    def why_stopped(self) -> str:
        """Return why its loop is off, except by the fault input."""
        reg = self.record["reg"][0]
        if reg[at.STATUS] & at.FOLLOWING_BIT:
            return f"its following error passed the limit E of {reg[at.LIMIT]} counts"
        return "its loop is off" if reg[at.STATUS] & at.FAULT_BIT and not reg[at.STATUS] & at.EXTERNAL_BIT else ""

    def line(self, text: bytes) -> bytes:
        """Receive text over the serial line and return the answer."""
        reg = self.record["reg"][0]
        reg[at.NOW_NS] = self.record["now_ns"][0]
        take_steps(reg, int(self.record["setpoint"][0]))
        sent = []
        for byte in text:
            _, typed = self._editor.take(byte)
            if typed is not None:
                sent += answer(reg, typed)
        _obey(self.record)
        return b"".join(line.encode("ascii") + NEW_LINE for line in sent)

    def power_up(self) -> bytes:
        """Start with the EEPROM's parameters; if they are invalid, with the defaults and the motor off."""
        stored = decode(self.record["eeprom"][0, : at.N_IMAGE].tobytes())
        words = stored.words if stored.valid else None
        fresh = _fresh(self._law, words)
        old, reg = self.record["reg"][0], fresh["reg"][0]
        reg[SETTINGS] = old[SETTINGS]
        reg[at.FRESH], reg[at.EDGES], reg[at.NOW_NS] = 1, self.record["setpoint"][0], self.record["now_ns"][0]
        reg[at.MOVED_NS] = reg[at.NOW_NS] - reg[at.REST_NS]
        if words is None:
            reg[at.STATUS] = at.FAULT_BIT
            fresh["lines"] = FREEWHEEL
        restart(self.record, fresh)
        self._editor.clear()
        said = [_CHIP["message"]] if words is not None else [_CHIP["message"], _CHIP["bad_memory"]]
        return b"".join(line.encode("ascii") + NEW_LINE for line in said)

    def receive_error(self) -> None:
        """Set the receive error in the status; the current line becomes an unknown command."""
        self.record["reg"][0, at.STATUS] |= at.RECEIVE_BIT
        self._editor.take(0)


def _fresh(law: Mapping[str, int], words: Sequence[int] | None) -> NDArray[np.void]:
    """Return the record of a module that starts with some parameters, the defaults if there are none."""
    record = new_record((1, 1))
    reg = record["reg"][0]
    reg[list(at.PARAMETERS)] = [entry["value"] for entry in DATA["parameter"]] if words is None else words
    reg[at.OFFSET] = wrapped(reg[at.OFFSET], 16)
    reg[list(at.SETTINGS)] = list(law.values())
    reg[list(at.CHIP)] = _CHIP["duty_centre"], _CHIP["greatest_clamp"], round(_BITS_OF_A_BYTE * 1e9 / _CHIP["baud"])
    put_duty(reg, 0)
    record["delay_ns"], record["pwm_ns"] = _CHIP["calculation_ns"], _CHIP["duty_period_ns"]
    record["num"], record["den"] = _period(reg)
    record["count_rate_Hz"] = _count_rate(reg)
    return record


def _period(reg: Words) -> tuple[int, int]:
    """Return the time of a cycle in ns, as a fraction (guide 4.10)."""
    divider = min(int(reg[at.DIVIDER]), _CHIP["greatest_loop_divider"]) + _CHIP["loop_divider_offset"]
    return _CHIP["duty_period_ns"] * divider, 1


def _count_rate(reg: Words) -> float:
    """Return the fastest encoder edges that pass the filter (guide 4.19)."""
    rates: list[float] = _CHIP["filter_Hz"]
    return rates[min(int(reg[at.FILTER]), len(rates) - 1)]


def _obey(record: NDArray[np.void]) -> None:
    """Let a new loop rate and a new filter act."""
    reg = record["reg"][0]
    record["count_rate_Hz"] = _count_rate(reg)
    num, den = _period(reg)
    if num != record["num"][0]:
        set_period(record, num, den)
