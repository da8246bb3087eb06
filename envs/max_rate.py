"""MaxRate: the fastest cut on a production machine whose wire breaks where it grows too hot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from edmsim.envs.arguments import Range, ends_of, within
from edmsim.envs.height_step import HeightStep
from edmsim.envs.reward import Weights
from edmsim.envs.single import EdmEnv
from edmsim.envs.vector import EdmVectorEnv
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants
from edmsim.machine.setting import LIMITS

PERIOD_US = 50.0
"""Period with which every wire begins, and from which the knob is turned (ours: two octaves to either side go from
where the gap takes no more to where hardly a wire breaks)."""
KNOWN_TO_SHARE = 0.15
"""How well a shop knows what of its machine decides on the wire's limit (ours): drawn from their whole ranges, these
constants leave no period at which no wire of any machine breaks."""
KNOWN = (
    "cooling.wire_heat_share", "cooling.convection_W_m2K", "cooling.critical_W_m2", "cooling.film_W_m2K",
    "material.removal_mm3_J",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MaxRate(HeightStep):
    """A straight cut through bands of drawn lengths and heights, on the production machine.

    Parameters
    ----------
    flushing_Pa : float or (low, high), optional
        Pressure of each nozzle, or the range each is drawn from, uniformly, per episode; the machine's own if None.
    """

    length_mm: float = 8.0
    band_mm: tuple[float, float] = (0.15, 0.5)
    planner: str = "exact"
    height_mm: Range | None = (30.0, 80.0)
    tension: Range | None = (18.0, 26.0)
    flushing_Pa: Range | None = (50e3, 300e3)
    action: Literal["change", "speed", "servo"] = "servo"
    knobs: Sequence[str] = ("period",)
    detents_us: tuple[float, float] = (0.1, 0.5)
    decision_s: float | None = 0.1
    wires: int = 20
    max_feed_um_s: float = 400.0
    start_feed_um_s: float = 10.0
    servo_gains: tuple[float, float] = (30.0, 100.0)

    own_weights: ClassVar[Weights] = Weights(short=0.0, open=0.0, wire_break=2.0, limit=2.0)
    locates_discharges: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        super().__post_init__()
        if self.flushing_Pa is not None:
            limit = LIMITS["flushing_lower_Pa"]
            for pressure_Pa in ends_of("flushing_Pa", self.flushing_Pa):
                within("flushing_Pa", pressure_Pa, limit.low, limit.high)

    @staticmethod
    def own_machine() -> Machine:
        """Return the production machine with a wire of 0.3 mm, as Sato et al. had it."""
        machine = Machine.load(
            "production", generator="production", wire="brass-300", height_mm=80.0, tension=22.0,
            t_period_us=PERIOD_US,
        )  # fmt: skip
        low, high = 1.0 - KNOWN_TO_SHARE, 1.0 + KNOWN_TO_SHARE
        uncertain = machine.uncertain()
        return with_constants(machine, {
            name: uncertain[name].model_copy(
                update={"range": (low * uncertain[name].value, high * uncertain[name].value)}
            )
            for name in KNOWN
        })  # fmt: skip

    @property
    def drawn_settings(self) -> dict[str, Range | None]:
        """Ranges of the operator's choices that an episode draws, by name."""
        nozzles = {"flushing_lower_Pa": self.flushing_Pa, "flushing_upper_Pa": self.flushing_Pa}
        return {**super().drawn_settings, **nozzles}


class MaxRateEnv(EdmEnv):
    """The fastest straight cut on a production machine, whose wire breaks where it grows too hot.

    Description
    -----------
    As `HeightStepEnv`, on a machine of today's class: a wire of 0.3 mm, pulses of 700 A and 1.4 us, a workpiece of
    30 to 80 mm with bands of a quarter of that and more. A servo feeds; actions set what it holds, and the period.
    The shorter the period, the more is cut, until water boils dry on the wire's hottest place: steam covers it, and
    it breaks within some 20 ms, which costs the machine 20 s. How short it may be depends on what nobody knows of
    the machine, and on how much of the height takes part: in a low band the same pulses heat a shorter piece of
    wire. Where the pulses ignite is seen: the current of each comes from both guides and divides as the wire's
    resistances do. The discharges' energy stays, as it decides on the surface.

    Action space
    ------------
    ``Box(-1, 1, (2,), float32)``, every 0.1 s.

    =====  ======  =====  ==================================================  ==============================
    Index  Name    Range  Meaning                                             Unit of 1
    =====  ======  =====  ==================================================  ==============================
    0      target  -1..1  share of open less short pulses that a servo holds  0 at -1, 0.3 at 1
    1      period  -1..1  pulse period over the first one, 50 us              ``setting_octaves`` powers of 2
    =====  ======  =====  ==================================================  ==============================

    Entry 0 goes from ``servo_target_share[0]`` at -1 to ``servo_target_share[1]`` at 1; with ``action="change"`` it
    changes the feed, with ``"speed"`` it is the feed. Actions beyond the range are clipped; NaN raises
    `InvalidAction`. The period is that of a pulse that ignites at once: others take as much longer as they wait.

    Observation space
    -----------------
    ``Box((66,), float32)``: what a machine can measure and its operator knows, clipped to its range.

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
    10     fifth_1         0..1   ignitions in fifth 1 of the height, from below   ignitions of the step
    11     fifth_2         0..1   ignitions in fifth 2 of the height, from below   ignitions of the step
    12     fifth_3         0..1   ignitions in fifth 3 of the height, from below   ignitions of the step
    13     fifth_4         0..1   ignitions in fifth 4 of the height, from below   ignitions of the step
    14     fifth_5         0..1   ignitions in fifth 5 of the height, from below   ignitions of the step
    60     tension         0..10  tension of the wire, N                           10 N
    61     wire_diameter   0..4   diameter of the wire, um                         100 um
    62     height          0..8   height of the workpiece, the greatest, mm        50 mm
    63     flushing_lower  0..30  pressure of the lower nozzle, Pa                 1 bar
    64     flushing_upper  0..30  pressure of the upper nozzle, Pa                 1 bar
    65     wire_speed      0..15  speed of the running wire, m/s                   1 m/s
    =====  ==============  =====  ===============================================  ==========================

    Entries 0 to 14 are of the last step; 15 to 59 are the same of the three steps before, the latest first, 0
    where no window has been fired. With another ``history`` there are more or fewer of them. Entries 60 to 65 are the
    operator's dials. Fifths are of the greatest height, and a discharge is located with an error of 2 mm (standard
    deviation). Local heights below the greatest are not shown.

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
    H       time to thread another wire / 25.5 ms: 784 for 20 s
    ======  =====================================================================

    and

    ==========  ====================  ======
    Term        Value                 Weight
    ==========  ====================  ======
    progress    ``w P``               1
    short       ``-w s T``            0
    open        ``-w o T``            0
    profile     ``-w (e / 10 um) P``  0
    roughness   ``-w g P``            0
    time        ``-w T``              0
    wire_break  ``-w B H``            2
    limit       ``-w L H``            2
    done        ``w D``               0
    ==========  ====================  ======

    Area is length of path times local height. What is cut follows the wire's true place by the share of pulses that
    ignite: pushing a bent wire into a short gains nothing, nor does going back and forth, nor air; nor what the field
    pulls a fresh wire in its first 0.25 s. A lost wire costs what is lost at 60 mm2/min while another is threaded.
    ``info["cost"]`` is 1 for a lost wire or an end by a limit, and a second's worth for every second beyond a bound.

    Starting state
    --------------
    The wire stands on the middle of the table, in a slot, 25 um off the metal. The first band has the greatest
    height; the length of each band is drawn uniformly from ``band_mm``, the height of each further one uniformly
    from ``low_share`` to 1 times the greatest. Height, tension and the pressure of each nozzle are drawn uniformly,
    as an operator would have set them, and are shown. Constants of the machine are drawn within their ranges; the
    share of heat that enters the wire, convection, critical heat flux, film boiling and removal within 15 % of the
    files' values: so much a shop knows of its machine (ours). The period is 50 us and the feed ``start_feed_um_s``,
    for every wire, and the observation 0. ``info["drawn"]`` has what was drawn.

    End of the episode
    ------------------
    Terminated, with the reason in ``info["cause"]``: the path's end is reached (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); 2 s of windows with 90 % shorts and more
    (``persistent-short``); the wire is pushed further than the plant's model holds for (``out-of-range``). There are
    20 wires: a break ends no episode before the last.

    Truncated after 25 s of cutting (``episode_s``); ``info["dt_s"]`` is the machine time of a step.

    Arguments
    ---------
    ==================  =======================  =======  ====================================================
    Name                Default                  Unit     Meaning
    ==================  =======================  =======  ====================================================
    length_mm           ``8.0``                  mm       length of the cut
    band_mm             ``(0.15, 0.5)``          mm       (low, high) of a band's length
    low_share           ``0.25``                          least height over the greatest, 0.2 to 1
    resolution          ``"fast"``                        of the plant: fast, default, fine
    mechanics           ``"modal"``                       modal, or mujoco: friction and backlash count
    planner             ``"exact"``                       makes motor steps; exact has no greatest feed
    machine             ``None``                          `Machine`, name, file, mapping; None: production
    materials           ``()``                            names, one is drawn; the machine's own if none
    height_mm           ``(30.0, 80.0)``         mm       greatest, or (low, high); None: the machine's
    tension             ``(18.0, 26.0)``         N        or (low, high); None: the machine's
    flushing_Pa         ``(50000.0, 300000.0)``  Pa       of each nozzle, or (low, high); None: the machine's
    randomise           ``()``                            constants to draw; ``()`` for all, None for none
    machine_episodes    ``1``                             episodes a lane cuts with a drawn machine
    action              ``"servo"``                       change of the feed, speed: the feed, servo: a target
    knobs               ``("period",)``                   on_time, period or duty_factor: further actions
    setting_octaves     ``2.0``                  octaves  reach of the knobs either way, at most 4
    detents_us          ``(0.1, 0.5)``           us       steps of the knobs: on-time, period
    offset_um           ``None``                 um       offset from the path of an action of 1; none if None
    decision_s          ``0.1``                  s        machine time between actions; a window if None
    episode_s           ``25.0``                 s        time of cutting that truncates an episode
    wires               ``20``                            wires before a break ends the episode
    max_feed_um_s       ``400.0``                um/s     largest feed either way
    max_change_um_s     ``4.0``                  um/s     largest change of the feed per step
    start_feed_um_s     ``10.0``                 um/s     feed before the first action
    servo_target_share  ``(0.0, 0.3)``                    a servo's open shares at actions of -1 and 1
    servo_gains         ``(30.0, 100.0)``                 um/s, and um/s per s, per unit of the error
    latency_s           ``0.0``                  s        till a new feed counts, a window at most
    sensors             ``None``                          `Sensors` or a mapping: noise, steps, delay
    history             ``4``                    steps    steps in an observation
    weights             ``None``                          `Weights`, or a mapping of those that differ
    objectives          ``()``                            terms that a vector reward has; a scalar if none
    near_corner_um      ``None``                 um       path about a corner where errors count; all if None
    error_bound_um      ``None``                 um       path error beyond which time costs
    energy_bound_mJ     ``None``                 mJ       energy of a discharge beyond which time costs
    cost_limit          ``0.1``                           mean cost of an episode to keep to
    render_mode         ``None``                          ``"rgb_array"`` or ``"human"``
    ==================  =======================  =======  ====================================================

    Versions
    --------
    v0: the first.
    """

    task = MaxRate


class MaxRateVectorEnv(EdmVectorEnv):
    """`MaxRateEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = MaxRate
