"""HeightStep: a straight cut through a workpiece whose height jumps, the classic wire breaker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import Scenario, above_zero, ends_of
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.plant.workpiece.start_slot import SLOT_GAP_UM, begun_slot

LEAST_SHARE = 0.2
"""Least height of a band that may be asked for, as a share of the greatest (ours)."""
_BESIDE_UM = 2e3
"""How far a band reaches beside and beyond the path (ours: well beyond what the wire erodes)."""


@dataclass(frozen=True, kw_only=True)
class HeightStep(GapFeed):
    """A straight cut through bands of drawn lengths and heights.

    Parameters
    ----------
    band_mm : (low, high)
        Lengths of path between two jumps (ours: a few seconds of cutting each).
    low_share : float
        Least local height as a share of the greatest, `LEAST_SHARE` to 1.
    """

    band_mm: tuple[float, float] = (0.1, 0.3)
    low_share: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        for length in ends_of("band_mm", self.band_mm):
            above_zero("band_mm", length)
        if not LEAST_SHARE <= self.low_share <= 1:
            raise InputError(f"low_share is {self.low_share!r}: give a share from {LEAST_SHARE:g} to 1")

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw where the height jumps, and to what: uniformly, band by band."""
        total = self.length_mm * 1e3
        starts, heights, at = [0.0], [machine.height_mm], float(rng.uniform(*self.band_mm)) * 1e3
        while at < total:
            starts.append(at)
            heights.append(machine.height_mm * float(rng.uniform(self.low_share, 1.0)))
            at += float(rng.uniform(*self.band_mm)) * 1e3
        ends = [*starts[1:], total + _BESIDE_UM]
        x, y = machine.base.table.centre_um
        x += machine.wire_diameter_um / 2 + SLOT_GAP_UM  # where the wire's front meets a jump
        steps = [
            LowerRegion(shapely.box(x + a, y - _BESIDE_UM, x + b, y + _BESIDE_UM), h)
            for a, b, h in zip(starts[1:], ends[1:], heights[1:], strict=True)
        ]
        drawn |= {"height_jumps": float(len(steps))}
        stock = begun_slot(machine, machine.base.table.centre_um, steps=steps)
        profile = np.array(starts), np.array(heights)
        return Scenario(machine, stock, (self.path_um(machine),), profile, seed, drawn)


class HeightStepEnv(EdmEnv):
    """A straight cut through a workpiece whose height jumps, the classic wire breaker.

    Description
    -----------
    As `GapFeedEnv`, but the workpiece has bands of different heights across the path. Where the height falls, the
    same pulses heat a shorter piece of wire: a feed that was right breaks it. Heights are not shown; they have to
    be found in what the pulses show.

    Action space
    ------------
    ``Box(-1, 1, (1,), float32)``.

    =====  ====  =====  =================================  ===================
    Index  Name  Range  Meaning                            Unit of 1
    =====  ====  =====  =================================  ===================
    0      feed  -1..1  change of the feed along the path  ``max_change_um_s``
    =====  ====  =====  =================================  ===================

    With ``action="speed"`` the entry is the feed, in units of ``max_feed_um_s``. A negative feed runs back along
    the path, never beyond its start. Actions beyond the range are clipped; NaN raises `InvalidAction`.

    Observation space
    -----------------
    ``Box((40,), float32)``: what a machine can measure, clipped to its range.

    =====  ==============  =====  ===============================================  ==========================
    Index  Name            Range  Quantity                                         Divided by
    =====  ==============  =====  ===============================================  ==========================
    0      short           0..1   short pulses                                     pulses of the window
    1      open            0..1   open pulses                                      pulses of the window
    2      spark           0..1   pulses that ignited; sparks and arcs look alike  pulses of the window
    3      mean_voltage    0..1   mean gap voltage, V                              open voltage, V
    4      mean_current    0..4   mean gap current, A                              generator's limit of it, A
    5      mean_delay      0..1   mean ignition delay, us; 1 if nothing ignited    longest wait for it, us
    6      commanded_feed  -1..1  commanded feed, um/s                             ``max_feed_um_s``
    7      actual_feed     -1..1  feed by the position counters, um/s              ``max_feed_um_s``
    8      t_on            0..8   on-time, us                                      first on-time, us
    9      t_period        0..16  pulse period, us                                 first pulse period, us
    =====  ==============  =====  ===============================================  ==========================

    Entries 0 to 9 are of the last window; 10 to 39 are the same of the three windows before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them.

    Reward
    ------
    The sum of the terms in ``info["reward_terms"]``, with weights w of `Weights`, where

    ======  =====================================================================
    Symbol  Meaning
    ======  =====================================================================
    P       area cut in the window / 0.01275 mm2, which is 30 mm2/min for 25.5 ms
    T       duration of the window / 25.5 ms, the window of 255 pulses of 100 us
    s, o    shares of short and of open pulses
    e       distance of the wire's true place from the path, um
    B       1 in the window in which the wire breaks, else 0
    L       1 in the window in which another limit ends the episode, else 0
    D       1 in the window in which the path's end is reached, else 0
    ======  =====================================================================

    and

    ==========  ====================  ======
    Term        Value                 Weight
    ==========  ====================  ======
    progress    ``w P``               1
    short       ``-w s T``            0.5
    open        ``-w o T``            0.1
    profile     ``-w (e / 10 um) P``  0
    time        ``-w T``              0
    wire_break  ``-w B``              100
    limit       ``-w L``              100
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air.

    Starting state
    --------------
    The wire stands on the middle of the table, in a slot, 25 um off the metal. The first band has the greatest
    height; the length of each band is drawn uniformly from ``band_mm``, the height of each further one uniformly
    from ``low_share`` to 1 times the greatest. Machine, height, tension and material are drawn as the arguments
    say, and the plant's seed. The feed is ``start_feed_um_s``, or 0 with ``action="speed"``, and the observation 0.
    ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 1,000 windows, 25.5 s (``max_episode_steps`` of `gymnasium.make`).

    Arguments
    ---------
    ===============  ==============  =======  =====================================================================
    Name             Default         Unit     Meaning
    ===============  ==============  =======  =====================================================================
    length_mm        ``3.0``         mm       length of the cut
    band_mm          ``(0.1, 0.3)``  mm       (low, high) of the length between two jumps
    low_share        ``0.25``        1        least height as a share of the greatest, 0.2 to 1
    resolution       ``"default"``            of the plant: ``"fast"`` to train, ``"default"``, ``"fine"``
    machine          ``None``                 a `Machine`, its name, TOML file or mapping; the standard one if None
    materials        ``()``                   names, one of which is drawn; the machine's own if none
    height_mm        ``None``        mm       greatest height, or (low, high); the machine's own if None
    tension          ``None``        N        of the wire, or (low, high); the machine's own if None
    randomise        ``None``                 constants to draw within their ranges; ``()`` for all
    action           ``"change"``             ``"change"`` of the feed, or ``"speed"``: the feed itself
    max_feed_um_s    ``100.0``       um/s     largest feed either way
    max_change_um_s  ``4.0``         um/s     largest change of the feed per window
    start_feed_um_s  ``5.0``         um/s     feed before the first action
    history          ``4``           windows  windows in an observation
    weights          ``None``                 `Weights`, or a mapping of those that differ; above if None
    planner          ``"poscal"``             makes the motor steps; ``"exact"`` has no greatest feed of its own
    render_mode      ``None``                 ``"rgb_array"`` or ``"human"``
    ===============  ==============  =======  =====================================================================

    Versions
    --------
    v0: first version.
    """

    task = HeightStep


class HeightStepVectorEnv(EdmVectorEnv):
    """`HeightStepEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = HeightStep
