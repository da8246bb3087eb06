"""The highest stable cutting rate: shorten the period step by step until the wire breaks.

Sato et al. found the mean current at which a wire breaks by this search, and the validation finds that of the plant
by it; here the cutting rate is measured at every step.
"""

from collections.abc import Callable, Sequence
from functools import partial
from statistics import fmean
from typing import Literal, NamedTuple

from edmsim.closed_loop.straight import Cut, Traverse, begin
from edmsim.controllers import FeedController
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.job.plan import make_controller
from edmsim.machine.machine import Machine
from edmsim.machine.setting import busy_us, least_period_us, period_range_us
from edmsim.plant.window import PlantError

SHORTENING = 0.95  # ratio of the periods of two steps (ours: the limit is known to 5 %)
SHORTEST_PAUSE_US = 1.0  # pause at which the search ends (ours: less than a fifth of the channels deionise in it)
LEAST_POWER = 0.1  # share of the generator's greatest power at which the search begins by default (ours)
JAMMED_SHARE = 0.5  # a step with this share of shorts is a jam (ours: as the shorted windows of the `counts` law)
OPEN_SHARE = 0.1
"""Share of open pulses at which the rate is measured (ours: shorts stay few, and not many pulses are lost)."""

Cause = Literal["break", "jam", "generator"]
"""Causes that end a search: the wire broke, shorts persisted, or the generator allows no shorter period."""


class StablePeriod(NamedTuple):
    """A step of the search in which the wire neither broke nor jammed."""

    t_period_us: float  # the on-time is constant
    feed_um_s: float
    rate_mm2_min: float  # mean feed times height
    current_A: float  # mean of sparks and arcs, without short-circuit pulses, as for the power
    power_W: float
    windows: int


class StableRate(NamedTuple):
    """The highest stable cutting rate of a set-up."""

    # rate_mm2_min, feed_um_s, current_A, power_W: means over the seeds at that step (see `StablePeriod`); 0 if the
    # first step already failed
    rate_mm2_min: float
    feed_um_s: float
    current_A: float
    power_W: float
    machine: Machine  # the set-up with the period of that step
    limited_by: Cause  # cause that ended the search for the seed with the fewest stable steps: break, jam, generator
    windows: int  # number of windows in all stable steps of all seeds


def quick_counts(open_share: float) -> str:
    """Return a `counts` law quick enough for short steps, with a target share of open pulses (gains are ours)."""
    return (
        f"counts:open_target_share={open_share:g},start_feed_um_s=5,proportional_um_s=30,integral_um_s2=100,"
        "filter_s=0.05,return_feed_um_s=5,retract_feed_um_s=100,max_tries=1000"
    )


@refuses_wrong_types
def highest_stable_rate(
    machine: Machine, *, seeds: Sequence[int] = (1, 2), hold_s: float = 1.0, approach_s: float = 3.0,
    longest_period_us: float | None = None, controller: str | None = None, resolution: str = "fast",
    watch: Callable[[int, StablePeriod], None] | None = None,
) -> StableRate:
    """Search the highest cutting rate of a set-up in a straight cut without a wire break or a jam.

    The search raises the power at a fixed on-time. It shortens the period by a twentieth after every `hold_s`, until
    the wire breaks, the cut jams, or the generator's shortest period is reached. The result is the period with the
    highest mean rate among those that the cuts of all seeds held.

    Parameters
    ----------
    machine : Machine
        The set-up; the search does not use its period.
    seeds : sequence of int
        Seeds of the plants, one cut each.
    hold_s : float
        Machine time in s that a cut must last at each period, above 0.
    approach_s : float
        Machine time in s for the feed to settle first.
    longest_period_us : float, optional
        First period in us; by default ten times the generator's shortest for this on-time, at most its longest.
    controller : str, optional
        Feed controller (see `edmsim.controllers.from_text`); by default a quick `counts` law with a tenth of the
        pulses open.
    resolution : {"fast", "default", "fine"}
    watch : callable, optional
        Called with the seed and the `StablePeriod` of every step.

    Returns
    -------
    StableRate

    Raises
    ------
    InputError
        If there is no seed, a time is not positive, or a period, controller or resolution is invalid.

    Examples
    --------
    >>> import edmsim
    >>> found = edmsim.highest_stable_rate(edmsim.Machine.load(height_mm=10), seeds=(1,), hold_s=0.5)
    >>> found.limited_by
    'generator'
    """
    if not seeds:
        raise InputError("a search for the highest stable rate wants one seed or more")
    for name, seconds in (("hold_s", hold_s), ("approach_s", approach_s)):
        if not 0 < seconds < float("inf"):
            raise InputError(f"{name} {seconds:g} must be finite and above zero")
    if longest_period_us is None:
        longest_period_us = min(shortest_period_us(machine) / LEAST_POWER, period_range_us(machine)[1])
    first = machine.with_(t_period_us=longest_period_us)
    feed = quick_counts(OPEN_SHARE) if controller is None else controller
    runs = [
        shorten_pauses(
            first, seed, make_controller(feed), hold_s=hold_s, approach_s=approach_s, resolution=resolution,
            watch=None if watch is None else partial(watch, seed),
        )
        for seed in seeds
    ]
    cause: Cause = min(runs, key=lambda run: len(run[0]))[1]
    held_by_all = [_mean(steps) for steps in zip(*(steps for steps, _ in runs), strict=False)]
    nothing = StablePeriod(longest_period_us, 0.0, 0.0, 0.0, 0.0, 0)
    best = max(held_by_all, key=lambda held: held.rate_mm2_min, default=nothing)
    return StableRate(
        best.rate_mm2_min, best.feed_um_s, best.current_A, best.power_W,
        first.with_(t_period_us=best.t_period_us), cause, sum(held.windows for steps, _ in runs for held in steps),
    )


def shorten_pauses(
    machine: Machine, seed: int, controller: FeedController, *, hold_s: float, approach_s: float,
    resolution: str = "fast", watch: Callable[[StablePeriod], None] | None = None,
) -> tuple[list[StablePeriod], Cause]:
    """Cut straight, and shorten a machine's period step by step; return the stable steps and the cause of the end."""
    plant = begin(machine, seed, resolution=resolution)
    traverse, held = Traverse(plant, controller), list[StablePeriod]()
    period_us, shortest_us = machine.t_period_us, shortest_period_us(machine)
    try:
        windows = traverse.run(approach_s)
        while not windows[-1].broken:
            plant.set_generator(machine.t_on_us, period_us)
            from_um, before_um = plant.commanded_um[0], traverse.path_um  # the path has fractions of motor steps
            windows = traverse.run(hold_s)
            cut = Cut(plant, windows, from_um, traverse.path_um - before_um)
            if cut.broken:
                break
            if traverse.alarm is not None or cut.share("short") > JAMMED_SHARE:
                return held, "jam"
            held.append(_held(cut, period_us))
            if watch is not None:
                watch(held[-1])
            if period_us <= shortest_us:
                return held, "generator"
            period_us = max(SHORTENING * period_us, shortest_us)
    except PlantError:
        return held, "jam"
    return held, "break"


def shortest_period_us(machine: Machine) -> float:
    """Return the shortest period that the generator allows for a machine's on-time, with a pause."""
    low, _ = period_range_us(machine)
    return max(least_period_us(machine, machine.t_on_us), busy_us(machine) + SHORTEST_PAUSE_US, low)


def _held(cut: Cut, period_us: float) -> StablePeriod:
    rate_mm2_min = cut.feed_um_s * 0.06 * cut.plant.machine.height_mm
    return StablePeriod(
        period_us, cut.feed_um_s, rate_mm2_min, cut.working_current_A, cut.energy / cut.seconds, len(cut.windows)
    )


def _mean(steps: Sequence[StablePeriod]) -> StablePeriod:
    """Return the means over several seeds' cuts at one period, and the sum of their windows."""
    means = StablePeriod._make(map(fmean, zip(*steps, strict=True)))
    return means._replace(t_period_us=steps[0].t_period_us, windows=sum(step.windows for step in steps))
