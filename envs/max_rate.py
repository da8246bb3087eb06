"""MaxRate: the fastest cut on a production machine whose wire breaks if it grows too hot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from edmsim.envs.arguments import Range
from edmsim.envs.height_step import HeightStep
from edmsim.envs.reward import Weights
from edmsim.envs.single import EdmEnv
from edmsim.envs.vector import EdmVectorEnv
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants

PERIOD_US = 50.0
KNOWN_TO_SHARE = 0.15
_KNOWN = ("cooling.wire_heat_share", "cooling.convection_W_m2K", "cooling.critical_W_m2", "cooling.film_W_m2K", "material.removal_mm3_J")


@dataclass(frozen=True, kw_only=True)
class MaxRate(HeightStep):
    length_mm: float = 8.0
    band_mm: tuple[float, float] = (0.15, 0.5)
    planner: str = "exact"
    height_mm: Range | None = (30.0, 80.0)
    tension: Range | None = (18.0, 26.0)
    flushing_Pa: Range | None = (0.5e5, 3e5)
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

    @staticmethod
    def own_machine() -> Machine:
        machine = Machine.load(
            "production", generator="production", wire="brass-300", height_mm=80.0, tension=22.0, t_period_us=PERIOD_US
        )
        low, high = 1.0 - KNOWN_TO_SHARE, 1.0 + KNOWN_TO_SHARE
        known = {
            name: c.model_copy(update={"range": (low * c.value, high * c.value)})
            for name, c in machine.uncertain().items() if name in _KNOWN
        }
        return with_constants(machine, known)

    @property
    def drawn_settings(self) -> dict[str, Range | None]:
        nozzles = {"flushing_lower_Pa": self.flushing_Pa, "flushing_upper_Pa": self.flushing_Pa}
        return {**super().drawn_settings, **nozzles}


class MaxRateEnv(EdmEnv):
    """Fastest cut."""

    task = MaxRate


class MaxRateVectorEnv(EdmVectorEnv):
    """`MaxRateEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = MaxRate
