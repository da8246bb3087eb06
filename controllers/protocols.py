"""What a feed controller observes, what it commands, and which methods it needs."""

import json
import math
import sys
from dataclasses import fields
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.numeric import plain, real, to_plain_numbers

SIGNED = "offset_um", "pull_N_m"
"""Parameters of controllers that may be negative: an offset to the right, the pull on a lagging wire."""
LENGTHENING = "slow_factor", "corner_factor", "patience_factor", "longest_factor", "back_factor"
"""Parameters of controllers that must be 1 or more: they lengthen a period, or slow a growth."""
SHARES = "_share", "shortest_factor"
"""Suffixes of parameters of controllers that must be from 0 to 1."""
ControllerState = dict[str, Any]  # a controller's snapshot as JSON


class Step(NamedTuple):
    """One rising edge on STEP: one motor step of table travel (rows T-16, T-17)."""

    time_ns: int  # from the start of the run
    axis: int  # 0 for x, 1 for y
    direction: int  # +1 or -1


class WindowObservation(NamedTuple):
    """One window of 255 pulses as a real machine's controller can observe it."""

    time_s: float  # end of the window in s
    duration_s: float  # length of the window in s: 255 t(p)
    short: int  # pulses without removal; their sum is 0..255
    open: int
    # gap voltage averaged over the window, of the working pulses only: equalising pulses, which hold the mean of both
    # at 0 V, would hide the gap's state
    mean_voltage_V: float
    mean_current_A: float  # gap current averaged over the window
    mean_delay_us: float  # ignition delay averaged over the pulses that ignited, in us
    feed_um_s: float  # feed commanded for the window in um/s
    # path length at the end of the window by the position counters, in um, over all legs of the program (see
    # `KnowsSetup.set_up`)
    path_um: float
    # ignitions in each fifth of the workpiece's (greatest) height, from below, as the currents of the two contacts
    # locate them: see `edmsim.machine.pulse_window.PulseWindow`
    fifths: tuple[int, ...] = (0, 0, 0, 0, 0)

    @classmethod
    def of(cls, window: PulseWindow, time_ns: int, feed_um_s: float, path_um: float) -> "WindowObservation":
        """Return the observation of a window; every observation is made here.

        Parameters
        ----------
        window : PulseWindow
        time_ns : int
            Machine time at its end.
        feed_um_s, path_um : float
            See the attributes.
        """
        return cls(
            time_ns * 1e-9, window.duration_ns * 1e-9, window.short, window.open, window.mean_voltage_V,
            window.mean_current_A, window.mean_delay_us, feed_um_s, path_um, window.fifths,
        )


class FeedCommand(NamedTuple):
    """A controller's command for the next window."""

    feed_um_s: float  # speed along the path in um/s; negative to run backwards
    alarm: str | None = None  # reason to stop the machine, or None
    # t_on_us, t_period_us: generator setting from the next window on; None keeps the present one. A setting that the
    # generator refuses has no effect.
    t_on_us: float | None = None
    t_period_us: float | None = None
    # calculation time of the controller: the machine runs at the old feed for this time after the window's end, in s
    latency_s: float = 0.0
    # offset of the guides from the path, positive to its left, negative to its right. They move by one motor step per
    # axis and window.
    offset_um: float = 0.0


class FeedController(Protocol):
    """Sets the feed, window by window."""

    @property
    def name(self) -> str:
        """Its name in reports and messages, usually an attribute of the class."""

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg: a stretch of the program between two stops, that is threading, a dwell or the end.

        Parameters
        ----------
        max_feed_um_s : float
            Largest feed of the machine in um/s, in both directions.

        Returns
        -------
        FeedCommand
            For the first window.

        Raises
        ------
        InputError
            If a parameter is above the machine's largest feed.
        """

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the command for the next window from the observation of the last one."""

    def snapshot(self) -> ControllerState:
        """Save the state: everything that changes while cutting."""

    def restore(self, state: ControllerState) -> None:
        """Load a saved state: resume exactly where `snapshot` was taken."""


@runtime_checkable
class SeesTruth(Protocol):
    """A controller that reads the true state of the gap: a bound for comparisons, not for real machines."""

    def see(self, truth: PulseWindow) -> None:
        """Read the true state of the gap; called after every window, before `FeedController.update`."""


@runtime_checkable
class KnowsSetup(Protocol):
    """A controller that uses the set-up: what an operator knows of the machine and the drawing."""

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up and the next leg's points, (n, 2) in um; called before every `FeedController.reset`.

        `WindowObservation.path_um` counts over all legs: a place ``s`` after the leg's first point is reached at
        ``path_um == start_um + s``. The generator of `machine` has the setting at the beginning of every leg.
        """


@runtime_checkable
class KnowsPart(Protocol):
    """A controller that uses on which side of the path the part lies."""

    def see_part(self, side: Literal["left", "right"] | None) -> None:
        """Read the part's side, looking along the next leg; None if the wire follows a line as drawn.

        Called before `KnowsSetup.set_up`.
        """


def set_up_controller(
    controller: object, machine: Machine, points_um: NDArray[Any], start_um: float,
    part_side: Literal["left", "right"] | None = None,
) -> None:
    """Give a controller the set-up and the next leg, if it has `KnowsSetup.set_up`, and the part's side."""
    if isinstance(controller, KnowsPart):
        controller.see_part(part_side)
    if isinstance(controller, KnowsSetup):
        controller.set_up(machine, np.array(points_um, np.float64), start_um)


@runtime_checkable
class LimitsLegs(Protocol):
    """A controller that cannot follow a path of any number of legs."""

    def check_legs(self, legs: int) -> None:
        """Refuse a path of this number of legs; called before anything is cut."""


@runtime_checkable
class MissesWindows(Protocol):
    """A controller that may read counts too late."""

    @property
    def missed_windows(self) -> int:
        """Windows not read in time since the beginning of the leg (row T-44)."""


@runtime_checkable
class SeesBreaks(Protocol):
    """A controller that continues after a break, in episodes with more than one wire."""

    def wire_lost(self) -> FeedCommand:
        """Return the command for the first window of the next wire; controllers without this method are reset."""


def next_wire(controller: FeedController, max_feed_um_s: float) -> FeedCommand:
    """Let a controller continue with the next wire; returns the command for its first window."""
    return controller.wire_lost() if isinstance(controller, SeesBreaks) else controller.reset(max_feed_um_s)


@runtime_checkable
class StartsInAir(Protocol):
    """A controller that approaches the metal first where a leg may begin far from it: in a cut of a program."""

    def reset_in_air(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg as `FeedController.reset` does, which a cut then does not call, but with an approach."""


def begin_leg(controller: FeedController, max_feed_um_s: float) -> FeedCommand:
    """Let a controller begin a leg of a program; returns the command for its first window."""
    begin = controller.reset_in_air if isinstance(controller, StartsInAir) else controller.reset
    return begin(max_feed_um_s)


@runtime_checkable
class DrivesSteps(Protocol):
    """A controller with lines to the motors: a planner's steps pass through it."""

    def drive(self, steps: list[Step]) -> list[Step]:
        """Make a planner's steps, in order of time; return the steps that the motors made."""


@runtime_checkable
class WasTrained(Protocol):
    """A trained controller."""

    def beyond_training(self, machine: Machine) -> list[str]:
        """Return the differences of a set-up from the training, for the report."""


@runtime_checkable
class HasSwitches(Protocol):
    """A controller with inputs for the machine's safety switches (row T-46)."""

    @property
    def emergency(self) -> str | None:
        """Message of its emergency routine for the report; None if it has not run since the beginning of the leg."""

    def open_switch(self, name: str) -> None:
        """Open a switch of the machine: a name of `edmsim.controllers.mcu.board.NAMES`."""


def check_parameters(controller: Any) -> None:
    """Refuse values that are not finite, negative unless `SIGNED`, below 1 if `LENGTHENING`, above 1 if `SHARES`.

    A parameter that is annotated as an integer must be whole.
    """
    to_plain_numbers(controller)
    for parameter in fields(controller):
        name, setting, counts = parameter.name, getattr(controller, parameter.name), parameter.type is int
        top = 1.0 if name.endswith(SHARES) else sys.float_info.max  # an int may exceed the range of float
        least = 1 if name in LENGTHENING else 0
        value = real(setting)
        fits = value is not None and (-top if name in SIGNED else least) <= value <= top
        if parameter.init and not (fits and (not counts or setting == int(setting))):
            bounds = " from 0 to 1" if top == 1.0 else "" if name in SIGNED else f" of {least} or more"
            kind = "whole number" if counts else "number"
            raise InputError(f"{name} of the {controller.name} controller must be a {kind}{bounds}, not {setting!r}")


_LONGEST_S = 3600.0  # greatest calculation time (ours: far longer than a window)
_GREATEST_OFFSET_UM = 1e6  # greatest offset of the guides (ours: more than any table)


def check_command(controller: str, command: object) -> FeedCommand:
    """Return a controller's command with Python numbers; refuse other types and impossible commands."""
    if not isinstance(command, FeedCommand):
        raise InputError(f"the {controller} controller answered {command!r}: it must return a FeedCommand")
    own: FeedCommand = plain(command)
    feed, alarm, t_on, t_period, latency, offset = own
    if not _is_finite(feed):
        raise InputError(f"the {controller} controller commanded a feed of {feed!r} um/s")
    if not (_is_finite(offset) and abs(offset) <= _GREATEST_OFFSET_UM):
        raise InputError(
            f"the {controller} controller commanded an offset of {offset!r} um: give -{_GREATEST_OFFSET_UM:g} to "
            f"{_GREATEST_OFFSET_UM:g}"
        )
    for name, us in (("on-time", t_on), ("period", t_period)):
        if us is not None and not _is_finite(us):
            raise InputError(f"the {controller} controller commanded the {name} {us!r} us; None keeps the one before")
    if not (_is_finite(latency) and 0 <= latency <= _LONGEST_S):
        raise InputError(
            f"the {controller} controller has a calculation time of {latency!r} s: give 0 to {_LONGEST_S:g}"
        )
    if alarm is not None and not (isinstance(alarm, str) and alarm.strip() and alarm.isprintable()):
        raise InputError(
            f"the {controller} controller has the alarm {alarm!r}: give the reason in words, on one line, or None"
        )
    return own


def _is_finite(value: object) -> bool:
    number = real(value)
    try:
        return number is not None and math.isfinite(number)
    except OverflowError:
        return False


def snapshot_text(controller: FeedController) -> str:
    """Return a controller's snapshot as JSON; refuse None and what JSON cannot represent."""
    state = controller.snapshot()
    if state is None:
        raise InputError(f"the {controller.name} controller has the snapshot None: return its state, {{}} if none")
    try:
        return json.dumps(state)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"the {controller.name} controller has a snapshot that JSON cannot hold ({error}): give Python's own "
            "numbers, texts and lists, as float(x) and x.tolist()"
        ) from None


def check_window(start_ns: int, end_ns: int, speed_units: int, max_speed: int | None) -> None:
    """Refuse a planner's window that ends before it begins, and a speed above the greatest (None: unlimited)."""
    if end_ns < start_ns:
        raise InputError(f"a window must not end before it starts, but {end_ns} ns is before {start_ns} ns")
    if max_speed is not None and not -max_speed <= speed_units <= max_speed:
        raise InputError(f"the path speed must be -{max_speed}..{max_speed} units, not {speed_units}")


def check_feed(controller: str, name: str, feed_um_s: float, max_feed_um_s: float) -> None:
    """Refuse a feed above the machine's largest."""
    if feed_um_s > max_feed_um_s:
        raise InputError(
            f"{name} of the {controller} controller is {feed_um_s} um/s, "
            f"but the machine runs at most {max_feed_um_s} um/s: lower it, or choose a faster machine and planner"
        )
