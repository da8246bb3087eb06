"""HeightStep: a straight cut through a workpiece whose height jumps, the classic wire breaker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from edmsim.envs.arguments import above_zero, ends_of, within
from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.scenario import Scenario
from edmsim.envs.single import EdmEnv
from edmsim.envs.vector import EdmVectorEnv
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM, begun_slot
from edmsim.plant.workpiece.height_steps import LowerRegion

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
        within("low_share", self.low_share, LEAST_SHARE, 1.0)

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

    With ``action="speed"`` entry 0 is the feed, in units of ``max_feed_um_s``; with ``action="servo"`` it is the
    share of open pulses that a servo holds, from ``servo_target_share[0]`` at -1 to ``servo_target_share[1]`` at 1. A
    negative feed runs back along the path, never beyond its start. Actions beyond the range are clipped; NaN raises
    `InvalidAction`.

    Observation space
    -----------------
    ``Box((46,), float32)``: what a machine can measure and its operator knows, clipped to its range.

    =====  ==============  =====  ===============================================  ==========================
    Index  Name            Range  Quantity                                         Divided by
    =====  ==============  =====  ===============================================  ==========================
    0      short           0..1   short pulses                                     pulses of the step
    1      open            0..1   open pulses                                      pulses of the step
    2      spark           0..1   pulses that ignited; sparks and arcs look alike  pulses of the step
    3      mean_voltage    0..1   mean gap voltage, V                              open voltage, V
    4      mean_current    0..4   mean gap current, A                              generator's limit of it, A
    5      mean_delay      0..1   mean ignition delay, us; 1 if nothing ignited    longest wait for it, us
    6      commanded_feed  -1..1  commanded feed, um/s                             ``max_feed_um_s``
    7      actual_feed     -1..1  feed by the position counters, um/s              ``max_feed_um_s``
    8      t_on            0..1   log10 of the on-time in us                       3
    9      t_period        0..1   log10 of the pulse period in us                  4
    40     tension         0..10  tension of the wire, N                           10 N
    41     wire_diameter   0..4   diameter of the wire, um                         100 um
    42     height          0..8   height of the workpiece, the greatest, mm        50 mm
    43     flushing_lower  0..30  pressure of the lower nozzle, Pa                 1 bar
    44     flushing_upper  0..30  pressure of the upper nozzle, Pa                 1 bar
    45     wire_speed      0..15  speed of the running wire, m/s                   1 m/s
    =====  ==============  =====  ===============================================  ==========================

    Entries 0 to 9 are of the last step; 10 to 39 are the same of the three steps before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 40 to 45 are the
    operator's dials.
    Local heights below the greatest are not shown.

    Reward
    ------
    The sum of the terms in ``info["reward_terms"]``, with weights w of `Weights`, where

    ======  =====================================================================
    Symbol  Meaning
    ======  =====================================================================
    P       area cut in the step / 0.01275 mm2, which is 30 mm2/min for 25.5 ms
    T       duration of the step / 25.5 ms, the window of 255 pulses of 100 us
    s, o    shares of short and of open pulses
    e       distance of the wire's true place from the path, um
    g       energy of a discharge beyond ``energy_bound_mJ``, in parts of it, else 0
    B       wires that broke in the step, 0 or 1
    L       1 in the step in which another limit ends the episode, else 0
    D       1 in the step in which the path's end is reached, else 0
    H       time to thread another wire / 25.5 ms: 2,353 for 60 s
    ======  =====================================================================

    and

    ==========  ====================  ======
    Term        Value                 Weight
    ==========  ====================  ======
    progress    ``w P``               1
    short       ``-w s T``            0.5
    open        ``-w o T``            0.1
    profile     ``-w (e / 10 um) P``  0
    roughness   ``-w g P``            0
    time        ``-w T``              0
    wire_break  ``-w B H``            1
    limit       ``-w L H``            1
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air; nor what the field
    pulls a fresh wire in its first 0.25 s. A lost wire costs what is lost at 30 mm2/min while another is threaded.
    ``info["cost"]`` is 1 for a lost wire or an end by a limit, and a second's worth for every second beyond a bound.

    Starting state
    --------------
    The wire stands on the middle of the table, in a slot, 25 um off the metal. The first band has the greatest
    height; the length of each band is drawn uniformly from ``band_mm``, the height of each further one uniformly
    from ``low_share`` to 1 times the greatest. Machine, height, tension and material are drawn as the arguments
    say, and the plant's seed. The feed is ``start_feed_um_s``, or 0 with ``action="speed"``, and the observation 0.
    ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 25 s of cutting (``episode_s``); ``info["dt_s"]`` is the machine time of a step.

    Arguments
    ---------
    ==================  ================  =======  ====================================================
    Name                Default           Unit     Meaning
    ==================  ================  =======  ====================================================
    length_mm           ``3.0``           mm       length of the cut
    band_mm             ``(0.1, 0.3)``    mm       (low, high) of a band's length
    low_share           ``0.25``                   least height over the greatest, 0.2 to 1
    resolution          ``"fast"``                 of the plant: fast, default, fine
    mechanics           ``"modal"``                modal, or mujoco: friction and backlash count
    planner             ``"poscal"``               makes motor steps; exact has no greatest feed
    machine             ``None``                   `Machine`, name, file, mapping; None: standard
    materials           ``()``                     names, one is drawn; the machine's own if none
    height_mm           ``(4.0, 40.0)``   mm       greatest, or (low, high); None: the machine's
    tension             ``(8.0, 20.0)``   N        or (low, high); None: the machine's
    randomise           ``()``                     constants to draw; ``()`` for all, None for none
    machine_episodes    ``1``                      episodes a lane cuts with a drawn machine
    action              ``"change"``               change of the feed, speed: the feed, servo: a target
    knobs               ``()``                     on_time, period or duty_factor: further actions
    setting_octaves     ``2.0``           octaves  reach of the knobs either way, at most 4
    detents_us          ``(1.0, 5.0)``    us       steps of the knobs: on-time, period
    offset_um           ``None``          um       offset from the path of an action of 1; none if None
    decision_s          ``None``          s        machine time between actions; a window if None
    episode_s           ``25.0``          s        time of cutting that truncates an episode
    wires               ``1``                      wires before a break ends the episode
    max_feed_um_s       ``100.0``         um/s     largest feed either way
    max_change_um_s     ``4.0``           um/s     largest change of the feed per step
    start_feed_um_s     ``5.0``           um/s     feed before the first action
    servo_target_share  ``(0.0, 0.3)``             a servo's open shares at actions of -1 and 1
    servo_gains         ``(10.0, 30.0)``           um/s, and um/s per s, per unit of the error
    latency_s           ``0.0``           s        till a new feed counts, a window at most
    sensors             ``None``                   `Sensors` or a mapping: noise, steps, delay
    history             ``4``             steps    steps in an observation
    weights             ``None``                   `Weights`, or a mapping of those that differ
    objectives          ``()``                     terms that a vector reward has; a scalar if none
    near_corner_um      ``None``          um       path about a corner where errors count; all if None
    error_bound_um      ``None``          um       path error beyond which time costs
    energy_bound_mJ     ``None``          mJ       energy of a discharge beyond which time costs
    cost_limit          ``0.1``                    mean cost of an episode to keep to
    render_mode         ``None``                   ``"rgb_array"`` or ``"human"``
    ==================  ================  =======  ====================================================

    Versions
    --------
    v1: a lost wire costs what the machine loses while another is threaded; episodes end by machine time; nothing is
    earned while a wire settles; dials are shown and not drawn. v0 is withdrawn.
    """

    task = HeightStep


class HeightStepVectorEnv(EdmVectorEnv):
    """`HeightStepEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = HeightStep
