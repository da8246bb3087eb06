"""A path followed by the computer's own timers and routines: `poscal-literal` on the machine of 1982.

Here no planner computes the times of steps. The main program calls POSCAL once for each move and loads the timers.
Then the counts run down in simulated time, and interrupts make the steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate, pairwise

from edmsim.controllers.mcu.computer import RUNNING, Computer, check_place
from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S, MAX_SPEED, SPEED_UNIT_NM_S
from edmsim.controllers.protocols import Step, check_window
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

Place = tuple[int, int]


class PathRun(Snapshots):
    """The main program's part in a cut: it begins the moves of a path one after the other, and hands speeds on.

    It looks like a planner (`edmsim.controllers.planner.registry.Planner`), but its steps are those that the motors'
    lines have seen. A new speed waits until the optimising routine is done, a new move until POSCAL is; interrupts
    put both off. A negative speed runs the present move's vector the other way, to where the move began, and then the
    moves before it, each planned again. After a stop the present move is planned again from the table's position.

    >>> computer = Computer()
    >>> computer.init()
    >>> computer.set_position(30_000, 30_000)
    >>> computer.start()
    >>> run = PathRun(computer, [(30_000, 30_000), (30_010, 30_006)])
    >>> steps = run.advance(0, 1_000_000_000, 127)
    >>> len(steps), run.position_um, run.done
    (8, (30010, 30006), True)
    """

    STATE = ("_move", "_heading", "_over", "_requested", "_in_force", "_computing", "_computer")
    speed_unit_nm_s = SPEED_UNIT_NM_S
    max_feed_um_s = MAX_FEED_UM_S

    def __init__(self, computer: Computer, points: Sequence[Place]) -> None:
        for x, y in points:
            check_place(x, y)
        corners = [points[0], *(b for a, b in pairwise(points) if a != b)]
        if len(corners) < 2:
            raise InputError(f"a path needs two different points, not {len(corners)}")
        self._computer = computer
        self._steppers = computer.steppers
        self._size_um = unit_um(computer.steppers.unit)
        self._points = corners
        lengths_um = (math.dist(a, b) * self._size_um for a, b in pairwise(corners))
        self._along_um = list(accumulate(lengths_um, initial=0.0))
        self._over = False
        self._move, self._heading = 0, 1
        self._requested = self._in_force = 0
        self._computing = False

    @property
    def done(self) -> bool:
        """Whether the last move is over, each axis at its target or lost by REDUC, and all steps are made."""
        return self._over and not self._computer.board.steps

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um."""
        x, y = self._computer.position
        return x * self._size_um, y * self._size_um

    @property
    def path_um(self) -> float:
        """Length travelled along the path: the foot of the position counters on the present move."""
        (x0, y0), (x1, y1) = self._points[self._move : self._move + 2]
        x, y = self._computer.position
        along_um, end_um = self._along_um[self._move : self._move + 2]
        run_um = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) * self._size_um**2 / (end_um - along_um)
        return along_um + min(max(run_um, 0.0), end_um - along_um)

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Let the machine run for a window; a routine under way at its end is finished, its step comes next."""
        check_window(start_ns, end_ns, speed_units, MAX_SPEED)
        computer, steppers, board = self._computer, self._steppers, self._computer.board
        self._requested = speed_units
        steps = computer.run_until(start_ns)
        while board.now_ns < end_ns and computer.state == RUNNING:
            if steppers.free_ns > board.now_ns:
                steps += computer.run_until(min(end_ns, steppers.free_ns))
            elif not self._main():
                steps += computer.run_until(end_ns, to_the_end=False)
        return steps + computer.run_until(end_ns)

    def _main(self) -> bool:
        """Do what comes next once nothing is being computed; return whether there was anything."""
        heading = 1 if self._requested > 0 else -1
        if self._computing:
            self._computing = False
            self._give(heading)
        elif self._requested and not self._steppers.aimed:
            self._begin(heading)
        elif self._requested != self._in_force:
            self._give(heading)
        elif self._requested and not self._steppers.moving:
            return self._begin_next(heading)
        else:
            return False
        return True

    def _give(self, heading: int) -> None:
        """Hand the speed on: VELOCM, and other ends of the move where it is run the other way."""
        if self._requested and heading != self._heading:
            self._heading, self._over = heading, False
            self._steppers.lead_to(*self._points[self._move + (heading > 0)])
        self._steppers.set_speed(self._requested)
        self._in_force = self._requested

    def _begin_next(self, heading: int) -> bool:
        """Begin the next move of the path; False where there is none."""
        if not 0 <= self._move + heading <= len(self._points) - 2:
            self._over = heading > 0
            return False
        self._move += heading
        self._begin(heading)
        return True

    def _begin(self, heading: int) -> None:
        """Let POSCAL aim the present move; when it is done, the timers are started."""
        self._heading, self._computing = heading, True
        self._steppers.busy(self._steppers.begin(*self._points[self._move + (heading > 0)], heading))
