"""Trim: a finishing pass along a wavy wall, which is to become straight and end in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from edmsim.envs.arguments import Range, above_zero, ends_of
from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.reward import Weights
from edmsim.envs.scenario import Scenario, even_height
from edmsim.envs.single import EdmEnv
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.blanks import wavy_wall
from edmsim.plant.workpiece.wall import WallLine

GAP_UM = 20.0
"""Gap beside the wire for which the path is laid out (ours: what the standard set-up leaves)."""
ROOM_UM = 1.0
"""Least gap that the highest ridge must leave at first (ours)."""


@dataclass(frozen=True, kw_only=True)
class Trim(GapFeed):
    """A pass along a wavy wall.

    Parameters
    ----------
    wave_um, wave_mm : (low, high)
        Ranges of the waves' height from ridge to bottom, and of their length, drawn per episode.
    allowance_um : (low, high)
        Range of the metal that is to go, from the middle of the waves, drawn per episode.
    """

    length_mm: float = 1.0
    wave_um: tuple[float, float] = (4.0, 10.0)
    wave_mm: tuple[float, float] = (0.2, 0.6)
    allowance_um: tuple[float, float] = (4.0, 12.0)
    planner: str = "exact"
    height_mm: Range | None = (10.0, 40.0)
    action: Literal["change", "speed", "servo"] = "speed"
    knobs: Sequence[str] = ("on_time", "duty_factor")
    setting_octaves: float = 1.0
    offset_um: float | None = 12.0
    decision_s: float | None = 0.25
    episode_s: float | None = 60.0
    max_feed_um_s: float = 200.0
    energy_bound_mJ: float | None = 2.0

    finishes_wall: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(short=0.0, open=0.0, profile=4.0, roughness=4.0, time=0.5)

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        super().__post_init__()
        for name in ("wave_um", "wave_mm", "allowance_um"):
            for value in ends_of(name, getattr(self, name)):
                above_zero(name, value)
        proud_um = max(ends_of("allowance_um", self.allowance_um)) + max(ends_of("wave_um", self.wave_um)) / 2
        if proud_um > GAP_UM - ROOM_UM:
            raise InputError(
                f"allowance_um and half of wave_um may come to {proud_um:g} um, and the wire would stand in the "
                f"metal: {GAP_UM - ROOM_UM:g} um at the most"
            )

    @staticmethod
    def own_machine() -> Machine:
        """Return the laboratory machine with short pulses."""
        return Machine.load(t_on_us=10.0, t_period_us=60.0)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw allowance and waves, and where they begin: uniformly."""
        names = "allowance_um", "wave_um", "wave_mm"
        drawn |= {name: float(rng.uniform(*ends_of(name, getattr(self, name)))) for name in names}
        allowance_um, wave_um, wave_mm = (float(drawn[name]) for name in names)
        path = self.path_um(machine)
        x, y = (float(v) for v in path[0])
        wanted = WallLine(x, y - machine.wire_diameter_um / 2 - GAP_UM)
        stock = wavy_wall(
            (x, wanted.y_um + allowance_um), self.length_mm * 1e3, wave_um, wave_mm * 1e3,
            float(rng.uniform(0.0, wave_mm * 1e3)),
        )
        return Scenario(machine, stock, (path,), even_height(machine), seed, drawn, wall=wanted)


class TrimEnv(EdmEnv):
    """A finishing pass along a wavy wall: make it straight, and leave it in its place.

    Description
    -----------
    A coarse cut left a wall with waves, and some um too much of it. The wire passes along it once more, with short
    pulses, and takes that off. No front holds it back: it may go as fast as it will. The faster, the less is taken,
    most of it from the ridges, and the wall stays wavy and too high; the slower, the deeper the pulses eat into it.
    Where the wall ends depends on feed, power, what there was to take, and constants that nobody sees. Guides that go
    nearer to the wall or farther off it move it with them. It is measured behind the wire, for the reward and not
    for the observation: what is known of it is what its pulses show.

    Action space
    ------------
    ``Box(-1, 1, (4,), float32)``.

    =====  ===========  =====  =======================================  ==================
    Index  Name         Range  Meaning                                  Unit of 1
    =====  ===========  =====  =======================================  ==================
    0      feed         -1..1  feed along the wall                      ``max_feed_um_s``
    1      on_time      -1..1  on-time / first on-time, log2            ``setting_octaves``
    2      duty_factor  -1..1  period per on-time / first ratio, log2   ``setting_octaves``
    3      offset       -1..1  offset from the path, off the wall       ``offset_um``
    =====  ===========  =====  =======================================  ==================

    A negative feed runs back along the path, never beyond its start. With ``action="change"`` entry 0 changes the
    feed by up to ``max_change_um_s``, with ``action="servo"`` it is the share of open pulses that a servo holds, from
    ``servo_target_share[0]`` at -1 to ``servo_target_share[1]`` at 1. An action holds for ``decision_s``. Actions
    beyond the range are clipped; NaN raises `InvalidAction`.

    The guides go to the offset by one motor step of 2 um per window. On-time and period are rounded to 1 us and 5 us.
    A period that the generator refuses (above its mean current, or no pause) is not set: the shortest it accepts for
    that on-time is, and ``info["refused"]`` has the reason.

    Observation space
    -----------------
    ``Box((47,), float32)``: what a machine can measure and its operator knows, clipped to its range.

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
    46     offset          -1..1  offset from the path, left positive, um             ``offset_um``
    =====  ==============  =====  ==================================================  ==========================

    Entries 0 to 9 are of the last step; 10 to 39 are the same of the three steps before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 40 to 45 are the
    operator's dials.
    Entry 46 is the last action's.

    Reward
    ------
    The sum of the terms in ``info["reward_terms"]``, with weights w of `Weights`, where

    ======  =====================================================================
    Symbol  Meaning
    ======  =====================================================================
    P       area cut in the step / 0.01275 mm2, which is 30 mm2/min for 25.5 ms
    T       duration of the step / 25.5 ms, the window of 255 pulses of 100 us
    s, o    shares of short and of open pulses
    e       distance of the finished wall from where it is to be, um, root mean square
            over the height and 24 um of its length; 0 before there is any
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
    short       ``-w s T``            0
    open        ``-w o T``            0
    profile     ``-w (e / 10 um) P``  4
    roughness   ``-w g P``            4
    time        ``-w T``              0.5
    wire_break  ``-w B H``            1
    limit       ``-w L H``            1
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air; nor what the field
    pulls a fresh wire in its first 0.25 s. A lost wire costs what is lost at 30 mm2/min while another is threaded.
    ``info["cost"]`` is 1 for a lost wire or an end by a limit, and a second's worth for every second beyond a bound.
    The wall is measured 80 um behind the wire, where no more is taken from it: that of the last 100 um of the path
    counts no more.

    Starting state
    --------------
    The wire stands on the middle of the table, beside the wall, which is to end 20 um from the wire's edge: so the
    path is laid out. The metal to be taken off, from there to the middle of the waves, the height of the waves from
    ridge to bottom, and their length are drawn uniformly from ``allowance_um``, ``wave_um`` and ``wave_mm``. The
    waves are arcs with ridges between, as a row of wide holes leaves them. The generator has the machine's setting,
    10 us in 60 us. Machine, height, tension and material are drawn as the arguments say, and the plant's seed. The
    wire rests, and the observation is 0. ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 60 s of cutting (``episode_s``); ``info["dt_s"]`` is the machine time of a step.

    Arguments
    ---------
    ==================  ==============================  =======  ====================================================
    Name                Default                         Unit     Meaning
    ==================  ==============================  =======  ====================================================
    length_mm           ``1.0``                         mm       length of the pass
    wave_um             ``(4.0, 10.0)``                 um       (low, high) of the waves' height, ridge to bottom
    wave_mm             ``(0.2, 0.6)``                  mm       (low, high) of their length
    allowance_um        ``(4.0, 12.0)``                 um       (low, high) of the metal that is to go
    resolution          ``"fast"``                               of the plant: fast, default, fine
    mechanics           ``"modal"``                              modal, or mujoco: friction and backlash count
    planner             ``"exact"``                              makes motor steps; exact has no greatest feed
    machine             ``None``                                 `Machine`, name, file, mapping; None: standard
    materials           ``()``                                   names, one is drawn; the machine's own if none
    height_mm           ``(10.0, 40.0)``                mm       greatest, or (low, high); None: the machine's
    tension             ``(8.0, 20.0)``                 N        or (low, high); None: the machine's
    randomise           ``()``                                   constants to draw; ``()`` for all, None for none
    machine_episodes    ``1``                                    episodes a lane cuts with a drawn machine
    action              ``"speed"``                              change of the feed, speed: the feed, servo: a target
    knobs               ``('on_time', 'duty_factor')``           on_time, period or duty_factor: further actions
    setting_octaves     ``1.0``                         octaves  reach of the knobs either way, at most 4
    detents_us          ``(1.0, 5.0)``                  us       steps of the knobs: on-time, period
    offset_um           ``12.0``                        um       offset from the path of an action of 1; none if None
    decision_s          ``0.25``                        s        machine time between actions; a window if None
    episode_s           ``60.0``                        s        time of cutting that truncates an episode
    wires               ``1``                                    wires before a break ends the episode
    max_feed_um_s       ``200.0``                       um/s     largest feed either way
    max_change_um_s     ``4.0``                         um/s     largest change of the feed per step
    start_feed_um_s     ``5.0``                         um/s     feed before the first action
    servo_target_share  ``(0.0, 0.3)``                           a servo's open shares at actions of -1 and 1
    servo_gains         ``(10.0, 30.0)``                         um/s, and um/s per s, per unit of the error
    latency_s           ``0.0``                         s        till a new feed counts, a window at most
    sensors             ``None``                                 `Sensors` or a mapping: noise, steps, delay
    history             ``4``                           steps    steps in an observation
    weights             ``None``                                 `Weights`, or a mapping of those that differ
    objectives          ``()``                                   terms that a vector reward has; a scalar if none
    near_corner_um      ``None``                        um       path about a corner where errors count; None: all
    error_bound_um      ``None``                        um       path error beyond which time costs
    energy_bound_mJ     ``2.0``                         mJ       energy of a discharge beyond which it costs
    cost_limit          ``0.1``                                  mean cost of an episode to keep to
    render_mode         ``None``                                 ``"rgb_array"`` or ``"human"``
    ==================  ==============================  =======  ====================================================

    Versions
    --------
    v0: the first.
    """

    task = Trim


class TrimVectorEnv(EdmVectorEnv):
    """`TrimEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Trim
