"""Execution of blocks as in a control: modal state, cutting motions, and the meaning of arcs.

I J are relative to an arc's start, as usual, or coordinates; an arc whose ends meet may be a full circle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

from edmsim.errors import InputError
from edmsim.program import arcs
from edmsim.program.arcs import Rounding
from edmsim.program.blocks import BELONGS, IDLE_CODES, INCH_MM, UNITS, Block, Units
from edmsim.program.dialects import ISO, Action, Dialect
from edmsim.program.limits import LONGEST_DWELL_S
from edmsim.program.outline import InForce, Side
from edmsim.program.tables import Offset, OffsetRegisters, register


@dataclass(frozen=True)
class Arc:
    """The arc of a G2 or G3 block."""

    turn: int  # +1 counter-clockwise (G3), -1 clockwise (G2)
    relative: complex  # centre ``x + 1j * y`` in mm if I J are relative to the start, or the one found from R
    absolute: complex | None  # centre if I J are coordinates; None if the block does not have both
    absolute_stated: bool | None = None  # True after G90.1, False after G91.1, None without either
    by_radius: bool = False  # whether the block has R, so that there is one reading


@dataclass(frozen=True)
class UpperMotion:
    """The motion of the second plane that goes with a cutting motion."""

    start: complex  # start, end: ``x + 1j * y`` in mm
    end: complex
    turn: int = 0  # +1 counter-clockwise, -1 clockwise, 0 straight
    centre: complex | None = None  # centre of its arc; None if relative to the lower centre
    from_lower: complex = 0j  # vector from the lower arc's centre to its own

    def points(self, chords: int, lower_centre: complex | None, full: bool) -> list[complex]:
        """Return its points after the start, in at least `chords` chords."""
        centre = self.centre
        if centre is None and lower_centre is not None:
            centre = lower_centre + self.from_lower
        if self.turn == 0 or centre is None:
            return arcs.line_points(self.start, self.end, chords)
        first, last = arcs.radii(self.start, self.end, centre)
        if abs(first - last) > arcs.RADIUS_TOLERANCE_MM:
            reason = f"start radius {first:.4f} and end radius {last:.4f} mm"
            raise InputError(f"the arc's radii disagree in the second plane: {reason}; correct its centre or its end")
        if min(first, last) <= arcs.SAME_PLACE_MM:  # the tip of a cone
            return arcs.line_points(self.start, self.end, chords)
        return arcs.arc_points(self.start, self.end, centre, self.turn, full, chords)


@dataclass(frozen=True)
class CuttingMotion:
    """One cutting motion from ``start`` to ``end`` (``x + 1j * y`` in mm); straight if ``arc`` is None."""

    start: complex
    end: complex
    side: Side | None
    line: int
    arc: Arc | None
    offset: Offset | None = None
    state: InForce = field(default_factory=InForce)
    upper: UpperMotion | None = None

    def ends_meet(self, rounding: Rounding) -> bool:
        """Whether start and end are one point, so that the radii agree for any far centre."""
        return abs(self.end - self.start) <= rounding.join_mm

    def fits(self, rounding: Rounding) -> tuple[bool, bool]:
        """Whether the radii agree for the relative and for the absolute centre; False for an excluded one."""
        arc = self.arc
        if arc is None or arc.by_radius:
            return arc is not None, False
        relative = arc.absolute_stated is not True and self._agree(arc.relative, rounding)
        if arc.absolute is None or arc.absolute_stated is False:
            return relative, False
        return relative, self._agree(arc.absolute, rounding)

    def _agree(self, centre: complex, rounding: Rounding) -> bool:
        first, last = arcs.radii(self.start, self.end, centre)
        return abs(first - last) <= rounding.radius_mm and min(first, last) > arcs.SAME_PLACE_MM


@dataclass(frozen=True)
class Reading:
    """Interpretation of a motion."""

    motion: CuttingMotion
    centre: complex | None = None  # centre of the arc; None if the motion goes straight to its end
    # whether it is a full circle; None if its ends almost meet, so that it may also be the short arc between them
    full: bool | None = False
    notices: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether anything is cut: an arc without a radius whose ends are equal does not move."""
        motion, upper = self.motion, self.motion.upper
        if upper is not None and abs(upper.end - upper.start) > arcs.SAME_PLACE_MM:
            return True
        return self.centre is not None or motion.arc is None or abs(motion.end - motion.start) > arcs.SAME_PLACE_MM

    def _lower(self, chords: int) -> list[complex]:
        motion = self.motion
        if motion.arc is None or self.centre is None:
            return arcs.line_points(motion.start, motion.end, chords)
        return arcs.arc_points(motion.start, motion.end, self.centre, motion.arc.turn, bool(self.full), chords)

    @property
    def planes(self) -> tuple[tuple[complex, ...], tuple[complex, ...]]:
        """Points after the start in both planes, equal in number; none in the second plane if it has no move."""
        upper, points = self.motion.upper, self._lower(1)
        if upper is None:
            return tuple(points), ()
        above = upper.points(len(points), self.centre, bool(self.full))
        return tuple(self._lower(len(above))), tuple(above)

    def decided(self, full: bool) -> Self:
        """Return one of two readings, with a notice."""
        apart_um = abs(self.motion.end - self.motion.start) * 1e3
        read = "a full circle" if full else "the short arc between them"
        notice = f"the arc's ends are {apart_um:.1f} um apart: it is read as {read}"
        return replace(self, full=full, notices=(*self.notices, notice))


def prefer_absolute(motions: Sequence[CuttingMotion], rounding: Rounding) -> bool | None:
    """Decide the meaning of I J if both readings fit: that of most of the arcs that fit only one reading."""
    # arcs whose ends meet do not count, because any centre fits them; None if no arc fits only one reading
    votes = [0]
    for motion in motions:
        if motion.arc is not None and not motion.ends_meet(rounding):
            relative, absolute = motion.fits(rounding)
            if not (relative or absolute):
                raise InputError(_misfit(motion), line=motion.line)
            if motion.arc.absolute is not None and motion.arc.absolute_stated is None:
                votes.append(absolute - relative)
    return sum(votes) > 0 if any(votes) else None


def reading_of(motion: CuttingMotion, absolute: bool | None, rounding: Rounding) -> Reading:
    """Return the reading of a motion that `prefer_absolute` has not refused; `absolute` decides if both fit."""
    arc = motion.arc
    if arc is None:
        return Reading(motion)
    if arc.by_radius:
        return Reading(motion, arc.relative)
    if motion.ends_meet(rounding):
        return _reading_where_ends_meet(motion, arc, absolute, rounding)
    fits = motion.fits(rounding)
    meant = fits[1] and (bool(absolute) or not fits[0])
    notices = []
    if fits[1] and not fits[0] and arc.absolute_stated is None:
        notices.append("I J are taken as an absolute arc centre, because start and end radius agree only then")
    elif all(fits):
        notices += _both_fit(arc, meant)
    centre = arc.absolute if meant and arc.absolute is not None else arc.relative
    first, last = arcs.radii(motion.start, motion.end, centre)
    if abs(first - last) > arcs.RADIUS_TOLERANCE_MM:
        apart_um = abs(first - last) * 1e3
        notices.append(f"the arc's radii differ by {apart_um:.1f} um, which the rounding of its numbers explains")
    return Reading(motion, centre, notices=tuple(notices))


def _reading_where_ends_meet(motion: CuttingMotion, arc: Arc, absolute: bool | None, rounding: Rounding) -> Reading:
    """Distinguish a full circle from an arc whose length and radius are within rounding errors."""
    stated = arc.absolute_stated
    meant = (absolute if stated is None else stated) if arc.absolute is not None else False
    equal = abs(motion.end - motion.start) <= arcs.SAME_PLACE_MM
    centre = arc.absolute if meant and arc.absolute is not None else arc.relative
    tiny = abs(centre - motion.start) <= rounding.radius_mm
    if meant is None and arc.absolute is not None and not equal:  # undecided: the tiny one is assumed
        tiny |= arcs.SAME_PLACE_MM < abs(arc.absolute - motion.start) <= rounding.radius_mm
    if tiny:
        return Reading(motion, notices=("an arc without a radius is left out",) * equal)
    reading = Reading(motion, centre, True, tuple(_both_fit(arc, bool(meant)) if stated is None else ()))
    if equal:
        return reading
    if arcs.sweep_of(motion.start, motion.end, centre, arc.turn) > math.pi:
        return reading.decided(True)
    return replace(reading, full=None)


def _both_fit(arc: Arc, absolute: bool) -> list[str]:
    if arc.absolute is None or abs(arc.relative - arc.absolute) <= arcs.SAME_PLACE_MM:
        return []
    meant = "absolute" if absolute else "relative"
    return [f"I J fit both as relative and as absolute centre: taken as {meant}"]


def _misfit(motion: CuttingMotion) -> str:
    def radii_about(centre: complex) -> str:
        return "start radius {:.4f} and end radius {:.4f} mm".format(*arcs.radii(motion.start, motion.end, centre))

    arc = motion.arc
    assert arc is not None
    readings = []
    if arc.absolute_stated is not True:
        readings.append(f"with I J relative {radii_about(arc.relative)}")
    if arc.absolute is not None and arc.absolute_stated is not False:
        readings.append(f"{'' if readings else 'with I J '}absolute {radii_about(arc.absolute)}")
    return f"the arc's radii disagree: {', '.join(readings)}; correct I, J or the end point"


_UNIT_NAMES: dict[float, str] = {70: "inch", 71: "mm"}
_STOPS = frozenset({("M", 0), ("M", 1)})
_GROUPS = (
    ({0, 1, 2, 3}, "G0 G1 G2 G3"), ({20, 21, *UNITS}, "G20 G21 G70 G71"), ({40, 41, 42}, "G40 G41 G42"),
    ({90, 91}, "G90 G91"), ({90.1, 91.1}, "G90.1 G91.1"), ({4, 10, 92}, "G4 G10 G92"),
    ({50, 51, 52}, "G50 G51 G52"), ({40, 41, 42, 140, 141, 142}, "G140 G141 G142"),
)
_WORK_OFFSETS = frozenset({*range(54, 60), 59.1, 59.2, 59.3})
_SAID_OTHERWISE = frozenset({("G", 17), ("M", 50), ("M", 60), *(("G", code) for code in _WORK_OFFSETS)})
_SIDES: dict[float, Side | None] = {40: None, 41: "left", 42: "right", 140: None, 141: "left", 142: "right"}
_LEANS: dict[Action, int] = {"no taper": 0, "taper left": 1, "taper right": -1}
_BOTH_SIDES: dict[Action, int | None] = {"two planes off": None, "two planes left": 141, "two planes right": 142}
_LONG_DWELL_S = 100.0  # from here on a dwell may be meant in ms (ours)
_STEEPEST_DEG = 60.0  # greatest angle of a taper (ours: no guides allow more)
_LENGTHS = frozenset("XYIJRUVK")
_ALSO = frozenset("FDH")
_G10_REGISTERS = {None: "DH", 10.0: "H", 12.0: "D"}
_TAKEN_BY = {"P": "G4, G10, G64 or M98", "L": "G10 or M98", "Q": "G64"}
_FEED_UNITS = {1.0: "mm/min", 0.001: "um/min", INCH_MM: "in/min"}


class Notices:
    """Notices grouped by text, each with its first line."""

    def __init__(self) -> None:
        self._lines: dict[str, list[int]] = {}

    def add(self, what: str, line: int) -> None:
        """Add a notice about a line."""
        self._lines.setdefault(what, []).append(line)

    def texts(self) -> list[str]:
        """Return one text for each kind."""
        return [f"line {lines[0]}: {what}" + (f" ({len(lines)} times)" if len(lines) > 1 else "")
                for what, lines in self._lines.items()]


@dataclass
class Motions:
    """Motions without a break, dwells ``(motions done, seconds)``, stops, and the side in force at the start."""

    side_at_start: Side | None
    motions: list[CuttingMotion] = field(default_factory=list)
    dwells: list[tuple[int, float]] = field(default_factory=list)
    stops: list[int] = field(default_factory=list)


@dataclass
class Interpreter:
    """The modal state of a control, and the runs found so far."""

    units: Units
    rounding: Rounding
    registers: OffsetRegisters
    dialect: Dialect = ISO
    two_planes: bool = False  # whether the program has moves of a second plane

    unit_mm: float = field(init=False)
    unit_stated: bool = False
    absolute: bool = True  # whether coordinates are absolute (G90)
    absolute_centres: bool | None = None  # whether I J are absolute; None if the program does not say
    motion: int | None = None  # number of the motion code in force, 0 to 3
    position: complex = 0j  # of the wire, ``x + 1j * y`` in mm
    upper: complex = 0j  # position in the second plane
    shift: complex = 0j  # displacement of the zero by G92
    moved: bool = False
    start_known: bool = False
    work_offset: float | None = None
    side: Side | None = None  # of compensation
    both_sides: int | None = None  # number of the code in force for two planes
    lean: int = 0  # side to which the wire leans: 1 left, -1 right
    early_angle: str = ""  # the T word before G51 or G52
    angle_stated: bool = False
    angle_deg: float = 0.0
    state: InForce = field(default_factory=InForce)
    called: dict[str, int] = field(default_factory=dict)  # conditions, with the line of the first call
    cut_off: int | None = None  # line on which the wire was cut off; None while it is threaded
    feed_per_minute: bool = True
    notices: Notices = field(default_factory=Notices)
    runs: list[Motions] = field(default_factory=lambda: [Motions(None)])

    def __post_init__(self) -> None:
        self.unit_mm = self.units.at_start_mm

    def _begin_contour(self) -> None:
        """Begin a new contour with the next motion."""
        if self.runs[-1].motions:
            self.runs.append(Motions(self.side))

    def run_block(self, block: Block) -> None:
        """Execute a block; raises `InputError` if it is invalid."""
        if block.deletable:
            self.notices.add("'/' (block delete) is switched off: the block is carried out", block.line)
        g_codes = self._checked_codes(block)
        block = replace(block, values=_without_words_of_codes(block.values, g_codes))
        block = self._take_dialect(block)
        for code in g_codes:
            if code in UNITS:
                self.notices.add(f"G{code} is read as G{UNITS[code]} ({_UNIT_NAMES[code]})", block.line)
            self._set_mode(UNITS.get(code, code))
        self._check_unit(block)
        self._note_words(block)
        if 4 in g_codes:
            self._dwell(block)
        elif 10 in g_codes:
            self._set_register(block)
        elif 92 in g_codes:
            self._set_position(block)
        else:
            self._move(block, rapid=0 in g_codes)
        if not _STOPS.isdisjoint(block.codes):
            run = self.runs[-1 if self.runs[-1].motions or len(self.runs) == 1 else -2]  # the last one with motions
            run.stops.append(len(run.motions))
        if any(code == ("M", 50) or self.dialect.codes.get(code) == "cut off" for code in block.codes):
            # takes effect at the end of its block, as M0 and M2 do
            self.cut_off = block.line
            self._begin_contour()

    def _take_dialect(self, block: Block) -> Block:
        """Apply condition, feed, taper and planes of a block; return it without the words of the last two."""
        for code in block.codes:
            does = self.dialect.codes.get(code)
            if does in _LEANS:
                self.lean = _LEANS[does]
            elif does in _BOTH_SIDES:
                self.both_sides = _BOTH_SIDES[does]
            elif does == "conical" or does == "cylindrical":
                self.state = replace(self.state, corners=does)
            elif does == "adaptive" or does == "constant":
                self.state = replace(self.state, adaptive=does == "adaptive")
            elif does == "idle":
                self.notices.add(f"{code[0]}{code[1]} has no effect on the contour", block.line)
        if block.condition is not None:
            self.called.setdefault(block.condition, block.line)
            self.state = replace(self.state, condition=block.condition)
        values = block.values
        if "TP" in values or "TN" in values:
            lower, upper = self.state.planes_mm
            planes = values.get("TP", lower / self.unit_mm) * self.unit_mm, (
                values["TN"] * self.unit_mm if "TN" in values else upper
            )
            if planes[0] == planes[1]:
                raise InputError(f"TP and TN are both {planes[0]:g} mm: two planes have two heights")
            self.state = replace(self.state, planes_mm=planes)
        self._take_angle(block)
        taken = {"TP", "TN", self.dialect.angle}
        return replace(block, values={word: value for word, value in values.items() if word not in taken})

    def _take_angle(self, block: Block) -> None:
        letter = self.dialect.angle
        angle = block.values.get(letter) if letter else None
        if angle is not None and self.lean == 0 and not self.dialect.signed_angle:
            if letter == "T" and angle != 0:  # T of a tank or a tool
                self.notices.add("the word T has no effect on the contour", block.line)
                self.early_angle = f"T{angle:g} of line {block.line}"
                angle = None
            elif angle != 0:
                raise InputError(f"{letter}{angle:g} is given without G51 or G52: they say to which side")
        if angle is not None:
            if abs(angle) > _STEEPEST_DEG or (angle < 0 and self.lean != 0):
                least = f"{-_STEEPEST_DEG:g}" if self.lean == 0 else "0"
                between = f"{least} to {_STEEPEST_DEG:g} degrees"
                raise InputError(f"the taper angle {letter}{angle:g} is out of range: give {between}")
            self.angle_deg, self.angle_stated = angle, True
        if any(self.dialect.codes.get(code) == "no taper" for code in block.codes):
            self.angle_deg, self.angle_stated = 0.0, False
        if self.early_angle and self.lean:
            if self.angle_deg == 0:
                self.notices.add(f"the taper has no angle: write {self.early_angle} after G51 or G52", block.line)
                self.angle_stated = True
            self.early_angle = ""
        leans = self.lean or (1 if self.dialect.signed_angle else 0)
        self.state = replace(self.state, tilt_deg=leans * self.angle_deg + 0.0)  # no -0

    def _checked_codes(self, block: Block) -> set[float]:
        for letter, number in block.codes:
            if (letter, number) in IDLE_CODES - _SAID_OTHERWISE and (letter, number) not in self.dialect.codes:
                self.notices.add(f"{letter}{number} has no effect on the contour", block.line)
            elif (letter, number) in _STOPS:
                self.notices.add(f"M{number} (stop) is not waited for", block.line)
        self._thread(block)
        codes = {number for letter, number in block.codes if letter == "G"}
        for group, names in _GROUPS:
            if len(codes & group) > 1:
                raise InputError(f"two of {names} stand in one block: they exclude each other")
        for code in codes & _WORK_OFFSETS:
            self._take_work_offset(code, block)
        return codes

    def _thread(self, block: Block) -> None:
        """Add notices of M50 and M60, and thread the wire; if it is cut off, it cuts nothing until it is threaded."""
        for code, action, done in ((50, "cut off", "cuts the wire off"), (60, "thread", "threads the wire")):
            for letter, number in block.codes:
                if (letter, number) == ("M", code) or self.dialect.codes.get((letter, number)) == action:
                    self.notices.add(f"{letter}{number} ({done}) is not waited for: G0 does both", block.line)
                    if action == "thread":
                        self.cut_off = None
                        self._begin_contour()

    def _take_work_offset(self, code: float, block: Block) -> None:
        if self.work_offset not in (None, code):
            pair = f"G{self.work_offset} and G{code}"
            raise InputError(f"work offsets {pair}: how far they are apart is not in the program, use one")
        self.work_offset = code
        self.notices.add(f"the zero of G{code} is taken as the program's zero", block.line)

    def _set_mode(self, code: float) -> None:
        if code in (0, 1, 2, 3):
            self.motion = int(code)
        elif (unit_mm := self.units.of_code_mm(code)) is not None:
            self.unit_mm = unit_mm
            self.unit_stated = True
        elif code in _SIDES:
            self.side = _SIDES[code]
        elif code in (90, 91):
            self.absolute = code == 90
        elif code in (90.1, 91.1):
            self.absolute_centres = code == 90.1
        elif code in (93, 94, 95):
            self.feed_per_minute = code == 94

    def _check_unit(self, block: Block) -> None:
        """Add a notice of the unit of a length before any unit; refuse the length if the program has both units."""
        registers = block.offsets and not self.dialect.registers_in_um
        length = registers or (block.values.keys() & _LENGTHS and ("G", 4) not in block.codes)
        if self.unit_stated or not length:
            return
        if len(self.units.stated) > 1:
            reason = "a length comes before its unit, and the program has G20 and G21: write one of them before it"
            raise InputError(reason)
        if self.units.only_inches:
            self.notices.add("lengths before G20 are read in inches, the program's only unit", block.line)

    def _note_words(self, block: Block) -> None:
        for word in block.ignored:
            self.notices.add(f"{word} is left out", block.line)
        for word in block.idle:
            self.notices.add(f"the word {word.rstrip('+-.0123456789')} has no effect on the contour", block.line)
        if "F" in block.values:
            unit_mm = self.unit_mm * (1000 if self.units.scaled else 1)
            unit = f" {_FEED_UNITS[round(unit_mm, 9)]}" if self.feed_per_minute else ""
            feed = f"feed F{block.values['F']:g}{unit}"
            self.notices.add(f"{feed} is not used: the gap controller sets the speed", block.line)
        for value in block.offsets:  # as H1=.0085+H175
            offset_mm = value.number * (1e-3 if self.dialect.registers_in_um else self.unit_mm)
            for factor, name in value.added:
                offset_mm += factor * self.registers.value_of(name, value.register)
            self.registers.define(value.register, offset_mm)
        called = [register(letter, block.values[letter]) for letter in "DH" if letter in block.values]
        for notice in self.registers.call(called):
            self.notices.add(notice, block.line)

    def _dwell(self, block: Block) -> None:
        times = [block.values[letter] for letter in "PX" if letter in block.values]
        if self.dialect.dwells_in_ms and ("P" in block.values or not block.pointed):
            times = [time / 1e3 for time in times]
        if len(times) != 1 or times[0] < 0 or not block.values.keys() <= {"P", "X", *_ALSO}:
            raise InputError("G4 needs its time in seconds, 0 or more, as P or X and nothing else")
        if times[0] > LONGEST_DWELL_S:
            raise InputError(f"a dwell of {times[0]:g} s is too long: at most {LONGEST_DWELL_S:g} s")
        if times[0] >= _LONG_DWELL_S:
            self.notices.add(f"a dwell of {times[0]:g} s: P and X are seconds here", block.line)
        self.runs[-1].dwells.append((len(self.runs[-1].motions), times[0]))

    def _set_register(self, block: Block) -> None:
        """Set registers as in G10 L12 P1 R0.155: D1 with L12, H1 with L10, both without L."""
        values = block.values
        letters = _G10_REGISTERS.get(values.get("L"))
        if letters is None:
            word = f"G10 L{values['L']:g}"
            raise InputError(f"{word} is not read: set offsets with L10 (H), L12 (D) or without L")
        if not {"P", "R"} <= values.keys() <= {"L", "P", "R", *_ALSO} or not values["P"].is_integer():
            raise InputError("G10 needs the register's number as P and its offset as R: G10 L12 P1 R0.155")
        for letter in letters:
            self.registers.define(register(letter, values["P"]), values["R"] * self.unit_mm)

    def _set_position(self, block: Block) -> None:
        four = self.dialect.upper in ("relative", "absolute")
        if not block.values.keys() <= {"X", "Y", *("UV" if four else ""), *_ALSO}:
            raise InputError(f"G92 takes X {'Y U and V' if four else 'and Y'} only")
        bare = not block.values.keys() & {"X", "Y"}
        between = self.upper - self.position
        programmed = 0j if bare else self._target(block.values, self.position - self.shift, absolute=True)
        if self.moved:
            self.shift = self.position - programmed
            if bare:
                self.notices.add("G92 without words: the present position becomes X0 Y0", block.line)
        else:
            self.position = programmed
            self.start_known = True
        self._set_upper_position(block, between)

    def _set_upper_position(self, block: Block, between: complex) -> None:
        """Apply U and V of G92; `between` is the vector to the previous position in the second plane."""
        words = _words_of_upper(block)
        if self.moved and self.two_planes and self.dialect.upper != "colon":
            raise InputError("G92 after the first move is not read in a program with U and V: write coordinates that "
                             "count from one place")
        if self.dialect.upper == "absolute":
            self.upper = self._target(words, self.upper, absolute=True)
        else:
            self.upper = self.position + self._target(words, between, absolute=True)

    def _target(self, values: dict[str, float], here: complex, absolute: bool) -> complex:
        x, y = (values[axis] * self.unit_mm if axis in values else None for axis in "XY")
        base = here if not absolute else 0j
        return complex(here.real if x is None else base.real + x, here.imag if y is None else base.imag + y)

    def _move(self, block: Block, rapid: bool) -> None:
        axes = block.values.keys() & _LENGTHS or block.upper is not None
        self._refuse_stray_words(block)
        if self.motion == 0 and (axes or rapid):
            self.start_known = True
            self.cut_off = None
            self._begin_contour()
            self.runs[-1].side_at_start = self.side
        if not axes:
            return
        if self.motion is None:
            raise InputError("coordinates come before any of G0 G1 G2 G3: say how to move")
        end = self._target(block.values, self.position - self.shift, self.absolute) + self.shift
        above = self._upper_target(block, end) if self.two_planes else end
        moves = abs(end - self.position) > arcs.SAME_PLACE_MM or abs(above - self.upper) > arcs.SAME_PLACE_MM
        if self.motion in (2, 3) or (self.motion == 1 and moves):
            self._cut(block, end, above)
        self.position, self.upper = end, above
        self.moved = True

    def _upper_target(self, block: Block, end: complex) -> complex:
        """Return the target of a block in the second plane; `end` is that in the first plane."""
        kind = self.dialect.upper
        if kind == "colon":
            words = None if block.upper is None else block.upper.values
            return end if words is None else self._target(words, self.upper - self.shift, self.absolute) + self.shift
        words = _words_of_upper(block)
        if kind == "absolute":
            return self._target(words, self.upper - self.shift, self.absolute) + self.shift
        return end + self._target(words, self.upper - self.position, self.absolute)

    def _refuse_stray_words(self, block: Block) -> None:
        words = block.values.keys()
        for letter, codes in _TAKEN_BY.items():
            if letter in words and not (letter == "L" and "K" in self.dialect.letters and self.motion in (2, 3)):
                word = f"{letter}{block.values[letter]:g}"
                raise InputError(f"{word} is given without {codes}: nothing else takes it")
        if self.motion not in (2, 3) and "K" in words:
            raise InputError("K is given without G2 or G3: only an arc takes it")
        if self.motion not in (2, 3) and words & {"I", "J", "R"}:
            raise InputError("I, J or R is given without G2 or G3: only an arc takes them")

    def _cut(self, block: Block, end: complex, above: complex) -> None:
        if self.cut_off is not None:
            reason = f"the wire is cut off since M50 on line {self.cut_off}: go on with G0, or thread it with M60"
            raise InputError(reason)
        if self.both_sides is not None and block.upper is None:
            raise InputError(f"G{self.both_sides} leads the wire in two planes, and this block has an element below "
                             "and none above: write both, lower : upper")
        if not self.start_known:
            self.notices.add("neither G92 nor G0 before the first cut: the wire starts at X0 Y0", block.line)
            self.start_known = True
        if self.side is not None and self.registers.uncalled:
            self.notices.add("compensation without D or H: the offset is that of the cut or its passes", block.line)
        if self.lean and not self.angle_stated:
            self.notices.add("the taper has no angle: the wire is vertical", block.line)
        arc = self._arc(block, end) if self.motion in (2, 3) else None
        offset = None if self.side is None else self.registers.in_force
        upper = self._upper_motion(block, arc, above)
        self.runs[-1].motions.append(
            CuttingMotion(self.position, end, self.side, block.line, arc, offset, self.state, upper)
        )

    def _upper_motion(self, block: Block, arc: Arc | None, above: complex) -> UpperMotion | None:
        """Return the motion in the second plane; None if the block has none."""
        words, straight = block.upper, UpperMotion(self.upper, above)
        if not self.two_planes or (self.dialect.upper == "colon" and words is None):
            return None
        if words is not None:
            code = self.motion if words.code is None else words.code
            if code not in (2, 3):
                return straight
            if not words.values.keys() & {"I", "J"}:
                raise InputError("the arc after the colon needs its centre as I and J: give them")
            centre = self.upper + complex(words.values.get("I", 0.0), words.values.get("J", 0.0)) * self.unit_mm
            return replace(straight, turn=-1 if code == 2 else 1, centre=centre)
        if arc is not None and self.dialect.upper == "absolute" and block.values.keys() & {"U", "V"}:
            raise InputError("an arc with U or V is not read: LinuxCNC makes arcs in X and Y only, write G1")
        if arc is None or self.dialect.upper == "absolute":
            return straight
        between = complex(block.values.get("K", 0.0), block.values.get("L", 0.0)) * self.unit_mm
        return replace(straight, turn=arc.turn, from_lower=between)

    def _arc(self, block: Block, end: complex) -> Arc:
        turn = -1 if self.motion == 2 else 1
        values, start = block.values, self.position
        if ("R" in values) == bool(values.keys() & {"I", "J"}):
            raise InputError("an arc needs its centre as I and J, or its radius as R: give one")
        if "R" in values:
            return self._arc_of_radius(block, end, turn)
        centre, both = complex(values.get("I", 0.0), values.get("J", 0.0)) * self.unit_mm, {"I", "J"} <= values.keys()
        if self.absolute_centres and not both:
            raise InputError("G90.1 is in force: an arc needs both I and J")
        return Arc(turn, start + centre, centre + self.shift if both else None, self.absolute_centres)

    def _arc_of_radius(self, block: Block, end: complex, turn: int) -> Arc:
        start, radius = self.position, block.values["R"] * self.unit_mm
        centre = arcs.centre_from_radius(start, end, radius, turn, self.rounding.radius_mm)
        if centre is None:
            reason = f"no arc of radius R{block.values['R']:g} joins ends {abs(end - start):.4f} mm apart"
            raise InputError(f"{reason}: give I and J, or an R that does")
        return Arc(turn, centre, None, absolute_stated=False, by_radius=True)


def _without_words_of_codes(values: dict[str, float], codes: set[float]) -> dict[str, float]:
    """Remove the words that belong to codes without effect, as in G64 P0.01; an arc keeps its I and J."""
    letters = {letter for code in codes for letter in BELONGS.get(code, "")}
    if values.keys() & {"X", "Y"}:
        letters -= {"I", "J"}
    return {letter: value for letter, value in values.items() if letter not in letters}


def _words_of_upper(block: Block) -> dict[str, float]:
    """Return U and V as X and Y of the second plane."""
    return {axis: block.values[other] for axis, other in (("X", "U"), ("Y", "V")) if other in block.values}


def registers_set(blocks: Sequence[Block]) -> set[str]:
    """Return the registers that a program sets, by D1=0.155 or by G10."""
    names = {value.register for block in blocks for value in block.offsets}
    for block in blocks:
        letters = _G10_REGISTERS.get(block.values.get("L"), "") if ("G", 10) in block.codes else ""
        names |= {register(letter, block.values["P"]) for letter in letters if "P" in block.values}
    return names
