"""The front panel on the 8279: what its keys do and its digits show; the document left both open.

Bank A shows x, y and the cutting speed in force; bank B the number being entered, and the percentages of short and
open pulses. A number is entered digit by digit and then given its meaning by a key (ours).
"""

from __future__ import annotations

from collections.abc import Callable

from edmsim.controllers.mcu.chips.display import BANK, BLANK, SHIFT, write_digit
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.pulse_counters import WINDOW_PULSES
from edmsim.errors import InputError

KEYS = {
    name: 10 + k
    for k, name in enumerate(("CLEAR", "X", "Y", "T(I)", "T(P)", "SPEED", "GO", "START", "STOP", "INIT"))
}
"""Keys by name; 0..9 are the digits. SHIFT with X or Y sets the position counter, without it the new position."""
FIELDS = {
    "x": (0, 5), "y": (6, 5), "speed": (12, 4), "entry": (BANK, 5), "short": (BANK + 6, 3), "open": (BANK + 10, 3),
}  # fmt: skip
"""First digit and number of digits."""


class FrontPanel:
    """Keys and digits of one computer.

    Parameters
    ----------
    computer : Computer

    Attributes
    ----------
    refused : str or None
        Why the last key did nothing.
    """

    def __init__(self, computer: Computer) -> None:
        self._computer = computer
        self.refused: str | None = None
        self._new = list(computer.position)
        self._shown: dict[int, int] = {}
        commands: dict[str, Callable[[int], None]] = {
            "CLEAR": lambda n: None,
            "X": lambda n: self._set_new(0, n),
            "Y": lambda n: self._set_new(1, n),
            "T(I)": lambda n: computer.set_pulse_codes(n, computer.pulse_codes[1]),
            "T(P)": lambda n: computer.set_pulse_codes(computer.pulse_codes[0], n),
            "SPEED": computer.set_speed,
            "GO": lambda n: computer.move_to(*self._new),
            "START": lambda n: computer.start(),
            "STOP": lambda n: computer.stop(),
            "INIT": lambda n: computer.init(),
        }
        self._commands = {KEYS[name]: do for name, do in commands.items()}
        self._commands[KEYS["X"] | SHIFT] = lambda n: computer.set_position(n, computer.position[1])
        self._commands[KEYS["Y"] | SHIFT] = lambda n: computer.set_position(computer.position[0], n)

    def serve(self) -> None:
        """Obey the keys pressed since the last call, and show what there is to show."""
        for key in self._computer.take_keys():
            self.refused = None
            try:
                self._press(key)
            except InputError as error:
                self.refused = error.reason
        self.show()

    def _press(self, key: int) -> None:
        entry = self._computer.word(at.ENTRY)
        if key < 10:
            if entry * 10 + key > WORD:
                raise InputError(f"the number is past {WORD}")
            self._computer.store(at.ENTRY, entry * 10 + key)
            return
        self._computer.store(at.ENTRY, 0)
        if key not in self._commands:
            raise InputError(f"key {key & 0x3F} has no meaning here")
        self._commands[key](entry)

    def _set_new(self, axis: int, value: int) -> None:
        self._new[axis] = value

    def show(self) -> None:
        """Write the digits that have changed, each without touching its neighbour in the other bank."""
        computer = self._computer
        x, y = computer.position
        values = {
            "x": x, "y": y, "speed": abs(computer.signed(at.CUTVEL)), "entry": computer.word(at.ENTRY),
            "short": 100 * computer.word(at.SHORTS) // WINDOW_PULSES,
            "open": 100 * computer.word(at.OPENS) // WINDOW_PULSES,
        }  # fmt: skip
        for name, (first, count) in FIELDS.items():
            rest = values[name]
            for digit in range(first + count - 1, first - 1, -1):
                blank = rest == 0 and digit < first + count - 1
                value = BLANK if blank else rest % 10
                rest //= 10
                if self._shown.get(digit) != value:
                    self._shown[digit] = value
                    write_digit(computer.board.display, digit, value)
