"""MAIN: the operator's dialogue (5.1, row T-52).

The document's MAIN gets position, new position, t(i), t(p) and cutting speed, and then starts timers and machine; its
dialogue did not exist yet in 1982 (5.1.2). The words are ours: MAIN asks for these values as in the document, and
each value also has a word.
"""

from collections.abc import Callable, Iterable
from typing import Protocol

from edmsim.consoles.computer_1982 import words
from edmsim.consoles.computer_1982.line_input import InputBuffer, skip
from edmsim.consoles.computer_1982.operation import Operation, read_keys
from edmsim.consoles.computer_1982.words import Move, ProgramStore, Setting
from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.chips.dac import time_text
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.errors import InputError


class Desk(Protocol):
    """Actions of the session that MAIN can request."""

    def wait(self, seconds: int | None) -> None:
        """Accept no line for some machine time or, for None, until the machine does not move."""

    def host_lines(self) -> Iterable[bytes]:
        """Lines that the host sends, in capitals."""

    def monitor(self) -> None:
        """Pass the next characters to the monitor; the machine continues."""

    def leave(self) -> None:
        """End the session."""


_QUESTIONS = ("POSITION X Y", "NEW POSITION X Y", "t(i) us", "t(p) us", "CUTTING SPEED", "START (YES OR NO)")
_POSITION, _NEW, _T_I, _T_P, _SPEED, _START = range(6)


def _alone(do: Callable[[], None]) -> Callable[[InputBuffer], None]:
    """Return the handler of a word without arguments."""

    def word(buffer: InputBuffer) -> None:
        words.at_end(buffer)
        do()

    return word


def _switched(word: str, on: str, off: str, buffer: InputBuffer) -> bool:
    """Read one of two words and the end of the line; True if it is `on`."""
    found = words.read_word(buffer)
    words.at_end(buffer)
    if found not in (on, off):
        raise InputError(f"{word} {on} or {word} {off} is expected")
    return found == on


class MainProgram:
    """The dialogue: one line at a time, from the input buffer."""

    def __init__(self, machine: Operation, desk: Desk, say: Callable[[str], None], memory: Bus) -> None:
        self._machine = machine
        self._desk = desk
        self._say = say
        self._question: int | None = None
        self._t_i: int | None = None
        self._new_place = ProgramStore(memory, at.NEW, 1)
        self._program = ProgramStore(memory, at.PROGRAM, at.PROGRAM_ENTRIES)
        self._words: dict[str, Callable[[InputBuffer], None]] = {
            "HELP": self._help, "?": self._help, "STATUS": _alone(self._status), "POS": self._pos, "NEW": self._new,
            "CW": self._new, "CCW": self._new, "TI": self._set, "TP": self._set, "SPEED": self._set,
            "START": _alone(self._start), "X": self._jog, "Y": self._jog, "WAIT": self._wait,
            "GEN": lambda buffer: machine.generator(_switched("GEN", "ON", "OFF", buffer)),
            "TENSION": lambda buffer: machine.tension(_switched("TENSION", "LOW", "FULL", buffer)),
            "KEY": lambda buffer: machine.press(read_keys(buffer.rest.decode("ascii"))),
            "MAIN": _alone(self._main), "LOAD": _alone(self._load), "LIST": _alone(self._list),
            "RUN": _alone(self._run), "STOP": _alone(machine.stop), "GO": _alone(machine.go_on),
            "EM": _alone(machine.emergency), "INIT": _alone(machine.init), "WIRE": _alone(machine.thread_wire),
            "MON": _alone(desk.monitor), "BYE": _alone(desk.leave),
        }  # fmt: skip
        self._word = ""

    @property
    def words(self) -> tuple[str, ...]:
        """All words."""
        return tuple(self._words)

    @property
    def target(self) -> Move | None:
        """The new position; None if none was entered, or the monitor changed its bytes to something else."""
        try:
            found = self._new_place.read()
        except InputError:
            return None
        return found[0] if found and isinstance(found[0], Move) else None

    @property
    def prompt(self) -> str:
        """Prompt of the operator's line."""
        if self._question is None:
            return "> "
        shown = self._shown(self._question)
        return f"{_QUESTIONS[self._question]}{f' ({shown})' if shown else ''} ? "

    def obey(self, buffer: InputBuffer) -> None:
        """Execute a line; after an error, nothing was changed."""
        waits = skip(buffer)
        if self._question is not None and self._answers(buffer):
            self._answer(self._question, buffer)
            return
        self._question = None
        if not waits:
            return
        self._word = words.read_word(buffer)
        if self._word not in self._words:
            found = self._word or buffer.rest.decode("ascii")
            raise InputError(f"{found} is not a word of this machine; HELP shows them")
        self._words[self._word](buffer)

    def _help(self, buffer: InputBuffer) -> None:
        word = words.read_word(buffer)
        words.at_end(buffer)
        if word and words.ALIASES.get(word, word) not in words.WORDS:
            raise InputError(f"there is no help on {word}; there is on {' '.join(words.WORDS)}")
        self._say(words.WORDS[words.ALIASES.get(word, word)] if word else words.JOB)

    def _status(self) -> None:
        self._say(words.describe(self._machine.status(), self.target))

    def _pos(self, buffer: InputBuffer) -> None:
        if not skip(buffer):
            now = self._machine.status()
            self._say("POSITION X {} Y {} {}".format(*now.position, now.unit))
            return
        x, y = words.read_numbers(buffer, 2, "POS x y")
        words.at_end(buffer)
        self._machine.set_position((x, y))

    def _new(self, buffer: InputBuffer) -> None:
        self._new_place.write([words.read_move(self._word, buffer)])

    def _set(self, buffer: InputBuffer) -> None:
        self._machine.set(words.read_setting(self._word, buffer, self._machine.pulse_settings))
        now = self._machine.status()
        self._say(f"{words.pulses(now)}   SPEED {now.speed}")

    def _start(self) -> None:
        target = self.target
        if target is None:
            raise InputError("no new position was given; NEW x y gives one")
        self._machine.cut([target])

    def _jog(self, buffer: InputBuffer) -> None:
        axis = "XY".index(self._word)
        if not skip(buffer):
            raise InputError(f"{self._word} and a distance are expected, as in {self._word} 50 or {self._word} -200")
        sign = -1 if buffer.waiting == ord("-") else 1
        if buffer.waiting in b"+-":
            buffer.advance()
        distance = sign * words.read_number(buffer)
        words.at_end(buffer)
        self._machine.jog(axis, distance)

    def _wait(self, buffer: InputBuffer) -> None:
        seconds = words.read_number(buffer) if skip(buffer) else None
        words.at_end(buffer)
        self._desk.wait(seconds)

    def _load(self) -> None:
        program = words.read_program(self._desk.host_lines(), self._machine.pulse_settings)
        self._program.write(program)
        moves = sum(isinstance(entry, Move) for entry in program)
        self._say(f"LOADED: {moves} MOVES, {len(program) - moves} SETTINGS")

    def _list(self) -> None:
        program = self._program.read()
        self._say("\n".join(map(str, program)) if program else "NO PROGRAM")

    def _run(self) -> None:
        program = self._program.read()
        if not program:
            raise InputError("there is no program; LOAD takes one from the host")
        self._machine.cut(program)

    def _main(self) -> None:
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
        """Whether a line answers the question; a word other than yes or no ends the questions instead."""
        if self._question == _START:
            return buffer.rest.strip() in (b"Y", b"YES", b"N", b"NO")
        if self._question in (_T_I, _T_P) and words.is_code(words.until_separator(buffer.rest)):
            return True
        return not chr(buffer.waiting).isalpha()

    def _answer(self, question: int, buffer: InputBuffer) -> None:
        if question == _START:
            self._question = None
            if buffer.waiting == ord("Y"):
                self._start()
            return
        if skip(buffer):
            self._take(question, buffer)
        elif question == _T_I:
            self._t_i = None
        elif question == _T_P and self._t_i is not None:
            self._set_pulses(None)
        self._question = question + 1

    def _take(self, question: int, buffer: InputBuffer) -> None:
        """Use an answer; t(i) is set together with t(p), because they may not be set independently (row T-34)."""
        pulse_settings = self._machine.pulse_settings
        if question == _T_I:
            t_i = words.read_code(buffer, pulse_settings.code_of_t_i, "t(i) in us")
            words.at_end(buffer)
            self._t_i = t_i
        elif question == _T_P:
            t_p = words.read_code(buffer, pulse_settings.code_of_t_p, "t(p) in us")
            words.at_end(buffer)
            self._set_pulses(t_p)
        elif question == _SPEED:
            self._machine.set(words.read_setting("SPEED", buffer, pulse_settings))
        elif question == _NEW:
            self._new_place.write([words.read_move("NEW", buffer)])
        else:
            self._pos(buffer)

    def _set_pulses(self, t_p: int | None) -> None:
        """Set t(i) and t(p); after an invalid pair, MAIN asks for both again."""
        try:
            self._machine.set(Setting(self._t_i, t_p))
        except InputError:
            self._question = _T_I
            raise
