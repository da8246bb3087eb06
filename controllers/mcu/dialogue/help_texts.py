"""What HELP prints: a whole job first, then word by word.

No line is longer than the terminal's 80 columns, and no text than what 24 lines leave above the live view.
"""

from __future__ import annotations

JOB = """\
A JOB, STEP BY STEP                        HELP and a word tells more of it
 1  STATUS              what the machine is doing
 2  X 50   Y -200       jog an axis by so many um, with the generator off
 3  POS 1000 2000       call this place X 1000 Y 2000 um
 4  NEW 1300 2000       new position, straight; CW or CCW: on an arc
 5  TI 30 TP 100        pulse duration and period in us
 6  SPEED 100           greatest cutting speed, 1 to 127 units
 7  START               generator and timers on: cuts to the new position
 8  STATUS  STOP  WAIT  meanwhile: look, stop, or wait for the end
 9  BYE                 leaves, the machine made safe
HELP MORE is about programs, emergencies, typing and the monitor."""

MORE = """\
MAIN asks for 3 to 7 one after the other.
LOAD takes a program from the host, LIST shows it, RUN cuts it.
GEN ON and GEN OFF run and stop the generator without a move. KEY presses
keys of the front panel; TENSION LOW and FULL set that of the wire.
EM or Ctrl-C is the emergency stop. After it nothing moves until INIT; then
WIRE threads a new wire if it broke, and GO goes on with the cut.
BS or DEL takes a character back, Ctrl-X the line; Ctrl-R types it again.
MON leads to the monitor: memory, registers, tapes. Ctrl-\\ is the reset button."""

WORDS = {
    "HELP": """\
HELP            a job, step by step
HELP MORE       the rest
HELP word       what the word does; also ?""",
    "STATUS": """\
STATUS          state, position, the move under way or the new position,
                speed, counts of the last 255 pulses in percent, t(i), t(p),
                gap voltage and current, and the windows that were not read
                in time""",
    "POS": """\
POS             where the wire is, um
POS x y         call this place x y, 0 to 65535 um; nothing moves""",
    "NEW": """\
NEW x y         new position, um, along a straight line; START cuts to it""",
    "CW": """\
CW x y xc yc    new position x y, um, clockwise about the centre xc yc
CCW x y xc yc   the other way round; START cuts to it""",
    "TI": """\
TI us           pulse duration t(i) in whole us, to 1000
TI 4DH          the code of V(t(i)) itself, 0H to FFH; 100H to 1FFH are the
                coarse range, chosen by itself for more than 50 us
                TI 30 TP 100 SPEED 90 on one line are taken over together.
                A pair that draws more than 2 A is refused; the old one stays.""",
    "TP": """\
TP us           pulse period t(p) in whole us, to 10000
TP 80H          the code of V(t(p)) itself, 0H to FFH; 100H to 1FFH are the
                coarse range, chosen by itself for more than 150 us; see TI""",
    "SPEED": """\
SPEED n         greatest cutting speed, 1 to 127 units of 0.2625 um/s; below
                it the counts of short and open pulses decide""",
    "START": """\
START           generator and timers on: cuts to the new position, then stops
                and says READY""",
    "STOP": """\
STOP            stops the timers and the generator; GO goes on from there""",
    "GO": """\
GO              goes on with the cut that was stopped, by STOP or in an
                emergency, once INIT, WIRE, TI and TP have made it possible""",
    "X": """\
X um            jogs along x by so many um (X -200 goes back), generator off,
                at 127 units; motor steps are 2 um. Refused while moving.
Y um            the same along y""",
    "GEN": """\
GEN ON          runs the pulse generator (OEV = 0)
GEN OFF         stops it (OEV = 1); a voltage stays on the wire for a while""",
    "WAIT": """\
WAIT            waits until the machine stands still
WAIT s          waits s seconds of machine time, or until it is stopped""",
    "MAIN": """\
MAIN            asks for position, new position, t(i), t(p) and cutting speed
                and then starts. An empty line keeps what is shown; any other
                word ends the questions.""",
    "LOAD": """\
LOAD            takes a program from the host: lines with NEW, CW, CCW, TI,
                TP, SPEED as they are typed here, * before a comment, END last.
                A faulty program is refused and the old one kept.""",
    "LIST": """\
LIST            shows the program""",
    "RUN": """\
RUN             cuts the program from where the wire is; settings are taken
                over where they stand between the moves""",
    "EM": """\
EM              emergency stop: the steppers stand, the generator is off, both
                codes are 0. So does Ctrl-C, an end switch, a broken wire.
                Nothing moves until INIT; the position is kept.""",
    "INIT": """\
INIT            makes the machine safe and ready: generator off, codes 0,
                position kept. Give t(i) and t(p) again before START. From an
                end switch, jog back.""",
    "MON": """\
MON             leads to the monitor, which shows and alters memory and the
                registers of the chips; G there leads back. The machine goes
                on meanwhile.""",
    "MORE": MORE,
    "WIRE": """\
WIRE            threads a new wire where the old one was; takes a minute""",
    "TENSION": """\
TENSION LOW     halves the wire's tension
TENSION FULL    gives it back; so does INIT""",
    "KEY": """\
KEY names       presses keys of the front panel one after the other: digits,
                CLEAR X Y T(I) T(P) SPEED START STOP GO INIT X+ X- Y+ Y-, SHIFT
                before one. KEY 300 X+ jogs by 300 um. Before a live view
                Ctrl-K gives your keyboard to the panel, and takes it back.""",
    "BYE": """\
BYE             makes the machine safe and leaves""",
}
"""What each word does, by the word."""

ALIASES = {"CCW": "CW", "Y": "X", "?": "HELP"}
"""Words explained together with another."""
