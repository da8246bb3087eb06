"""Contour: any part program, contour by contour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np

from edmsim.envs.reward import Weights
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import Family, Scenario, even_height
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
        Of `edmsim.program.path.plan_path`; a punch of 1.5 x 1 mm if not given. Dwells (G4) are left out.
    """

    program: str | Path | None = None

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

    With ``action="speed"`` the entry is the feed, in units of ``max_feed_um_s``. A negative feed runs back along
    the path, never beyond its start. Actions beyond the range are clipped; NaN raises `InvalidAction`.

    Observation space
    -----------------
    ``Box((43,), float32)``: what a machine can measure, clipped to its range.

    =====  ==============  =====  ==================================================  ==========================
    Index  Name            Range  Quantity                                            Divided by
    =====  ==============  =====  ==================================================  ==========================
    0      short           0..1   short pulses                                        pulses of the window
    1      open            0..1   open pulses                                         pulses of the window
    2      spark           0..1   pulses that ignited; sparks and arcs look alike     pulses of the window
    3      mean_voltage    0..1   mean gap voltage, V                                 open voltage, V
    4      mean_current    0..4   mean gap current, A                                 generator's limit of it, A
    5      mean_delay      0..1   mean ignition delay, us; 1 if nothing ignited       longest wait for it, us
    6      commanded_feed  -1..1  commanded feed, um/s                                ``max_feed_um_s``
    7      actual_feed     -1..1  feed by the position counters, um/s                 ``max_feed_um_s``
    8      t_on            0..8   on-time, us                                         first on-time, us
    9      t_period        0..16  pulse period, us                                    first pulse period, us
    40     corner_ahead    0..1   path to the next corner, mm; 1 if none is nearer    1 mm
    41     corner_turn     -1..1  its turn, left positive; 0 if none is within 1 mm   180 degrees
    42     corner_behind   0..1   path from the last corner, mm; 1 if none is nearer  1 mm
    =====  ==============  =====  ==================================================  ==========================

    Entries 0 to 9 are of the last window; 10 to 39 are the same of the three windows before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 40 to 42 know
    the program: a corner is a turn of 20 degrees or more.

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
    profile     ``-w (e / 10 um) P``  1
    time        ``-w T``              0.1
    wire_break  ``-w B``              100
    limit       ``-w L``              100
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air. The error e is
    of position counters and mean deflection, over height and window; the kerf's edge, which also carries changes of
    the side gap, takes too long to measure at every step.

    Starting state
    --------------
    The wire is threaded in the start hole of the first contour. Nothing is drawn for the program. Machine, height,
    tension and material are drawn as the arguments say, and the plant's seed. The feed is ``start_feed_um_s``, or 0
    with ``action="speed"``, and the observation 0. ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``).

    Truncated after 20,000 windows (``max_episode_steps`` of `gymnasium.make`).

    Arguments
    ---------
    ===============  =============  =======  =====================================================================
    Name             Default        Unit     Meaning
    ===============  =============  =======  =====================================================================
    program          ``None``                G-code or DXF file; a punch of 1.5 x 1 mm if None
    resolution       ``"default"``           of the plant: ``"fast"`` to train, ``"default"``, ``"fine"``
    machine          ``None``                a `Machine`, its name, TOML file or mapping; the standard one if None
    materials        ``()``                  names, one of which is drawn; the machine's own if none
    height_mm        ``None``       mm       greatest height, or (low, high); the machine's own if None
    tension          ``None``       N        of the wire, or (low, high); the machine's own if None
    randomise        ``None``                constants to draw within their ranges; ``()`` for all
    action           ``"change"``            ``"change"`` of the feed, or ``"speed"``: the feed itself
    max_feed_um_s    ``100.0``      um/s     largest feed either way
    max_change_um_s  ``4.0``        um/s     largest change of the feed per window
    start_feed_um_s  ``5.0``        um/s     feed before the first action
    history          ``4``          windows  windows in an observation
    weights          ``None``                `Weights`, or a mapping of those that differ; above if None
    planner          ``"poscal"``            makes the motor steps; ``"exact"`` has no greatest feed of its own
    render_mode      ``None``                ``"rgb_array"`` or ``"human"``
    ===============  =============  =======  =====================================================================

    Versions
    --------
    v0: first version.
    """

    task = Contour


class ContourVectorEnv(EdmVectorEnv):
    """`ContourEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Contour
