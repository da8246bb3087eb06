"""The front panel on the 8279: its keys and digits, which the document leaves open.

Bank A shows x, y and the present cutting speed; bank B shows the number being entered and the percentages of short
and open pulses. Enter a number digit by digit, then press a key for its meaning (ours). A key acts like the
terminal's word of the same name.
"""

import re
from collections.abc import Callable

from edmsim.controllers.mcu.chips.display import BANK, BLANK, SHIFT, write_digit
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.dialogue.line_input import SEPARATORS
from edmsim.controllers.mcu.dialogue.main_program import MachinePort, Move, Setting, check_speed
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES

KEYS = {
    name: 10 + k
    for k, name in enumerate(
        ("CLEAR", "X", "Y", "T(I)", "T(P)", "SPEED", "START", "STOP", "GO", "INIT", "X+", "X-", "Y+", "Y-")
    )
}
"""Keys by name; 0..9 are the digits. SHIFT with X or Y sets the position counter, without it the new position."""
FIELDS = {
    "x": (0, 5), "y": (6, 5), "speed": (12, 4), "entry": (BANK, 5), "short": (BANK + 6, 3), "open": (BANK + 10, 3),
}  # fmt: skip
"""First digit and number of digits."""
_SHIFT = "SHIFT"


def read_keys(text: str) -> list[int]:
    """Return the codes of keys by their names, ``300 X SHIFT Y``; SHIFT belongs to the key after it."""
    codes: list[int] = []
    shift = 0
    for name in re.findall(f"[^{SEPARATORS.decode('ascii')}]+", text):
        if name == _SHIFT:
            shift = SHIFT
            continue
        if not (name in KEYS or (name.isascii() and name.isdigit())):
            raise InputError(f"there is no key {name}; there are 0 to 9, SHIFT, {', '.join(KEYS)}")
        codes += [shift | key for key in ([KEYS[name]] if name in KEYS else map(int, name))]
        shift = 0
    if shift or not codes:
        raise InputError(f"a key is wanted: 0 to 9, SHIFT, {', '.join(KEYS)}")
    return codes


class FrontPanel:
    """Keys and digits of one computer; the keys do what the words of MAIN do."""

    def __init__(self, computer: Computer, machine: MachinePort) -> None:
        self._computer, self._machine = computer, machine
        self._new: dict[int, int] = {}
        self._shown: dict[int, int] = {}
        set_ = machine.set
        commands: dict[str, Callable[[int], None]] = {
            "CLEAR": lambda n: None,
            "X": lambda n: self._new.update({0: n}),
            "Y": lambda n: self._new.update({1: n}),
            "T(I)": lambda n: set_(Setting(t_i=machine.pulse_settings.code_of_t_i(n))),
            "T(P)": lambda n: set_(Setting(t_p=machine.pulse_settings.code_of_t_p(n))),
            "SPEED": lambda n: set_(Setting(speed=check_speed(n))),
            "START": lambda n: self._start(),
            "STOP": lambda n: machine.stop(),
            "GO": lambda n: machine.go_on(),
            "INIT": lambda n: machine.init(),
            "X+": lambda n: machine.jog(0, n or STEP_UM),
            "X-": lambda n: machine.jog(0, -(n or STEP_UM)),
            "Y+": lambda n: machine.jog(1, n or STEP_UM),
            "Y-": lambda n: machine.jog(1, -(n or STEP_UM)),
        }
        self._commands = {KEYS[name]: do for name, do in commands.items()}
        self._commands[KEYS["X"] | SHIFT] = lambda n: machine.set_position((n, computer.position[1]))
        self._commands[KEYS["Y"] | SHIFT] = lambda n: machine.set_position((computer.position[0], n))

    def serve(self) -> list[str]:
        """Obey the keys pressed since the last call, and show what there is to show; return why some did nothing."""
        refused = []
        for key in self._computer.take_keys():
            try:
                self._press(key)
            except InputError as error:
                refused.append(error.reason)
        self.show()
        return refused

    def _press(self, key: int) -> None:
        entry = self._computer.bus.word(at.ENTRY)
        if key < 10:
            if entry * 10 + key > WORD:
                raise InputError(f"the number is past {WORD}")
            self._computer.bus.store(at.ENTRY, entry * 10 + key)
            return
        self._computer.bus.store(at.ENTRY, 0)
        if key not in self._commands:
            raise InputError(f"key {key & 0x3F} has no meaning {'with SHIFT or CTRL' if key > 0x3F else 'here'}")
        self._commands[key](entry)

    def _start(self) -> None:
        """Cut to the new position; an axis that was given none stays where it is."""
        if not self._new:
            raise InputError("no new position was given; the keys X and Y give one")
        x, y = self._computer.position
        self._machine.cut([Move((self._new.get(0, x), self._new.get(1, y)))])
        self._new.clear()

    def show(self) -> None:
        """Write the digits that have changed, each without touching its neighbour in the other bank."""
        computer = self._computer
        x, y = computer.position
        values = {
            "x": x, "y": y, "speed": abs(computer.signed(at.CUTVEL)), "entry": computer.bus.word(at.ENTRY),
            "short": 100 * computer.bus.word(at.SHORTS) // WINDOW_PULSES,
            "open": 100 * computer.bus.word(at.OPENS) // WINDOW_PULSES,
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
