"""One control cycle: motor steps, a window of 255 pulses, an observation, a decision.

It serves every cut that Python runs window by window: of a program (`edmsim.cosim.simulation`) and straight ones
(`edmsim.cosim.straight`). Environments run many sub-environments in compiled calls, and the terminal's rig decides by
interrupts; they share what is around it: `WindowObservation.of`, `edmsim.cosim.stops`, the rules of legs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from edmsim.controllers.protocols import WindowObservation
from edmsim.cosim.motion import Motion
from edmsim.cosim.observers import Observer, Turn
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.plant import Plant


class Cycle:
    """Plant, motion and controller in step: observers see every window; what `decide` says counts from the next."""

    def __init__(
        self, plant: Plant, motion: Motion, decide: Callable[[WindowObservation], None],
        observers: Sequence[Observer] = (),
    ) -> None:
        self.motion = motion
        self._plant = plant
        self._decide = decide
        self._observers = observers

    def turn(self) -> Turn:
        """Run one window."""
        plant, motion = self._plant, self.motion
        start_ns = plant.time_ns
        steps = motion.plan(start_ns, start_ns + plant.longest_window_ns, plant.window_ns > 0)
        window = plant.advance(steps)
        motion.keep(start_ns, plant.time_ns)
        turn = Turn(window, plant.time_ns, motion.feed_um_s, motion.path_um, plant.opposite_pulses())
        for observer in self._observers:
            observer.window(turn, plant)
        if window.pulses == WINDOW_PULSES:
            self._decide(WindowObservation.of(window, turn.time_ns, turn.feed_um_s, turn.path_um))
        return turn
