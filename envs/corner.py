"""Corner: a sharp turn to be cut accurately by a wire that bends, with a bound on the energy of discharges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from edmsim.envs.arguments import Range, above_zero, ends_of
from edmsim.envs.reward import Weights
from edmsim.envs.scenario import Scenario, even_height
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import CORNER_DEG, Family
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.blanks import begun_slot

SHARPEST_DEG = 160.0
"""Sharpest turn that may be asked for (ours: beyond it the second leg runs back in the first one's kerf)."""


@dataclass(frozen=True, kw_only=True)
class Corner(Family):
    """Two legs with a sharp turn between.

    Parameters
    ----------
    leg_mm : float
        Length of each leg.
    turn_deg : (low, high)
        Range of the turn, drawn per episode, to the left or to the right.
    """

    leg_mm: float = 0.3
    turn_deg: tuple[float, float] = (45.0, 135.0)
    height_mm: Range | None = (20.0, 60.0)
    tension: Range | None = (6.0, 12.0)
    action: Literal["change", "speed", "servo"] = "servo"
    knobs: Sequence[str] = ("on_time", "duty_factor")
    offset_um: float | None = 24.0
    decision_s: float | None = 0.25
    episode_s: float | None = 200.0
    near_corner_um: float | None = 100.0
    energy_bound_mJ: float | None = 5.5

    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=4.0, roughness=4.0, time=0.1)  # accuracy first

    def __post_init__(self) -> None:
        super().__post_init__()
        above_zero("leg_mm", self.leg_mm, self.reach_mm / 2)
        low, high = ends_of("turn_deg", self.turn_deg)
        if not CORNER_DEG <= low <= high <= SHARPEST_DEG:
            raise InputError(
                f"turn_deg is {self.turn_deg!r}: give a range within {CORNER_DEG:g} to {SHARPEST_DEG:g} degrees"
            )

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw the turn: uniformly, to either side with the same probability."""
        turn = float(rng.uniform(*self.turn_deg)) * (1 if rng.random() < 0.5 else -1)
        leg, (x, y) = self.leg_mm * 1e3, machine.base.table.centre_um
        angle = math.radians(turn)
        path = np.array(
            [(x, y), (x + leg, y), (x + leg + leg * math.cos(angle), y + leg * math.sin(angle))], np.float64
        )
        drawn |= {"turn_deg": turn}
        return Scenario(machine, begun_slot(machine, (x, y)), (path,), even_height(machine), seed, drawn)


class CornerEnv(EdmEnv):
    """Two legs with a sharp turn between: cut it accurately, with a servo's target, pulse generator and path offset.

    Description
    -----------
    The field pulls a slack wire ahead, by up to 20 um in a high workpiece, and gas pushes it back; where the path
    turns, it leaves the path. Distance from the path costs within 100 um of the corner, and time costs everywhere.
    Guides that go beside the path bring the wire back on it, if they know by how much it is bent; and pauses there
    weaken the forces. More energy in a discharge bends the wire less, but makes a rougher face: beyond the bound it
    costs more than it gains.

    Action space
    ------------
    ``Box(-1, 1, (4,), float32)``.

    =====  ===========  =====  =======================================  ======================
    Index  Name         Range  Meaning                                  Unit of 1
    =====  ===========  =====  =======================================  ======================
    0      target       -1..1  share of open pulses that a servo holds  ``servo_target_share``
    1      on_time      -1..1  on-time / first on-time, log2            ``setting_octaves``
    2      duty_factor  -1..1  period per on-time / first ratio, log2   ``setting_octaves``
    3      offset       -1..1  offset from the path, left positive      ``offset_um``
    =====  ===========  =====  =======================================  ======================

    Entry 0 is ``servo_target_share[0]`` at -1 and ``servo_target_share[1]`` at 1; the servo makes the feed window by
    window. With ``action="change"`` entry 0 changes the feed by up to ``max_change_um_s``, with ``action="speed"`` it
    is the feed, in units of ``max_feed_um_s``; a negative feed runs back along the path, never beyond its start. An
    action holds for ``decision_s``. Actions beyond the range are clipped; NaN raises `InvalidAction`.

    The guides go to the offset by one motor step of 2 um per axis and window, and follow it round the corner: it is
    to the left of where the path leads. On-time and period are rounded to 1 us and 5 us. A period that the generator
    refuses (above its mean current, or no pause) is not set: the shortest it accepts for that on-time is, and
    ``info["refused"]`` has the reason.

    Observation space
    -----------------
    ``Box((51,), float32)``: what a machine can measure and its operator knows, clipped to its range.

    =====  ==============  =====  ==================================================  ==========================
    Index  Name            Range  Quantity                                            Divided by
    =====  ==============  =====  ==================================================  ==========================
    0      short           0..1   short pulses                                        pulses of the step
    1      open            0..1   open pulses                                         pulses of the step
    2      spark           0..1   pulses that ignited; sparks and arcs look alike     pulses of the step
    3      mean_voltage    0..1   mean gap voltage, V                                 open voltage, V
    4      mean_current    0..4   mean gap current, A                                 generator's limit of it, A
    5      mean_delay      0..1   mean ignition delay, us; 1 if nothing ignited       longest wait for it, us
    6      commanded_feed  -1..1  commanded feed, um/s                                ``max_feed_um_s``
    7      actual_feed     -1..1  feed by the position counters, um/s                 ``max_feed_um_s``
    8      t_on            0..1   log10 of the on-time in us                          3
    9      t_period        0..1   log10 of the pulse period in us                     4
    40     tension         0..10  tension of the wire, N                              10 N
    41     wire_diameter   0..4   diameter of the wire, um                            100 um
    42     height          0..8   height of the workpiece, the greatest, mm           50 mm
    43     flushing_lower  0..30  pressure of the lower nozzle, Pa                    1 bar
    44     flushing_upper  0..30  pressure of the upper nozzle, Pa                    1 bar
    45     wire_speed      0..15  speed of the running wire, m/s                      1 m/s
    46     corner_ahead    0..1   path to the next corner, mm; 1 if none is nearer    1 mm
    47     corner_turn     -1..1  its turn, left positive; 0 if none is within 1 mm   180 degrees
    48     corner_behind   0..1   path from the last corner, mm; 1 if none is nearer  1 mm
    49     corner_turned   -1..1  its turn, left positive; 0 if none is within 1 mm   180 degrees
    50     offset          -1..1  offset from the path, left positive, um             ``offset_um``
    =====  ==============  =====  ==================================================  ==========================

    Entries 0 to 9 are of the last step; 10 to 39 are the same of the three steps before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 40 to 45 are the
    operator's dials.
    Entries 46 to 49 know the program: a corner is a turn of 20 degrees or more. Entry 50 is the last action's.

    Reward
    ------
    The sum of the terms in ``info["reward_terms"]``, with weights w of `Weights`, where

    ======  =====================================================================
    Symbol  Meaning
    ======  =====================================================================
    P       area cut in the step / 0.01275 mm2, which is 30 mm2/min for 25.5 ms
    T       duration of the step / 25.5 ms, the window of 255 pulses of 100 us
    s, o    shares of short and of open pulses
    e       distance of the wire's true place from the path, um; 0 where no corner is
            within ``near_corner_um`` of path
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
    profile     ``-w (e / 10 um) P``  4
    roughness   ``-w g P``            4
    time        ``-w T``              0.1
    wire_break  ``-w B H``            1
    limit       ``-w L H``            1
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air; nor what the field
    pulls a fresh wire in its first 0.25 s. A lost wire costs what is lost at 30 mm2/min while another is threaded.
    ``info["cost"]`` is 1 for a lost wire or an end by a limit, and a second's worth for every second beyond a bound.
    The error e is of the table's true place and the mean deflection, over height and window; the kerf's edge, which
    also carries changes of the side gap, takes too long to measure at every step.

    Starting state
    --------------
    The wire stands on the middle of the table, in a slot, 25 um off the metal. The turn is drawn uniformly from
    ``turn_deg``, to the left or the right with the same probability. The generator has the machine's setting.
    Machine, height, tension and material are drawn as the arguments say, and the plant's seed. The feed is
    ``start_feed_um_s``, and the observation 0. ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 200 s of cutting (``episode_s``); ``info["dt_s"]`` is the machine time of a step.

    Arguments
    ---------
    ==================  ==============================  =======  ====================================================
    Name                Default                         Unit     Meaning
    ==================  ==============================  =======  ====================================================
    leg_mm              ``0.3``                         mm       length of each leg
    turn_deg            ``(45.0, 135.0)``               degrees  (low, high) of the turn, within 20 to 160
    resolution          ``"fast"``                               of the plant: fast, default, fine
    mechanics           ``"modal"``                              modal, or mujoco: friction and backlash count
    planner             ``"poscal"``                             makes motor steps; exact has no greatest feed
    machine             ``None``                                 `Machine`, name, file, mapping; None: standard
    materials           ``()``                                   names, one is drawn; the machine's own if none
    height_mm           ``(20.0, 60.0)``                mm       greatest, or (low, high); None: the machine's
    tension             ``(6.0, 12.0)``                 N        or (low, high); None: the machine's
    randomise           ``()``                                   constants to draw; ``()`` for all, None for none
    machine_episodes    ``1``                                    episodes a lane cuts with a drawn machine
    action              ``"servo"``                              change of the feed, speed: the feed, servo: a target
    knobs               ``('on_time', 'duty_factor')``           on_time, period or duty_factor: further actions
    setting_octaves     ``2.0``                         octaves  reach of the knobs either way, at most 4
    detents_us          ``(1.0, 5.0)``                  us       steps of the knobs: on-time, period
    offset_um           ``24.0``                        um       offset from the path of an action of 1; none if None
    decision_s          ``0.25``                        s        machine time between actions; a window if None
    episode_s           ``200.0``                       s        time of cutting that truncates an episode
    wires               ``1``                                    wires before a break ends the episode
    max_feed_um_s       ``100.0``                       um/s     largest feed either way
    max_change_um_s     ``4.0``                         um/s     largest change of the feed per step
    start_feed_um_s     ``5.0``                         um/s     feed before the first action
    servo_target_share  ``(0.0, 0.3)``                           a servo's open shares at actions of -1 and 1
    servo_gains         ``(10.0, 30.0)``                         um/s, and um/s per s, per unit of the error
    latency_s           ``0.0``                         s        till a new feed counts, a window at most
    sensors             ``None``                                 `Sensors` or a mapping: noise, steps, delay
    history             ``4``                           steps    steps in an observation
    weights             ``None``                                 `Weights`, or a mapping of those that differ
    objectives          ``()``                                   terms that a vector reward has; a scalar if none
    near_corner_um      ``100.0``                       um       path about a corner where errors count; None: all
    error_bound_um      ``None``                        um       path error beyond which time costs
    energy_bound_mJ     ``5.5``                         mJ       energy of a discharge beyond which it costs
    cost_limit          ``0.1``                                  mean cost of an episode to keep to
    render_mode         ``None``                                 ``"rgb_array"`` or ``"human"``
    ==================  ==============================  =======  ====================================================

    Versions
    --------
    v1: a lost wire costs what the machine loses while another is threaded; episodes end by machine time; nothing is
    earned while a wire settles; dials are shown and not drawn; errors count near the corner, and energy beyond the
    bound costs; a servo makes the feed; workpieces are higher, wires slacker, and an action leads the guides beside
    the path. v0 is withdrawn.
    """

    task = Corner


class CornerVectorEnv(EdmVectorEnv):
    """`CornerEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Corner
