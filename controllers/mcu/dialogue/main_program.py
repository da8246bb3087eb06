"""MAIN: the operator's dialogue (5.1, row T-52).

The document's MAIN gets position, new position, t(i), t(p) and cutting speed, and then starts timers and machine; its
dialogue did not exist yet in 1982 (5.1.2). The words are ours: MAIN asks as the document says, and every value has a
word of its own as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.chips.dac import time_text
from edmsim.controllers.mcu.dialogue.help_texts import ALIASES, JOB, WORDS
from edmsim.controllers.mcu.dialogue.line_input import InputBuffer, skip
from edmsim.controllers.mcu.dialogue.part_program import (
    Codes,
    Entry,
    Move,
    Setting,
    at_end,
    read_code,
    read_move,
    read_number,
    read_numbers,
    read_program,
    read_setting,
    read_word,
)
from edmsim.controllers.mcu.dialogue.program_store import ProgramStore
from edmsim.controllers.mcu.dialogue.status import Status, describe, pulses
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.errors import InputError


class MachinePort(Protocol):
    """What MAIN can do to the machine. Everything that cannot be done raises `InputError` and does nothing."""

    @property
    def codes(self) -> Codes:
        """How us become codes."""

    def status(self) -> Status:
        """What the machine shows."""

    def set_position(self, position: tuple[int, int]) -> None:
        """Set the position counters."""

    def set(self, setting: Setting) -> None:
        """Take over codes and speed."""

    def cut(self, program: Sequence[Entry]) -> None:
        """Start timers and machine along a path."""

    def go_on(self) -> None:
        """Go on with the cut that was stopped."""

    def jog(self, axis: int, way: int) -> None:
        """Move an axis with the generator off."""

    def stop(self) -> None:
        """Stop timers and generator."""

    def generator(self, on: bool) -> None:
        """Run or stop the generator."""

    def emergency(self) -> None:
        """Stop everything."""

    def init(self) -> None:
        """Make the machine safe and ready: INIT."""

    def thread_wire(self) -> None:
        """Thread a new wire."""

    def tension(self, low: bool) -> None:
        """Lower the wire's tension, or give it back in full."""

    def press(self, names: str) -> None:
        """Press keys of the front panel, one after the other."""


class Desk(Protocol):
    """What MAIN can do to the session."""

    def wait(self, seconds: int | None) -> None:
        """Take no further line until some machine time has passed, or the machine stands still."""

    def host_lines(self) -> Iterable[bytes]:
        """Lines the host sends, in capitals."""

    def monitor(self) -> None:
        """Let the monitor take what is typed next; the machine goes on."""

    def leave(self) -> None:
        """End the session."""


_QUESTIONS = ("POSITION X Y", "NEW POSITION X Y", "t(i) us", "t(p) us", "CUTTING SPEED", "START (YES OR NO)")
_POSITION, _NEW, _T_I, _T_P, _SPEED, _START = range(6)


class MainProgram:
    """The dialogue: one line at a time, from the input buffer.

    Parameters
    ----------
    machine : MachinePort
    desk : Desk
    say : callable
        Prints a text of one or more lines.
    memory : Bus
        Where the new position and the program from the host lie.
    """

    def __init__(self, machine: MachinePort, desk: Desk, say: Callable[[str], None], memory: Bus) -> None:
        self._machine = machine
        self._desk = desk
        self._say = say
        self._question: int | None = None
        self._t_i: int | None = None
        self._new_place = ProgramStore(memory, at.NEW, 1)
        self._program = ProgramStore(memory, at.PROGRAM, at.PROGRAM_ENTRIES)
        self._words: dict[str, Callable[[InputBuffer], None]] = {
            "HELP": self._help, "?": self._help, "STATUS": self._status, "POS": self._pos, "NEW": self._new,
            "CW": self._new, "CCW": self._new, "TI": self._set, "TP": self._set, "SPEED": self._set,
            "START": self._start, "X": self._jog, "Y": self._jog, "GEN": self._gen, "WAIT": self._wait,
            "MAIN": self._main, "LOAD": self._load, "LIST": self._list, "RUN": self._run,
            "TENSION": self._tension, "KEY": lambda buffer: machine.press(buffer.rest.decode("ascii")),
            "STOP": self._plain(machine.stop), "GO": self._plain(machine.go_on), "EM": self._plain(machine.emergency),
            "INIT": self._plain(machine.init), "WIRE": self._plain(machine.thread_wire),
            "MON": self._plain(desk.monitor),
            "BYE": self._plain(desk.leave),
        }  # fmt: skip
        self._word = ""

    @property
    def words(self) -> tuple[str, ...]:
        """Every word there is."""
        return tuple(self._words)

    @property
    def target(self) -> Move | None:
        """The new position; None while none was given, or what stands there was altered to none."""
        try:
            found = self._new_place.read()
        except InputError:
            return None
        return found[0] if found and isinstance(found[0], Move) else None

    @property
    def prompt(self) -> str:
        """What stands before the operator's line."""
        if self._question is None:
            return "> "
        shown = self._shown(self._question)
        return f"{_QUESTIONS[self._question]}{f' ({shown})' if shown else ''} ? "

    def obey(self, buffer: InputBuffer) -> None:
        """Do what a line says.

        Raises
        ------
        InputError
            If the line cannot be understood, or the machine cannot do it now; nothing was done.
        """
        waits = skip(buffer)
        if self._question is not None and self._answers(buffer):
            self._answer(self._question, buffer)
            return
        self._question = None
        if not waits:
            return
        self._word = read_word(buffer)
        if self._word not in self._words:
            found = self._word or buffer.rest.decode("ascii")
            raise InputError(f"{found} is no word of this machine; HELP shows them")
        self._words[self._word](buffer)

    def _plain(self, do: Callable[[], None]) -> Callable[[InputBuffer], None]:
        def word(buffer: InputBuffer) -> None:
            at_end(buffer)
            do()

        return word

    def _help(self, buffer: InputBuffer) -> None:
        word = read_word(buffer)
        at_end(buffer)
        if word and ALIASES.get(word, word) not in WORDS:
            raise InputError(f"there is no help on {word}; there is on {' '.join(WORDS)}")
        self._say(WORDS[ALIASES.get(word, word)] if word else JOB)

    def _status(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        self._say(describe(self._machine.status(), self.target))

    def _pos(self, buffer: InputBuffer) -> None:
        if not skip(buffer):
            now = self._machine.status()
            self._say("POSITION X {} Y {} {}".format(*now.position, now.unit))
            return
        x, y = read_numbers(buffer, 2, "POS x y")
        at_end(buffer)
        self._machine.set_position((x, y))

    def _new(self, buffer: InputBuffer) -> None:
        self._new_place.write([read_move(self._word, buffer)])

    def _set(self, buffer: InputBuffer) -> None:
        self._machine.set(read_setting(self._word, buffer, self._machine.codes))
        now = self._machine.status()
        self._say(f"{pulses(now)}   SPEED {now.speed}")

    def _start(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        target = self.target
        if target is None:
            raise InputError("no new position was given; NEW x y gives one")
        self._machine.cut([target])

    def _jog(self, buffer: InputBuffer) -> None:
        axis = "XY".index(self._word)
        if not skip(buffer):
            raise InputError(f"{self._word} and a way are wanted, as in {self._word} 50 or {self._word} -200")
        sign = -1 if buffer.waiting == ord("-") else 1
        if buffer.waiting in b"+-":
            buffer.advance()
        way = sign * read_number(buffer)
        at_end(buffer)
        self._machine.jog(axis, way)

    def _gen(self, buffer: InputBuffer) -> None:
        word = read_word(buffer)
        at_end(buffer)
        if word not in ("ON", "OFF"):
            raise InputError("GEN ON or GEN OFF is wanted")
        self._machine.generator(word == "ON")

    def _tension(self, buffer: InputBuffer) -> None:
        word = read_word(buffer)
        at_end(buffer)
        if word not in ("LOW", "FULL"):
            raise InputError("TENSION LOW or TENSION FULL is wanted")
        self._machine.tension(word == "LOW")

    def _wait(self, buffer: InputBuffer) -> None:
        seconds = read_number(buffer) if skip(buffer) else None
        at_end(buffer)
        self._desk.wait(seconds)

    def _load(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        program = read_program(self._desk.host_lines(), self._machine.codes)
        self._program.write(program)
        moves = sum(isinstance(entry, Move) for entry in program)
        self._say(f"LOADED: {moves} MOVES, {len(program) - moves} SETTINGS")

    def _list(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        program = self._program.read()
        self._say("\n".join(map(str, program)) if program else "NO PROGRAM")

    def _run(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        program = self._program.read()
        if not program:
            raise InputError("there is no program; LOAD takes one from the host")
        self._machine.cut(program)

    def _main(self, buffer: InputBuffer) -> None:
        at_end(buffer)
        self._question = _POSITION

    def _shown(self, question: int) -> str:
        """Value that an empty line keeps."""
        now = self._machine.status()
        if question == _NEW:
            return "" if self.target is None else str(self.target).removeprefix("NEW ")
        return {
            _POSITION: "{} {}".format(*now.position),
            _T_I: time_text(now.t_i_us) if now.t_i else "",
            _T_P: time_text(now.t_p_us) if now.t_p else "",
            _SPEED: str(now.speed),
            _START: "",
        }[question]

    def _answers(self, buffer: InputBuffer) -> bool:
        """Whether a line answers the question; a word ends the questions instead, but for yes and no."""
        if self._question == _START:
            return buffer.rest.strip() in (b"Y", b"YES", b"N", b"NO")
        return not chr(buffer.waiting).isalpha()

    def _answer(self, question: int, buffer: InputBuffer) -> None:
        if question == _START:
            self._question = None
            if buffer.waiting == ord("Y"):
                self._start(InputBuffer())
            return
        if skip(buffer):
            self._take(question, buffer)
        elif question == _T_I:
            self._t_i = None
        elif question == _T_P and self._t_i is not None:
            self._set_pulses(None)
        self._question = question + 1

    def _take(self, question: int, buffer: InputBuffer) -> None:
        """Take an answer over; t(i) waits for t(p), as the two may not be set independently (row T-34)."""
        codes = self._machine.codes
        if question == _T_I:
            t_i = read_code(buffer, codes.of_t_i, "t(i) in us")
            at_end(buffer)
            self._t_i = t_i
        elif question == _T_P:
            t_p = read_code(buffer, codes.of_t_p, "t(p) in us")
            at_end(buffer)
            self._set_pulses(t_p)
        elif question == _SPEED:
            self._machine.set(read_setting("SPEED", buffer, codes))
        elif question == _NEW:
            self._new_place.write([read_move("NEW", buffer)])
        else:
            self._pos(buffer)

    def _set_pulses(self, t_p: int | None) -> None:
        """Set both; a pair that is refused is asked for again."""
        try:
            self._machine.set(Setting(self._t_i, t_p))
        except InputError:
            self._question = _T_I
            raise
