"""The servo processor module's serial dialogue: a typed line in, the module's answer out.

The answer to ``P1250`` is ``(P) - Kp: 1250 (1000)``: name, value, and, if an antidither scale is set, the gain
in the antidither region. The module does not echo or prompt. Answers end with CR LF; the answer to an unknown
command is ``?`` (rows M-2, M-4, M-11..M-18, M-A11..M-A14).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import data_of
from edmsim.controllers.axis.eeprom import WORD, encode
from edmsim.controllers.axis.serial_line import Command, command_in
from edmsim.controllers.axis.servo_module import registers as at
from edmsim.controllers.axis.servo_module.law import SCALE_ONE, restart, stop, wrapped
from edmsim.controllers.axis.servo_module.recorder import FIRST_SOURCE, N_SOURCES, TRIGGER, UNUSED

DATA: dict[str, Any] = data_of("servo_module")
LETTERS = {entry["letter"]: register for register, entry in zip(at.PARAMETERS, DATA["parameter"], strict=True)}
_SCALED = at.PROPORTIONAL, at.INTEGRAL, at.DERIVATIVE  # the gains that the antidither scale acts on (guide 4.9)
UNKNOWN = "?"
_HIGHEST, _LOWEST = WORD - 1, -WORD // 2


def answer(reg: NDArray[np.int64], text: str) -> list[str]:
    """Do what a line (upper case, without blanks) says to the module's registers; returns the lines it answers."""
    if not text:
        return []
    if reg[at.DUMPING] != 0:  # the answer meets one that is being sent (ours: the guide does not say when)
        reg[at.STATUS] |= at.TRANSMIT_BIT
    if text in _PLAIN:
        return _PLAIN[text](reg)
    if text in _READ:
        return [_READ[text](reg)]
    command = command_in(text)
    if command is None:
        return [UNKNOWN]
    if command.letter in "+-":
        return _move(reg, command)
    if command.letter == "Z":
        return _record(reg, command.number)
    if command.letter in LETTERS:
        return _set(reg, LETTERS[command.letter], command.number)
    return [UNKNOWN]


def words_of(reg: NDArray[np.int64]) -> list[int]:
    """Return the parameters as the EEPROM keeps them."""
    return [int(value) % WORD for value in reg[list(at.PARAMETERS)]]


def parameter_line(reg: NDArray[np.int64], register: int) -> str:
    """Return the line by which the module confirms and shows a parameter."""
    value, letter = int(reg[register]), DATA["parameter"][register]["letter"]
    shown = f"({letter}) - {DATA['parameter'][register]['label']}: {value}"
    if register in _SCALED and reg[at.SCALE] != SCALE_ONE:
        shown += f" ({value * int(reg[at.SCALE]) // SCALE_ONE})"
    return shown


def _set(reg: NDArray[np.int64], register: int, number: int | None) -> list[str]:
    if number is not None:
        if not (_LOWEST if register == at.OFFSET else 0) <= number <= _HIGHEST:  # row M-46: no other is signed
            return [UNKNOWN]
        reg[register] = wrapped(number, 16) if register == at.OFFSET else number
    return [parameter_line(reg, register)]


def _menu(reg: NDArray[np.int64]) -> list[str]:
    return [*(parameter_line(reg, register) for register in at.PARAMETERS), f"Peak Error: {reg[at.PEAK]}"]


def _move(reg: NDArray[np.int64], command: Command) -> list[str]:
    """Step the setpoint (guide 4.22); a stopped module takes the number and does not move (row M-A21)."""
    if command.number is None or not 0 <= command.number <= (_HIGHEST if command.letter == "+" else -_LOWEST):
        return [UNKNOWN]
    way = 1 if command.letter == "+" else -1
    reg[at.SETPOINT] = wrapped(reg[at.SETPOINT] + way * command.number, 32)
    reg[at.MOVED_NS] = reg[at.NOW_NS]
    limit = reg[at.ERROR_LIMIT]
    if reg[at.STATUS] & at.FAULT_BIT == 0 and limit <= at.NO_ERROR_LIMIT and command.number > limit:
        stop(reg, at.FOLLOWING_BIT)
    return [f"Move {command.letter}{command.number}"]


def _record(reg: NDArray[np.int64], code: int | None) -> list[str]:
    """Start or abort the recorder; Z0 starts, Z alone aborts (row M-A7)."""
    if code is None:
        reg[at.STATUS] &= ~(at.RECORDER_BIT | at.TRIGGERED_BIT)
        reg[at.DUMPING] = 0
        return ["Recorder OFF"]
    if not 0 <= code < N_SOURCES << FIRST_SOURCE or code & TRIGGER == UNUSED:
        return [UNKNOWN]
    reg[at.CODE] = code
    reg[at.STATUS] = (reg[at.STATUS] & ~at.TRIGGERED_BIT) | at.RECORDER_BIT
    return ["Recorder ON"]


def _save(reg: NDArray[np.int64]) -> list[str]:
    if reg[at.NOW_NS] - reg[at.MOVED_NS] < reg[at.REST_NS]:
        return ["Motor moving, not saved"]
    reg.view(np.uint8)[8 * at.IMAGE :][: at.N_IMAGE] = list(encode(words_of(reg)))
    reg[at.SAVED_FROM_NS], reg[at.SAVING] = reg[at.NOW_NS], 1
    return ["Parameters saved"]


def _quit(reg: NDArray[np.int64]) -> list[str]:
    stop(reg, 0)
    return ["Servo is OFF"]


def _reset(reg: NDArray[np.int64]) -> list[str]:
    restart(reg)
    return ["Servo RESET!"]


def _words(name: str, value: int) -> str:
    """Show a 32-bit register as two words, the way the guide prints it (row M-12)."""
    return f"{name}: {(value >> 16) % WORD}, {value % WORD}"


_PLAIN = {"?": _menu, "Q": _quit, "R": _reset, "S": _save}
_READ = {
    "GV": lambda reg: f"Velocity: {reg[at.VELOCITY]}",
    "GP": lambda reg: _words("Pos", int(reg[at.POSITION])),
    "GT": lambda reg: _words("Setpoint", int(reg[at.SETPOINT])),
    "GE": lambda reg: f"Error: {reg[at.ERROR]}",
    "GF": lambda reg: f"Scaled limit: {reg[at.LIMIT]}",
    "GO": lambda reg: f"PID Output: {reg[at.OUTPUT]}",
    "GD": lambda reg: f"PWM Dutycyle: {reg[at.DUTY]}",
    "GS": lambda reg: f"Status: {reg[at.STATUS]:016b}",
}
