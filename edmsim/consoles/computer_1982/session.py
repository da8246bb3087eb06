"""The session: bytes through LINE to MAIN, machine time between them, and the machine's events.

Live, the machine runs at a multiple of real time and reads lines on arrival. In a script, machine time stops while
lines are read: WAIT advances it, and the end of the input waits until the machine stands still.
"""

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from edmsim.consoles.computer_1982 import line_input
from edmsim.consoles.computer_1982.main_program import MainProgram
from edmsim.consoles.computer_1982.monitor import STARTS, Monitor
from edmsim.consoles.computer_1982.operation import FIELDS, LEGEND, TOGGLE, Operation, typed_keys
from edmsim.consoles.computer_1982.rig import END_SWITCHES, Rig
from edmsim.consoles.computer_1982.words import Status
from edmsim.consoles.devices import Interrupts, Keyboard, Pipe, is_terminal
from edmsim.controllers.mcu.board import WIRE_BREAK, DropOut, Faults, SerialNoise
from edmsim.controllers.mcu.chips import bus
from edmsim.controllers.mcu.chips.display import BANK
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.errors import InputError, one_of
from edmsim.machine.setting import WINDOW_PULSES

# The live view of a real terminal: the 32 digits, the pulses in percent, and the operator's line below them.

_EVERY_S = 0.1
_BAR_CELLS = 40


class View(Keyboard):
    """A person's terminal with a panel at its lower edge; printed lines scroll above it."""

    def __init__(self, interrupts: Interrupts) -> None:
        super().__init__(interrupts)
        self._console = Console(highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._partial = ""
        self._next_s = 0.0
        self._panel: Panel | None = None
        self._last_state: tuple[list[int], Status, bool] | None = None

    @contextmanager
    def in_character_mode(self) -> Iterator[None]:
        """Show the panel while characters are read one by one."""
        with super().in_character_mode(), self._live:
            yield

    def write(self, data: bytes) -> None:
        """Print complete lines above the panel, the incomplete line below it."""
        for character in data.decode("ascii", "replace"):
            if character == "\n":
                self._live.console.print(Text(self._partial))
                self._partial = ""
            elif character == "\b":
                self._partial = self._partial[:-1]
            elif character == "\a":
                self._console.bell()
            elif character != "\r":
                self._partial += character
        # BS, space, BS deletes a character: the second BS deletes the space
        self._draw()

    def refresh(self, operation: Operation) -> None:
        """Draw the machine's state, at most ten times a second."""
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + _EVERY_S
        status = operation.status()._replace(time_s=0.0, voltage_V=0.0, current_A=0.0)
        state = operation.digits(), status, operation.at_panel
        if state != self._last_state:
            self._last_state = state
            self._panel = panel(*state)
            self._draw()

    def _draw(self) -> None:
        if self._panel is not None:
            self._live.update(Group(self._panel, Text(self._partial + "_")), refresh=True)


def panel(digits: list[int], status: Status, at_panel: bool) -> Panel:
    """Return the digits with their names, the keys if they can be pressed, and the pulses of the last window."""
    keys = [Text(LEGEND, style="yellow")] if at_panel else []
    shown = Group(_digits(digits), *keys, Text(), _bars(status))
    return Panel(shown, title=status.state, title_align="left", expand=False)


def _digits(shown: list[int]) -> Table:
    """Return two banks of sixteen digits; values above 9 are dark."""
    table = Table.grid(padding=(0, 3))
    for bank in (0, BANK):
        fields = {name: place for name, place in FIELDS.items() if bank <= place[0] < bank + BANK}
        figures = [shown[first : first + count] for first, count in fields.values()]
        table.add_row(*(Text(name, style="dim") for name in fields))
        table.add_row(
            *(Text(" ".join(str(d) if d <= 9 else " " for d in digits), style="bold red") for digits in figures)
        )
    return table


def _bars(status: Status) -> Table:
    table = Table.grid(padding=(0, 1))
    for name, count, colour in (
        ("short", status.short, "red"), ("open", status.open, "yellow"), ("erosion", status.erosion, "green"),
    ):  # fmt: skip
        cells = round(count / WINDOW_PULSES * _BAR_CELLS)
        bar = Text("█" * cells + "·" * (_BAR_CELLS - cells), style=colour)
        table.add_row(name, f"{100 * count / WINDOW_PULSES:5.1f} %", bar)
    return table


class SerialLines:
    """Bytes through the 8251s and the routines at CIADR and COADR (rows T-58, T-59)."""

    def __init__(self, computer: Computer) -> None:
        self._computer = computer

    def heard(self, data: bytes, from_host: bool = False) -> bytes:
        """Return the characters that the program reads of bytes from operator or host; sparks may disturb them."""
        fetched = bytearray()
        for byte in data:
            self._computer.board.receive(byte, from_host)
            character = self._computer.streams.ci()
            if character is not None:
                fetched.append(character)
        return bytes(fetched)

    def received_from_host(self, data: bytes) -> bytes:
        """Return the characters that the program reads from the host; the input stream is redirected meanwhile."""
        self._computer.bus.store(at.CIADR, at.HOST_IN)
        try:
            return self.heard(data, from_host=True)
        finally:
            self._computer.bus.store(at.CIADR, at.TERMINAL_IN)

    def transmitted(self, data: bytes) -> bytes:
        """Return the bytes that arrive at the operator's screen when the program sends bytes."""
        board = self._computer.board
        for byte in data:
            self._computer.streams.co(byte)
        sent = bytes(board.sent)
        board.sent.clear()
        noise = board.faults.noise
        return sent if noise is None else bytes(noise(byte, board.mean_current_A) for byte in sent)


def read_host(file: Path, lines: SerialLines) -> list[bytes]:
    """Return the lines of the host's file as LINE reads them: at most 64 characters, in capitals, without echo."""
    data = bytes_of(file)
    buffer, taken = line_input.InputBuffer(), []
    line = line_input.Line(buffer, lambda echo: None)
    for number, text in enumerate(lines.received_from_host(data).splitlines(), 1):
        try:
            for character in text:
                if not (line_input.SPACE <= character < line_input.DELETE or character == line_input.TAB):
                    raise InputError(f"{character:02X}H is not a character of a line")
                line.take(character)
            line.take(line_input.LINE_FEED)
        except InputError as error:
            raise InputError(f"line {number} of the host's program: {error.reason}") from None
        taken.append(buffer.text)
    return taken


def bytes_of(file: Path) -> bytes:
    """Return the content of a host's file; raises `InputError` if it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"the host's file cannot be read: {error.strerror}", file) from None


ETX, EOT, RESET = 0x03, 0x04, 0x1C
"""Ctrl-C as a character is the emergency stop, Ctrl-D on an empty line leaves, Ctrl-\\ is the reset button."""
FINE, REFUSED, STOPPED = 0, 2, 3
"""Exit statuses: all was done; a line of a script was refused; the machine was left in an emergency."""
_BEHIND_S = 0.5  # greatest delay to real time that the machine catches up
PROGRAM_NS = 60_000_000_000  # longest time for which a script waits for a program that the monitor started
_STALLED = f"the greatest speed (MAXVEL, {at.MAXVEL:04X}H) is 0, so the cut does not end"
_IDLE_S = 0.05  # longest wait for input between two windows


class Session:
    """An operator at the machine: live at a speed, or a script; begins in MAIN or, with `monitor`, in the monitor."""

    def __init__(
        self, rig: Rig, screen: Pipe, interrupts: Interrupts, *, speed: float | None = None,
        host: Path | None = None, person: bool = False, monitor: bool = False, tapes: Path | None = None,
    ) -> None:
        self.refused = 0  # number of refused lines; they set the exit status of a script, not of a person
        self._rig = rig
        self._operation = Operation(rig)
        self._lines = SerialLines(rig.computer)
        self._screen = screen
        self._interrupts = interrupts
        self._speed = speed
        self._host = host
        self._person = person
        self._pending = bytearray()
        self._leaving = False
        self._wait_until_ns: int | None = None
        self._waits_for_rest = False
        self._input_ended = False
        self._program_until_ns: int | None = None
        self._buffer = line_input.InputBuffer(streams=rig.computer.streams)
        self._line = line_input.Line(self._buffer, self._transmit)
        self._main = MainProgram(self._operation, self, self._say, rig.board.bus)
        self._monitor = Monitor(
            rig.computer, tapes or Path(), lambda: self._lines.received_from_host(bytes_of(self._connected_host())),
            self._go, self._transmit, self._say,
        )
        self._in_monitor = monitor
        self._main_waits = False
        self._character = line_input.LINE_FEED
        self._passes_line = False
        self._prompted = False

    def run(self) -> int:
        """Serve the operator until the session ends; return the exit status."""
        if self._in_monitor:
            self._press_reset()
        else:
            self._say(self._operation.greeting)
        if self._speed is None:
            self._run_script()
        else:
            self._run_live(self._speed)
        stopped = self._rig.in_emergency
        self._operation.init()
        if stopped:
            return STOPPED
        return REFUSED if self.refused and not self._person else FINE

    def _run_script(self) -> None:
        while not self._leaving:
            if self._interrupts.take():
                self._leaving = True
                self._stop_everything()
            elif self._waiting:
                self._advance()
            elif self._pending:
                for character in self._heard(bytes([self._pending.pop(0)])):
                    self._take(character)
            elif self._screen.at_end:
                if not self._ends_last_line():
                    self._leaving = self._is_done()
                    self._waits_for_rest = not self._leaving
            else:
                self._prompt()
                self._pending += self._screen.read(None)
        self._end_line()

    def _run_live(self, speed: float) -> None:
        began_s, began_ns = time.monotonic(), self._rig.time_ns
        while not self._leaving:
            if self._interrupts.take():
                self._pending.clear()
                self._forget_line()
                self._stop_everything()
            while self._pending and not self._waiting and not self._leaving:
                self._take(self._pending.pop(0))
            if not self._waiting:
                self._prompt()
            due_s = (self._rig.time_ns - began_ns) * 1e-9 / speed - (time.monotonic() - began_s)
            if due_s < -_BEHIND_S:
                began_s, began_ns = time.monotonic(), self._rig.time_ns
            if due_s <= 0:
                self._advance()
            self._screen.refresh(self._operation)
            self._receive(min(max(due_s, 0.0), _IDLE_S))
            if self._screen.at_end and not self._pending and not self._waiting:
                self._leaving = not self._ends_last_line() and self._is_done()
        self._end_line()

    def _is_done(self) -> bool:
        """Return whether the machine is at rest after the input; a cut that would never end is left unfinished."""
        if self._rig.stalled:
            self._refuse(f"{_STALLED}; it is left unfinished")
            return True
        return not self._rig.moving

    def _ends_last_line(self) -> bool:
        """Append the end of a script's last line if its file has none; return whether it was appended."""
        ends = bool(self._typed) and not self._person and not self._input_ended
        self._input_ended = True
        if ends:
            self._pending.append(line_input.RETURN)
        return ends

    def _receive(self, timeout_s: float) -> None:
        """Read typed bytes; Ctrl-C acts at once, and bytes before it are discarded."""
        typed = self._to_panel(self._screen.read(timeout_s))
        if typed and self._rig.computer.code.running and not {ETX, line_input.CANCEL, RESET} & set(typed):
            for byte in typed:
                self._rig.board.receive(byte)
            return
        if RESET in typed:
            self._pending.clear()
        data = self._heard(typed)
        if ETX in data:
            self._interrupts.press()
            data = data[data.rindex(ETX) + 1 :]
        self._pending += data
        if self._waiting and line_input.CANCEL in self._pending:
            self._end_wait()
            del self._pending[: self._pending.rindex(line_input.CANCEL) + 1]

    def _heard(self, data: bytes) -> bytes:
        """Return the characters that the program reads of typed bytes; the reset button acts without a program."""
        if RESET in data:
            data = data[data.rindex(RESET) + 1 :]
            self._press_reset()
        try:
            return self._lines.heard(data)
        except InputError as error:
            self._lose(error, data[-1])
            return b""

    def _lose(self, error: InputError, character: int) -> None:
        """Reset, because CIADR or COADR is invalid; the rest of a script's line is not read as a command."""
        self._press_reset()
        self._passes_line = not self._person and character not in (line_input.RETURN, line_input.LINE_FEED)
        self._refuse(error.reason)

    def _press_reset(self) -> None:
        self._forget_line()
        self._operation.reset()
        self._clear_line()
        self._program_until_ns = None
        self._in_monitor, self._main_waits = True, False
        self._say("MONITOR 8085   8 K EPROM   8 K RAM   ? SHOWS THE COMMANDS, G 0400 STARTS MAIN")

    def _forget_line(self) -> None:
        self._line.clear()
        self._monitor.clear()

    def _to_panel(self, data: bytes) -> bytes:
        """Press the front panel's keys for bytes between two Ctrl-K; return the other bytes."""
        rest = b""
        for number, part in enumerate(data.split(bytes([TOGGLE]))):
            if number:
                self._operation.at_panel = not self._operation.at_panel
            if self._operation.at_panel and ETX not in part:
                self._operation.press(typed_keys(part))
            else:
                rest += part
        return rest

    def _stop_everything(self) -> None:
        self._operation.emergency()
        self._tell()

    def _take(self, character: int) -> None:
        """Pass a character to the monitor, or to LINE, whose complete lines go to MAIN.

        CR LF ends one line: a second, empty one would answer MAIN's next question.
        """
        before, self._character = self._character, character
        if (before, character) == (line_input.RETURN, line_input.LINE_FEED):
            return
        if character == ETX:
            self._forget_line()
            self._stop_everything()
        elif character == EOT:
            self._leaving |= not self._typed
        elif self._passes_line:
            self._passes_line = character not in (line_input.RETURN, line_input.LINE_FEED)
        else:
            self._prompt()
            self._obey(character)

    def _obey(self, character: int) -> None:
        try:
            if self._in_monitor:
                if self._monitor.take(character):
                    self._prompted = False
            elif self._line.take(character):
                self._prompted = False
                self._main.obey(self._buffer)
        except InputError as error:
            # the rest of a script's line after a mistake is not a command
            ends = character in (line_input.RETURN, line_input.LINE_FEED)
            self._passes_line = self._in_monitor and not self._person and not ends
            self._prompted = False
            self._refuse(error.reason)
        self._tell()

    def _advance(self) -> None:
        """Run a window of machine time."""
        for reason in self._operation.advance():
            self._refuse(reason)
        self._tell()
        over = self._wait_until_ns is not None and self._rig.time_ns >= self._wait_until_ns
        if over or (self._waits_for_rest and not self._rig.moving):
            self._end_wait()
        if self._program_until_ns is not None:
            if sent := bytes(self._rig.board.sent):  # by a program; its incomplete line is ended when it stops
                self._transmit(b"")
                self._prompted = not sent.endswith(b"\n")
            if not self._rig.computer.code.running:
                self._program_until_ns = None
                self._clear_line()
            elif self._rig.time_ns >= self._program_until_ns and not self._person:
                self._end_wait()

    def _tell(self) -> None:
        """Print the machine's events; an emergency ends every wait."""
        events = self._rig.take_events()
        if events:
            self._clear_line()
            self._say("\n".join(events))
        if self._rig.in_emergency:
            self._end_wait()

    def _refuse(self, reason: str) -> None:
        """Print the reason why a line or a key was refused."""
        self._clear_line()
        self.refused += 1
        self._say(f"? {reason}")

    @property
    def _waiting(self) -> bool:
        code = self._rig.computer.code
        if code.running and self._program_until_ns is None:
            self._program_until_ns = self._rig.time_ns + PROGRAM_NS
        waits = self._waits_for_rest or self._wait_until_ns is not None or self._program_until_ns is not None
        return waits or self._operation.presses.busy

    def _end_wait(self) -> None:
        """Accept lines again; a running program is stopped."""
        self._waits_for_rest, self._wait_until_ns, self._program_until_ns = False, None, None
        code = self._rig.computer.code
        if code.running:
            code.running = False
            self._refuse(f"the program was broken off at {code.cpu.pc:04X}H")

    def _prompt(self) -> None:
        """Print the prompt and the typed text after it, unless they are on the screen."""
        if not self._prompted and not self._leaving:
            prompt = self._monitor.prompt if self._in_monitor else self._main.prompt
            self._transmit(prompt.encode("ascii") + self._typed)
            self._prompted = True

    @property
    def _typed(self) -> bytes:
        """Text after the prompt."""
        return self._monitor.typed if self._in_monitor else self._line.typed

    def _clear_line(self) -> None:
        """Continue on a new line, so that an incomplete line stays on the screen."""
        if self._prompted:
            self._transmit(b"\r\n")
            self._prompted = False

    def _end_line(self) -> None:
        """End the dialogue; a person's line without its end is not executed (row T-53)."""
        self._clear_line()
        if self._typed:
            self.refused += 1
            self._say("? the last line has no end; nothing was done")

    def _say(self, text: str) -> None:
        for line in text.splitlines():
            self._transmit(line.encode("ascii", "replace") + b"\r\n")

    def _transmit(self, data: bytes) -> None:
        try:
            shown = self._lines.transmitted(data)
        except InputError as error:
            self._lose(error, self._character)
            return
        self._screen.write(shown)

    def wait(self, seconds: int | None) -> None:
        """Accept no line for some machine time or, for None, until the machine does not move."""
        if seconds is None:
            if self._rig.stalled:
                raise InputError(f"{_STALLED}; WAIT s waits s seconds")
            self._waits_for_rest = self._rig.moving
        else:
            self._wait_until_ns = self._rig.time_ns + seconds * 1_000_000_000
        if self._person and self._waiting:
            self._say("WAITING; CTRL-X ENDS IT, CTRL-C IS THE EMERGENCY STOP")

    def host_lines(self) -> Iterable[bytes]:
        """Return the lines that the host sends through the second serial channel (row T-59)."""
        host = self._connected_host()
        if self._rig.moving:
            raise InputError("the machine moves; a program is loaded while it stands still")
        return read_host(host, self._lines)

    def _connected_host(self) -> Path:
        if self._host is None:
            raise InputError("no host is connected; edmsim console 1982 --host FILE connects one")
        return self._host

    def monitor(self) -> None:
        """Pass the next characters to the monitor; the machine continues."""
        self._in_monitor = self._main_waits = True

    def _go(self, address: int | None) -> None:
        """Start at an address or, for None, resume MAIN."""
        code = self._rig.computer.code
        if address is None or address == at.MAIN:
            if address is None and not self._main_waits:
                raise InputError(f"MAIN was not started yet; G {at.MAIN:04X} starts it")
            self._in_monitor = False
            if address is not None:  # MAIN begins with INIT (row T-52)
                self._operation.init()
                self._say(self._operation.greeting)
        elif address == at.MONITOR:
            self._press_reset()
        elif address == at.INIT:
            self._operation.init()
        elif address == at.EMERGENCY_ROUTINE:
            self._rig.stop_all("CALLED FROM THE MONITOR")
        elif address in STARTS:
            code.call(address)
        elif address in bus.RAM:
            code.begin(address)
        else:
            raise InputError(f"there is no 8085 code at {address:04X}H: the listings are lost; M shows what starts")

    def leave(self) -> None:
        """End the session."""
        self._leaving = True


REAL_TIME = 1.0  # machine seconds per second for a person
SERIAL_NOISE, DROP_OUT = "serial-noise", "drop-out"  # the faults of 1982, rows T-29 and T-30
STUCK = {"stuck-end-switch": frozenset(END_SWITCHES), "stuck-wire-sensor": frozenset({WIRE_BREAK})}
"""Switches that never open, by the fault's name."""
FAULTS = (SERIAL_NOISE, DROP_OUT, *STUCK)


def run(
    rig: Rig, host: Path | None, speed: float | None, view: bool, monitor: bool = False, tapes: Path | None = None
) -> int:
    """Serve the operator at standard input and output; returns the exit status.

    The speed is in machine seconds per second; by default 1 for a person, the highest for a script.
    """
    if speed is not None and not speed > 0:
        raise InputError(f"--speed is above 0, in machine seconds per second, not {speed:g}")
    if host is not None and not os.access(host, os.R_OK):
        raise InputError("cannot be read; --host takes a file with the host's program", host)
    if tapes is not None and not tapes.is_dir():
        raise InputError("is not a folder; --tapes takes the one in which tapes lie", tapes)
    begin = partial(Session, rig, host=host, monitor=monitor, tapes=tapes)
    interrupts = Interrupts()
    with interrupts.caught():
        if not is_terminal():
            return begin(Pipe(interrupts), interrupts, speed=speed).run()
        keyboard = View(interrupts) if view and os.environ.get("TERM", "dumb") != "dumb" else Keyboard(interrupts)
        session = begin(keyboard, interrupts, speed=speed or REAL_TIME, person=True)
        with keyboard.in_character_mode():
            return session.run()


def choose_faults(names: Sequence[str], seed: int) -> Faults:
    """Return the faults of these names, to be injected; raises `InputError` for an unknown name."""
    for name in names:
        if name not in FAULTS:
            raise InputError(f"there is no fault {name!r}; there are {one_of(name, FAULTS)}")
    return Faults(
        noise=SerialNoise(seed) if SERIAL_NOISE in names else None,
        drop_out=DropOut(seed) if DROP_OUT in names else None,
        stuck=frozenset().union(*(STUCK[name] for name in names if name in STUCK)),
    )
