"""An operator's actions on the rig and their conditions: MAIN's interface to the machine, and the 64 keys."""

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence

from edmsim.consoles.computer_1982.line_input import SEPARATORS
from edmsim.consoles.computer_1982.rig import END_SWITCHES, Point, Rig, lay_out
from edmsim.consoles.computer_1982.words import Entry, Move, Setting, Status, check_speed
from edmsim.controllers.mcu.board import STOP_BUTTON, Board
from edmsim.controllers.mcu.chips.dac import PulseSettings
from edmsim.controllers.mcu.chips.display import BANK, BLANK, CTRL, SCAN_NS, SHIFT, write_digit
from edmsim.controllers.mcu.computer import OFF, Computer, set_tension
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES

# The front panel on the 8279: its keys and digits, which the document does not specify.
#
# Bank A shows x, y and the present cutting speed; bank B shows the number being entered and the percentages of short
# and open pulses. Enter a number digit by digit, then press a key for its meaning (ours). A key acts like the
# terminal's word of the same name.

KEYS = {
    name: 10 + k
    for k, name in enumerate(
        ("CLEAR", "X", "Y", "T(I)", "T(P)", "SPEED", "START", "STOP", "GO", "INIT", "X+", "X-", "Y+", "Y-")
    )
}
"""Keys by name; 0..9 are the digits. X and Y set the new position; with SHIFT, the position counter."""
FIELDS = {
    "x": (0, 5), "y": (6, 5), "speed": (12, 4), "entry": (BANK, 5), "short": (BANK + 6, 3), "open": (BANK + 10, 3),
}  # fmt: skip
"""First digit and number of digits."""
_SHIFT = "SHIFT"


def read_keys(text: str) -> list[int]:
    """Return the codes of keys in a text such as ``300 X SHIFT Y``; SHIFT belongs to the key after it."""
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
        raise InputError(f"a key is expected: 0 to 9, SHIFT, {', '.join(KEYS)}")
    return codes


class FrontPanel:
    """Keys and digits of one computer; the keys act like the words of MAIN."""

    def __init__(self, computer: Computer, machine: "Operation") -> None:
        self._computer, self._machine = computer, machine
        self._new: dict[int, int] = {}
        self._shown: dict[int, int] = {}
        set_, step = machine.set, STEP_UM // machine.rig.unit_um
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
            "X+": lambda n: machine.jog(0, n or step),
            "X-": lambda n: machine.jog(0, -(n or step)),
            "Y+": lambda n: machine.jog(1, n or step),
            "Y-": lambda n: machine.jog(1, -(n or step)),
        }
        self._commands = {KEYS[name]: do for name, do in commands.items()}
        self._commands[KEYS["X"] | SHIFT] = lambda n: machine.set_position((n, computer.position[1]))
        self._commands[KEYS["Y"] | SHIFT] = lambda n: machine.set_position((computer.position[0], n))

    def serve(self) -> list[str]:
        """Execute the keys pressed since the last call and update the digits; return the reasons of refused keys."""
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
        """Cut to the new position; an axis without one is not moved."""
        if not self._new:
            raise InputError("no new position was given; the keys X and Y give one")
        x, y = self._computer.position
        self._machine.cut([Move((self._new.get(0, x), self._new.get(1, y)))])
        self._new.clear()

    def show(self) -> None:
        """Write the digits that have changed; digits of the other bank at the same addresses are kept."""
        computer = self._computer
        x, y = computer.position
        values = {
            "x": x, "y": y, "speed": abs(computer.bus.signed(at.CUTVEL)), "entry": computer.bus.word(at.ENTRY),
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


HELD_NS, RELEASED_NS = 60_000_000, 40_000_000  # press of a key, pause after it (ours: a quick typist)
TOGGLE = 0x0B  # Ctrl-K
TYPED = {
    **{bytes([character]): digit for digit, character in enumerate(b"0123456789")},
    b"c": KEYS["CLEAR"], b"\b": KEYS["CLEAR"], b"\x7f": KEYS["CLEAR"],
    b"x": KEYS["X"], b"y": KEYS["Y"], b"X": KEYS["X"] | SHIFT, b"Y": KEYS["Y"] | SHIFT,
    b"i": KEYS["T(I)"], b"p": KEYS["T(P)"], b"v": KEYS["SPEED"], b"\r": KEYS["START"], b"\n": KEYS["START"],
    b" ": KEYS["STOP"], b"g": KEYS["GO"], b"n": KEYS["INIT"],
    b"\x1b[C": KEYS["X+"], b"\x1b[D": KEYS["X-"], b"\x1b[A": KEYS["Y+"], b"\x1b[B": KEYS["Y-"],
}  # fmt: skip
"""Keys of the panel by the characters typed at a terminal; the last four are the arrow keys."""
LEGEND = (
    "Ctrl-K ends  0-9  c CLEAR  x X  y Y (capital: SHIFT)  i T(I)  p T(P)\n"
    "v SPEED  Enter START  space STOP  g GO  n INIT  arrows X+ X- Y+ Y-"
)


def typed_keys(data: bytes) -> list[int]:
    """Return the codes of the panel's keys in typed characters; other characters are skipped."""
    codes, at = [], 0
    while at < len(data):
        size = 3 if data[at : at + 2] == b"\x1b[" else 1
        if data[at : at + size] in TYPED:
            codes.append(TYPED[data[at : at + size]])
        at += size
    return codes


class KeyPresses:
    """Presses of a board's keys, one after the other in machine time."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._waiting: deque[int] = deque()
        self._down_ns = self._scan_ns = 0

    @property
    def busy(self) -> bool:
        """Whether a key is pressed or waiting."""
        return bool(self._waiting)

    def press(self, codes: Iterable[int], now_ns: int) -> None:
        """Press keys, after the waiting ones."""
        if not self.busy:
            self._down_ns = self._scan_ns = now_ns
        self._waiting.extend(codes)

    def scan_until(self, end_ns: int) -> Iterator[None]:
        """Scan the keys with the 8279 up to a time; yields whenever its buffer contains a key."""
        while self.busy and self._scan_ns < end_ns:
            self._scan_ns += SCAN_NS
            code, held_ns = self._waiting[0], self._scan_ns - self._down_ns
            closed = frozenset([code & 0x3F] if held_ns <= HELD_NS else ())
            self._board.scan_keys(closed, bool(code & SHIFT), bool(code & CTRL))
            if self._board.display.waiting:
                yield
            if held_ns >= HELD_NS + RELEASED_NS:
                self._waiting.popleft()
                self._down_ns = self._scan_ns


class Operation:
    """The operator's actions on a rig. An impossible action raises `InputError` and changes nothing."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._panel = FrontPanel(rig.computer, self)
        self.presses = KeyPresses(rig.board)
        self.at_panel = False  # whether typed characters press keys of the front panel

    @property
    def greeting(self) -> str:
        """The terminal's first lines."""
        machine = self.rig.plant.machine
        lines = [
            f"{machine.name.upper()}   WIRE SPARK EROSION   8085 CONTROLLER",
            f"{machine.material_name.upper()} {machine.height_mm:g} mm HIGH, ITS EDGE 30 um AHEAD OF THE WIRE IN +X",
        ]
        if self.rig.unit == "step":
            travel = machine.base.table.travel_mm.value
            lines.append(f"THE TABLE HAS {travel:g} mm: PLACES AND WAYS ARE STEPS OF {STEP_UM} um HERE, NOT um")
        return "\n".join([*lines, "HELP LEADS THROUGH A JOB; BYE LEAVES"])

    @property
    def pulse_settings(self) -> PulseSettings:
        """Relation between codes and times of pulses."""
        return self.rig.board.settings

    def status(self) -> Status:
        """State of the machine."""
        rig, computer, bus = self.rig, self.rig.computer, self.rig.computer.bus
        t_i, t_p = computer.pulse_codes
        t_i_us, t_p_us = rig.board.times_us
        voltage, current = rig.gap
        mode = "NOT INITIALISED" if computer.state == OFF else rig.mode
        return Status(
            state=f"EMERGENCY: {rig.cause}" if rig.in_emergency else mode,
            position=computer.position, unit=rig.unit_name, move=rig.move, time_s=rig.time_ns * 1e-9,
            speed=computer.speed, running=bus.signed(at.CUTVEL),
            short=bus.word(at.SHORTS), open=bus.word(at.OPENS), counted=bus.word(at.COUNTED),
            windows=rig.windows, missed=rig.board.counters.missed,
            t_i=t_i, t_p=t_p, t_i_us=t_i_us, t_p_us=t_p_us,
            generator_on=rig.board.generator_on, voltage_V=voltage, current_A=current,
        )

    def advance(self) -> list[str]:
        """Run a window, then scan and execute keys and write the digits; return the reasons of refused keys."""
        self.rig.advance()
        refused = []
        for _ in self.presses.scan_until(self.rig.time_ns):
            self.rig.computer.serve()
            refused += self._panel.serve()
        self._panel.show()
        return refused

    def press(self, codes: Iterable[int]) -> None:
        """Press keys of the front panel, beginning at the present time."""
        self.presses.press(codes, self.rig.time_ns)

    def digits(self) -> list[int]:
        """Write the display, and return its 32 digits."""
        self._panel.show()
        return self.rig.board.display.digits

    def set_position(self, position: Point) -> None:
        """Set the position counters."""
        self._check_still()
        self.rig.computer.set_position(*position)

    def set(self, setting: Setting) -> None:
        """Set codes and speed, also while cutting."""
        self._check_alive()
        if setting.t_i and not (self.rig.computer.pulse_codes[1] or setting.t_p):
            raise InputError("t(p) is not set yet; TI us TP us sets both")
        self.rig.set(setting)

    def cut(self, program: Sequence[Entry]) -> None:
        """Set the program's settings before its first move, then start timers and generator along its path."""
        self._check_still()
        route = lay_out(self.rig.computer.position, program, self.rig.unit_um)
        while route.dues and not route.dues[0][0]:
            self.rig.set(route.dues.pop(0)[1])
        self._check_pulses()
        self.rig.begin_cut(route)

    def go_on(self) -> None:
        """Resume the stopped cut at the position where it was stopped."""
        self._check_still()
        if self.rig.held is None:
            raise InputError("no cut was stopped; START or RUN begins one")
        planner, route, (x, y) = self.rig.held
        if (x, y) != self.rig.computer.position:
            raise InputError(f"the cut stopped at X {x} Y {y}; bring the wire back there first")
        self._check_pulses()
        self.rig.resume_cut(planner, route)

    def jog(self, axis: int, distance: int) -> None:
        """Move one axis with the generator off, as fast as the timers run; at an open end switch only back."""
        self._check_still()
        if abs(distance) * self.rig.unit_um < STEP_UM:
            raise InputError(f"a motor step is {STEP_UM} um; jog by at least that")
        x, y = self.rig.computer.position
        target = (x, y + distance) if axis else (x + distance, y)
        if not 0 <= target[axis] <= WORD:
            raise InputError(f"soft limit: the counters hold 0 to {WORD} {self.rig.unit_name}, not {target[axis]}")
        direction = 1 if distance > 0 else -1
        if self.rig.ends.switch_open(axis, direction, self.rig.place_um[axis]):
            raise InputError(f"the {END_SWITCHES[axis]} switch is open; jog back from it")
        self.rig.board.switches.release()
        self.rig.computer.stop()
        self.rig.begin_jog(target)

    def stop(self) -> None:
        """Stop timers and generator."""
        self._check_alive()
        if not self.rig.moving and not self.rig.board.generator_line.running:
            raise InputError("the machine is not moving")
        self.rig.stand("STOPPED")

    def generator(self, on: bool) -> None:
        """Run or stop the generator, with the table at rest."""
        self._check_still()
        if on:
            self._check_pulses()
            self.rig.computer.start()
        else:
            self.rig.computer.stop()

    def emergency(self) -> None:
        """The operator's emergency stop."""
        self.rig.trip(STOP_BUTTON, "STOP BY THE OPERATOR")

    def init(self) -> None:
        """INIT: a safe stand-by; the position is kept (rows T-50, T-51). The stop button is released before it."""
        switches = self.rig.board.switches
        still_open = [name for name in switches.open if name != STOP_BUTTON]
        switches.release()
        for name in still_open:
            switches.trip(name)
        self.rig.put_down()
        self.rig.computer.init()

    def reset(self) -> None:
        """The reset button, also pressed at power-up: the machine is made safe, and the monitor started."""
        self.init()
        self.rig.computer.reset()

    def thread_wire(self) -> None:
        """Thread a new wire at the carriage's position."""
        self._check_still()
        if self.rig.wire:
            raise InputError("the wire is whole")
        if self.rig.in_metal:
            raise InputError("the wire's place is inside the workpiece; jog back first")
        self.rig.thread()
        self.rig.say("NEW WIRE")

    def tension(self, low: bool) -> None:
        """Lower the wire's tension, or restore it."""
        self._check_alive()
        set_tension(self.rig.board, low)

    def _check_alive(self) -> None:
        if self.rig.computer.state == OFF:
            raise InputError("the machine is not initialised: INIT first")
        if self.rig.in_emergency:
            raise InputError(f"emergency ({self.rig.cause}): only INIT helps")

    def _check_still(self) -> None:
        self._check_alive()
        if self.rig.moving:
            raise InputError("the machine moves already; STOP stops it, WAIT waits for its end")

    def _check_pulses(self) -> None:
        if not all(self.rig.computer.pulse_codes):
            raise InputError("t(i) and t(p) are not set; TI us TP us sets them")
        if self.rig.has_no_wire:
            raise InputError("the wire is broken; WIRE threads a new one")
