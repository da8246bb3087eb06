"""Contour: any part program, contour by contour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np

from edmsim.envs.arguments import Range
from edmsim.envs.reward import Weights
from edmsim.envs.scenario import Scenario, even_height
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import Family
from edmsim.envs.vector import EdmVectorEnv
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.program.path import CutPath, plan_path


@dataclass(frozen=True, kw_only=True)
class Contour(Family):
    """The contours of a part program.

    Parameters
    ----------
    program : path, optional
        Of `edmsim.program.path.plan_path`; a punch of 0.6 x 0.4 mm if not given. Dwells (G4) are left out.
    """

    program: str | Path | None = None
    height_mm: Range | None = (4.0, 20.0)
    episode_s: float | None = 300.0

    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=1.0, time=0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._cut  # noqa: B018 - refuses a program that cannot be cut

    @cached_property
    def _cut(self) -> tuple[Stock, CutPath]:
        offset_mm, table_um = self.base.auto_offset_mm, round(self.base.base.table.travel_mm.value * 1e3)
        if self.program is None:
            with resources.as_file(resources.files(__package__) / "small_punch.ngc") as file:
                path = plan_path(file, auto_offset_mm=offset_mm, table_um=table_um)
        else:
            path = plan_path(self.program, auto_offset_mm=offset_mm, table_um=table_um)
        x0, y0, x1, y1 = (1e3 * v for v in path.stock_mm)
        radius = path.start_hole_radius_mm * 1e3
        holes = tuple((float(c.points_um[0, 0]), float(c.points_um[0, 1]), radius) for c in path.contours)
        return Stock((x0, y0, x1, y1), holes), path

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Take the program's contours, one leg each; nothing is drawn for them."""
        stock, path = self._cut
        legs = tuple(c.points_um.astype(np.float64) for c in path.contours)
        return Scenario(machine, stock, legs, even_height(machine), seed, drawn, path.contours)


class ContourEnv(EdmEnv):
    """A part program, contour by contour: cut it fast and accurately.

    Description
    -----------
    The wire cuts the contours of a G-code program or a drawing one after another; between two of them a fresh wire
    is threaded. Distance from the path costs.

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
    ``Box((50,), float32)``: what a machine can measure and its operator knows, clipped to its range.

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
    =====  ==============  =====  ==================================================  ==========================

    Entries 0 to 9 are of the last step; 10 to 39 are the same of the three steps before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 40 to 45 are the
    operator's dials.
    Entries 46 to 49 know the program: a corner is a turn of 20 degrees or more.

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
    profile     ``-w (e / 10 um) P``  1
    roughness   ``-w g P``            0
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
    The wire is threaded in the start hole of the first contour. Nothing is drawn for the program. Machine, height,
    tension and material are drawn as the arguments say, and the plant's seed. The feed is ``start_feed_um_s``, or 0
    with ``action="speed"``, and the observation 0. ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 300 s of cutting (``episode_s``); ``info["dt_s"]`` is the machine time of a step.

    Arguments
    ---------
    ==================  ================  =======  ====================================================
    Name                Default           Unit     Meaning
    ==================  ================  =======  ====================================================
    program             ``None``                   G-code or DXF file; a punch of 0.6 x 0.4 mm if None
    resolution          ``"fast"``                 of the plant: fast, default, fine
    mechanics           ``"modal"``                modal, or mujoco: friction and backlash count
    planner             ``"poscal"``               makes motor steps; exact has no greatest feed
    machine             ``None``                   `Machine`, name, file, mapping; None: standard
    materials           ``()``                     names, one is drawn; the machine's own if none
    height_mm           ``(4.0, 20.0)``   mm       greatest, or (low, high); None: the machine's
    tension             ``(8.0, 20.0)``   N        or (low, high); None: the machine's
    randomise           ``()``                     constants to draw; ``()`` for all, None for none
    machine_episodes    ``1``                      episodes a lane cuts with a drawn machine
    action              ``"change"``               change of the feed, speed: the feed, servo: a target
    knobs               ``()``                     on_time, period or duty_factor: further actions
    setting_octaves     ``2.0``           octaves  reach of the knobs either way, at most 4
    detents_us          ``(1.0, 5.0)``    us       steps of the knobs: on-time, period
    offset_um           ``None``          um       offset from the path of an action of 1; none if None
    decision_s          ``None``          s        machine time between actions; a window if None
    episode_s           ``300.0``         s        time of cutting that truncates an episode
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

    task = Contour


class ContourVectorEnv(EdmVectorEnv):
    """`ContourEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Contour
