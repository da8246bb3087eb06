"""Feed controllers of users, from a Python file or as an object, and a check that they work."""

import inspect
import json
import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, cast

import numpy as np

from edmsim.controllers import protocols
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import real
from edmsim.user_code import UserObject, failure, naming_failures, run

NEEDED = ("name", "reset", "update", "snapshot", "restore")  # methods that a feed controller must have
_PROTOCOLS = (
    protocols.FeedController, protocols.SeesTruth, protocols.KnowsSetup, protocols.KnowsPart, protocols.SeesBreaks,
    protocols.StartsInAir, protocols.DrivesSteps, protocols.HasSwitches,
)  # fmt: skip
_CALLED = tuple(
    name for protocol in _PROTOCOLS for name, method in vars(protocol).items()
    if inspect.isfunction(method) and name[0] != "_"
)  # fmt: skip
"""Methods of a controller that cuts and comparisons call."""


def from_file(own: UserObject, parameters: dict[str, float]) -> protocols.FeedController:
    """Make a controller of a class in a user's file."""
    kinds = {
        name: kind for name, kind in vars(run(own.file)).items()
        if inspect.isclass(kind) and not lacking(kind) and not inspect.isabstract(kind)
    }  # fmt: skip
    if own.name not in kinds:
        raise InputError(_why_not(own, sorted(kinds)), own.file)
    kind = kinds[own.name]
    known = list(inspect.signature(kind).parameters)
    for parameter in parameters:
        if parameter not in known:
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise InputError(f"{own.name} has no parameter {parameter!r}; {has}", own.file)
    try:
        return cast(protocols.FeedController, naming_failures(cast(Any, kind), own.file, _CALLED)(**parameters))
    except InputError:
        raise
    except Exception as error:
        raise failure(error, own.file, f"{own.name} cannot be made") from None


def check_is_controller(candidate: object) -> protocols.FeedController:
    """Return an object if it can be a feed controller; raises `InputError` for a class or a missing method."""
    if inspect.isclass(candidate):
        raise InputError(f"{candidate.__name__} is a class: give an object of it, {candidate.__name__}()")
    missing = lacking(candidate)
    if missing:
        raise InputError(f"{candidate!r} is not a feed controller: it has no {', '.join(missing)}")
    return cast(protocols.FeedController, candidate)


def lacking(candidate: object) -> list[str]:
    """Return the methods that an object or class lacks to be a feed controller."""
    return [name for name in NEEDED if not hasattr(candidate, name)]


def text_of(controller: protocols.FeedController) -> str:
    """Return a controller's name with its parameters, as on the command line."""
    if not is_dataclass(controller):
        return controller.name
    values = [(field.name, getattr(controller, field.name)) for field in fields(controller) if field.init]
    numbers = [f"{name}={real(value)!r}" for name, value in values if real(value) is not None]
    return f"{controller.name}:{','.join(numbers)}" if numbers else controller.name


def _why_not(own: UserObject, kinds: list[str]) -> str:
    there = f"there are: {', '.join(kinds)}" if kinds else "the file has no class"
    if not own.name:
        return f"name the feed controller in this file, {own.file}:CLASS; {there}"
    found = vars(run(own.file)).get(own.name)
    if inspect.isclass(found):
        missing = lacking(found) or sorted(getattr(found, "__abstractmethods__", ()))
        return f"{own.name} is not a feed controller: it has no {', '.join(missing)}"
    return f"this file has no feed controller {own.name!r}; {there}"


WINDOW_S = 0.0255  # 255 pulses of the standard setting
WINDOWS = 300
SHORTED_WINDOWS = 1000  # 25.5 s, after which controllers give up on a short
_PATH_UM = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 400.0]])
"""A path with a corner, for controllers that ask for one."""
Counts = list[tuple[int, int]]


def check_controller(make: Callable[[], protocols.FeedController]) -> None:
    """Check that a feed controller can cut, be compared, saved and resumed.

    It receives windows of every kind: random shares of short and open pulses, nothing but open pulses (whose mean
    delay is NaN), nothing but shorts for 25 s, a fifth of open pulses, shorts that come and clear. A controller that
    raises its alarm is not called further.

    Parameters
    ----------
    make : callable
        Returns a new controller at every call; its class will do.

    Raises
    ------
    InputError
        It lacks a method; a command is missing, not finite, or faster than the machine; every command comes later
        than the next, which replaces it; two new ones do not command the same, nor does one after `reset`, or one
        that is resumed in the middle, or before every window, from a snapshot that went through JSON.

    Examples
    --------
    >>> from edmsim import controllers
    >>> controllers.check_controller(lambda: controllers.make("voltage"))
    """
    if not callable(make):
        raise InputError(f"make is {make!r}: give what returns a new controller, for example its class")
    for counts in _every_kind():
        _check_with(make, counts)


def rehearsed(make: Callable[[], protocols.FeedController], max_feed_um_s: float) -> list[protocols.FeedCommand]:
    """Return a controller's commands on the default machine for windows of every kind and a lost wire."""
    commands: list[protocols.FeedCommand] = []
    for counts in _every_kind():
        rehearsal = _Rehearsal(make(), max_feed_um_s)
        commands += [*rehearsal.run(counts), rehearsal.lose_wire(), *rehearsal.run(counts)]
    return commands


def _every_kind() -> tuple[Counts, ...]:
    """Return short and open pulses of windows: random, shorts that clear, only opens, a wide gap, only shorts."""
    rng = np.random.default_rng(1)
    random: Counts = [(int(a), int(b)) for a, b, _ in (
        rng.multinomial(WINDOW_PULSES, rng.dirichlet([0.3, 0.3, 0.3])) for _ in range(WINDOWS)
    )]  # fmt: skip
    open_, shorted, wide = (0, WINDOW_PULSES), (WINDOW_PULSES, 0), (0, WINDOW_PULSES // 5)
    clearing = [counts for windows in 2 * (2, 8, 40) for counts in [shorted] * windows + [wide] * 40]
    return random, clearing, [open_] * WINDOWS, [wide] * WINDOWS, [shorted] * SHORTED_WINDOWS


class _Rehearsal:
    """A controller that receives windows with chosen counts; the wire follows its commands."""

    def __init__(self, controller: protocols.FeedController, max_feed_um_s: float = MAX_FEED_UM_S) -> None:
        self.controller = controller
        self.windows, self.path_um, self._max_feed_um_s = 0, 0.0, max_feed_um_s
        protocols.set_up_controller(controller, Machine.load(), _PATH_UM, 0.0)
        self.command = protocols.check_command(controller.name, protocols.begin_leg(controller, max_feed_um_s))

    def run(self, counts: Counts, resumed: bool = False) -> list[protocols.FeedCommand]:
        """Return the commands after windows, up to an alarm; with `resumed` it is restored before every window."""
        commands = [self.command]
        for short, open_ in counts:
            if self.command.alarm is not None:
                break
            if resumed:
                text = protocols.snapshot_text(self.controller)
                protocols.begin_leg(self.controller, self._max_feed_um_s)
                self.controller.restore(json.loads(text))
            self._show(short, open_)
            commands.append(self.command)
        return commands

    def lose_wire(self) -> protocols.FeedCommand:
        """Return the command for the first window of the next wire."""
        lost = protocols.next_wire(self.controller, self._max_feed_um_s)
        self.command = protocols.check_command(self.controller.name, lost)
        return self.command

    def _show(self, short: int, open_: int) -> None:
        self.windows += 1
        self.path_um += self.command.feed_um_s * WINDOW_S
        ignited = WINDOW_PULSES - short - open_
        voltage_V, current_A = (30.0 * open_ + 6.0 * ignited) / WINDOW_PULSES, 2.0 * (1 - open_ / WINDOW_PULSES)
        delay_us, gap_um = (9.0, 8.0) if ignited else (math.nan, math.nan)
        fifths = tuple(len(range(k, ignited, 5)) for k in range(5))
        window = PulseWindow(
            0, round(WINDOW_S * 1e9), short, open_, ignited, 0, voltage_V, current_A, delay_us, gap_um, (0.0, 0.0),
            0.0, 320.0, 0.0, 0.0, 0.0, 0.0, False, fifths,
        )  # fmt: skip
        if isinstance(self.controller, protocols.SeesTruth):
            self.controller.see(window)
        time_ns = self.windows * window.duration_ns
        observation = protocols.WindowObservation.of(window, time_ns, self.command.feed_um_s, self.path_um)
        self.command = protocols.check_command(self.controller.name, self.controller.update(observation))


def _check_with(make: Callable[[], protocols.FeedController], counts: Counts) -> None:
    controller = check_is_controller(make())
    commands = _Rehearsal(controller).run(counts)
    fastest = max(abs(command.feed_um_s) for command in commands)
    if fastest > MAX_FEED_UM_S:
        raise _wrong(controller, f"commands {fastest:g} um/s where the machine runs {MAX_FEED_UM_S:g}")
    late_s = min((command.latency_s for command in commands[1:]), default=0.0)
    if late_s >= WINDOW_S and len({command.feed_um_s for command in commands}) > 1:
        raise _wrong(controller, f"never changes its feed: each is {late_s:g} s late, and replaced before")
    if _Rehearsal(make()).run(counts) != commands:
        raise _wrong(controller, "does not command the same again, when it is made again and shown the same windows")
    if _Rehearsal(controller).run(counts) != commands:
        raise _wrong(controller, "remembers something across reset(): it does not command the same as before")
    resumed = _Rehearsal(controller).run(counts, resumed=True)
    for window, (one, other) in enumerate(zip(resumed, commands, strict=False)):
        if one != other:
            values = zip(one._fields, one, other, strict=True)
            differ = (f"{name} {mine!r}, not {its!r}" for name, mine, its in values if mine != its)
            after = f"resumed before every window, after {window} it commands {', '.join(differ)}"
            raise _wrong(controller, f"{_FORGETS}: {after}")
    half = len(commands) // 2
    first, second = _Rehearsal(make()), _Rehearsal(make())
    first.run(counts[:half])
    text = protocols.snapshot_text(first.controller)
    second.windows, second.path_um, second.command = first.windows, first.path_um, first.command
    second.controller.restore(json.loads(text))
    if second.run(counts[half:]) != first.run(counts[half:]):
        raise _wrong(controller, _FORGETS)


_FORGETS = "does not go on from its snapshot as it would have without"


def _wrong(controller: protocols.FeedController, what: str) -> InputError:
    return InputError(f"the {controller.name} controller {what}")
