"""ThinWire: a wire of 0.1 mm with an unknown limit; a few may break until a policy finds it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from edmsim.envs.arguments import Range
from edmsim.envs.environment import EdmEnv
from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.page import page
from edmsim.envs.reward import Weights
from edmsim.machine.machine import Machine


@dataclass(frozen=True, kw_only=True)
class ThinWire(GapFeed):
    """A straight cut with a thin wire that a servo feeds; an action sets the servo's target and the pause.

    Further parameters: see `GapFeed`.
    """

    length_mm: float = 8.0
    height_mm: Range | None = (4.0, 20.0)
    tension: Range | None = (1.2, 3.2)
    action: Literal["change", "speed", "servo"] = "servo"
    knobs: Sequence[str] = ("duty_factor",)
    decision_s: float | None = 0.5
    episode_s: float | None = 120.0
    wires: int = 4

    knows_wires: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(short=0.0, open=0.0)  # area alone

    @staticmethod
    def own_machine() -> Machine:
        """Return the laboratory machine with a brass wire of 0.1 mm and short pulses."""
        return Machine.load(wire="brass-100", t_on_us=7.0, t_period_us=100.0)


@page
class ThinWireEnv(EdmEnv):
    """A straight cut with brass wire of 0.1 mm: find the power that the wire survives on this machine.

    Description
    -----------
    A thin wire breaks when it becomes too hot. Its heating and cooling cannot be observed, and the power that is safe
    on one machine breaks the wire on another. A few wires may break in an episode, and each costs the time of
    threading the next. The task is to find the setting for the machine at hand at a low cost: adaptation, for
    learners with a memory. A servo sets the feed.

    Starting state
    --------------
    The wire is in the middle of the table, in a slot, 25 um from the metal.

    Versions
    --------
    v1: debris ignites the gap, jets bend the wire, and water carries heat and gas away behind it; pulses last 7 us in
    place of 10. v0 is withdrawn.
    """

    task = ThinWire
