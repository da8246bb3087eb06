"""MaxRate: cut as fast as possible on a production machine whose wire breaks when it is too hot."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from edmsim.envs.arguments import Range, argument, ends_of, shows_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.height_step import HeightStep
from edmsim.envs.page import page
from edmsim.envs.reward import Weights
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants
from edmsim.machine.setting import LIMITS
from edmsim.numeric import within

PERIOD_US = 50.0
"""Period with which every wire begins, and from which the knob is turned (ours: two octaves to either side go from
where the gap takes no more to where hardly a wire breaks)."""
KNOWN_TO_SHARE = 0.15
"""How well a shop knows what of its machine decides on the wire's limit (ours): drawn from their whole ranges, these
constants leave no period at which no wire of any machine breaks."""
KNOWN = (
    "cooling.wire_heat_share", "cooling.convection_W_m2K", "cooling.critical_W_m2", "cooling.critical_stream",
    "cooling.film_W_m2K", "material.removal_mm3_J",
)  # fmt: skip


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class MaxRate(HeightStep):
    """A straight cut through bands of drawn lengths and heights, on the production machine.

    Parameters
    ----------
    {arguments}
    """

    length_mm: float = 8.0
    band_mm: Range = (0.15, 0.5)
    height_mm: Range | None = (30.0, 80.0)
    tension: Range | None = (18.0, 26.0)
    flushing_Pa: Range | None = argument(
        (50e3, 300e3), "Pa", "pressure of each nozzle, or (low, high); None: the machine's"
    )
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
        """Refuse what cannot be used, the pressures by the name of their argument."""
        if self.flushing_Pa is not None:
            limit = LIMITS["flushing_lower_Pa"]
            for pressure_Pa in ends_of("flushing_Pa", self.flushing_Pa):
                within("flushing_Pa", pressure_Pa, limit.low, limit.high)
        super().__post_init__()

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


@page
class MaxRateEnv(EdmEnv):
    """The fastest straight cut on a production machine, whose wire breaks where it becomes too hot.

    Description
    -----------
    This is `HeightStepEnv` on a modern machine: a wire of 0.3 mm, pulses of 700 A and 1.4 us, a workpiece of 30 to
    80 mm with bands of a quarter of that or more. Actions set the target of the servo and the pulse period. A
    shorter period cuts more, until the water on the wire's hottest place boils: steam covers it, and the wire breaks
    within some 20 ms, which costs the machine 20 s. The shortest possible period depends on unknown constants of the
    machine and on the local height: in a low band the same pulses heat a shorter piece of wire. The places of
    discharges are observed, as the current of a discharge comes from both guides in the ratio of the wire's
    resistances. The energy of discharges is fixed, as it determines the surface.

    Action space
    ------------
    The period is that of a pulse that ignites at once; the period of others is longer by their ignition delay.

    Observation space
    -----------------
    Local heights below the greatest are not observed.

    Starting state
    --------------
    The wire is in the middle of the table, in a slot, 25 um from the metal. The first band has the greatest height.
    The length of each band is drawn uniformly from ``band_mm``, the height of each further band uniformly from
    ``low_share`` to 1 times the greatest. Height, tension and the pressure of each nozzle are drawn uniformly and
    observed, as an operator knows them. The share of heat that enters the wire, convection, critical heat flux in
    still water and in a stream, film boiling and removal are drawn within 15 % of the files' values, our assumption
    of what a shop knows of its machine.

    Versions
    --------
    v1: debris ignites the gap, jets bend the wire, and water carries heat and gas away behind it. v0 is withdrawn.
    """

    task = MaxRate
