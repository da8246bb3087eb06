r"""The UHU's serial dialogue, to the character (rows U-7 to U-13, U-A13 to U-A18).

A line is a letter and a whole number. A letter alone prints its line of the help and waits for the number::

    >P600           >P
    OK              (P)rop.      900: 600
    >               OK

The help lists a counter, but C is the cycle: ``COUNTER``, typed in full, prints the encoder's count (ours).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from edmsim.controllers.axis.serial_line import NEW_LINE, LineEditor, command_in, number_in

PROMPT = b">"
_LOAD, _SAVE, _GO = "L", "S", "G"
_COMMAND_LINES = {_LOAD: "(L)oad       [0,1,2]", _SAVE: "(S)ave       [0,1,2]", _GO: "(G)o         [Wert]"}
"""Lines of the help behind those of the parameters; [Wert] is German for value, as printed (row U-10)."""
_COUNTER = "COUNTER"
_LAST_LINES = ("(C)ounter", "(R)eset")
"""The first is a remainder of an older version, whose letter is the cycle's now (row U-A9)."""
_OK, _UNKNOWN, _BAD_BANK = "OK", "?", "EEPROM: Error!"
_LARGEST_GO = 32_000
_BANKS = range(3)
_WORDS = range(1 << 16)


class UhuActions(Protocol):
    """The dialogue's drive."""

    @property
    def position(self) -> int:
        """Position in counts from that at power-up."""

    def value(self, letter: str) -> int:
        """Return a parameter."""

    def enter(self, letter: str, value: int) -> None:
        """Set a parameter to a word."""

    def load(self, bank: int) -> bool:
        """Load a bank; return whether it could be read. If not, the output is off."""

    def save(self, bank: int) -> None:
        """Store the parameters in a bank."""

    def go(self, counts: int) -> None:
        """Move the setpoint."""

    def soft_reset(self) -> None:
        """Switch the output on with the parameters there are."""

    def hard_reset(self) -> bytes:
        """Start again as at power-up; return the start-up text."""

    def stream(self, on: bool) -> None:
        """Start or end the stream of tracking errors."""


class Dialogue:
    """The terminal of one drive; `labels` precede the parameters' values, in the order of the help."""

    def __init__(self, labels: dict[str, str], serial_number: int) -> None:
        self._labels = labels
        self._serial_number = serial_number
        self._editor = LineEditor(echo=True)
        self._pending = ""

    def start(self, bank_is_good: bool) -> bytes:
        """Return the start-up text, and forget what was typed."""
        self._editor.clear()
        self._pending = ""
        state = "OK" if bank_is_good else "Error!"
        lines = f"UHU Servo Controller 3.00 (c) Snr: {self._serial_number}", f"EEPROM: {state}", "Help by (?)"
        return _text(*lines) + PROMPT

    def take(self, chip: UhuActions, byte: int) -> bytes:
        """Take a byte from the terminal, act on it if it ends a line, and return what is sent back."""
        echo, line = self._editor.take(byte)
        return echo if line is None else echo + self._answer(chip, line)

    def receive_error(self) -> None:
        """Let the line that is being typed count for nothing: a byte of it was not received well."""
        self._editor.spoil()

    def _answer(self, chip: UhuActions, line: str) -> bytes:
        pending, self._pending = self._pending, ""
        if not line:
            return PROMPT
        if pending:
            return self._set(chip, pending, number_in(line))
        if line == _COUNTER:
            return _reply(f"{_LAST_LINES[0]:13}{chip.position}")
        command = command_in(line)
        if command is None:
            return _reply(_UNKNOWN)
        letter, number = command
        if letter in self._labels or letter in _COMMAND_LINES:
            return self._ask(chip, letter) if number is None else self._set(chip, letter, number)
        return self._act(chip, letter) if number is None else _reply(_UNKNOWN)

    def _ask(self, chip: UhuActions, letter: str) -> bytes:
        self._pending = letter
        return f"{self._line(chip, letter)}: ".encode("ascii")

    def _line(self, chip: UhuActions, letter: str) -> str:
        return _COMMAND_LINES.get(letter) or f"{self._labels[letter]}{chip.value(letter)}"

    def _set(self, chip: UhuActions, letter: str, number: int | None) -> bytes:
        if letter == _GO:
            known = number is not None and abs(number) <= _LARGEST_GO
        else:
            known = number in (_BANKS if letter in _COMMAND_LINES else _WORDS)
        if number is None or not known:
            return _reply(_UNKNOWN)
        if letter == _LOAD:
            return _reply(_OK if chip.load(number) else _BAD_BANK)
        if letter == _SAVE:
            chip.save(number)
        elif letter == _GO:
            chip.go(number)
        else:
            chip.enter(letter, number)
        return _reply(_OK)

    def _act(self, chip: UhuActions, letter: str) -> bytes:
        if letter == "+":
            return chip.hard_reset()
        if letter == "A":
            chip.stream(True)
            return PROMPT
        if letter in "#?":
            parameters = [self._line(chip, shown) for shown in self._labels]
            return _text(*parameters, *_COMMAND_LINES.values(), *_LAST_LINES) + PROMPT
        actions: dict[str, Callable[[], None]] = {"R": chip.soft_reset, "Z": lambda: chip.stream(False)}
        if letter not in actions:
            return _reply(_UNKNOWN)
        actions[letter]()
        return _reply(_OK)


def _text(*lines: str) -> bytes:
    return b"".join(line.encode("ascii") + NEW_LINE for line in lines)


def _reply(line: str) -> bytes:
    return _text(line) + PROMPT
