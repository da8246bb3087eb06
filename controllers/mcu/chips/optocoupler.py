"""The optocouplers between the board and the machine: inversion and low-pass (4.2, 4.2.1; row T-84).

An AND gate buffers a line of the 8255 and drives the coupler's LED. Its light makes a FET conduct, which pulls the
machine's input to earth, logic 0; where the LED is dark, a pull-up resistor makes it 1. So a lit LED is a 0. Couplers
are slow, and keep the short impulses of the sparks away from the control.
"""

from __future__ import annotations

from typing import NamedTuple

SPARK_IMPULSE_NS = 1_000
"""Length of the impulse that a spark couples into the lines (ours: the time in which its current rises and rings)."""
STEP_PULSE_NS = 42_000
"""How long STEP stays high (ours: POSITI between both writes to the port, 130 T-states of 3.072 MHz)."""


class Optocouplers(NamedTuple):
    """The couplers of the control lines and switches.

    Attributes
    ----------
    led_lit_at : {0, 1}
        Level of the gate at which the LED is lit. The figure that shows it is lost; at 0 the gate sinks its current,
        and line and port have the same level (row T-A17).
    response_ns : int
        Changes that do not last as long do not pass (data sheet of the photo-FET couplers H11F: 15 us on and off).
    """

    led_lit_at: int = 0
    response_ns: int = 15_000

    def lines(self, port: int) -> int:
        """Return the levels at the machine of the eight bits of a port."""
        lit = port if self.led_lit_at else ~port
        return ~lit & 0xFF

    def passes(self, duration_ns: int) -> bool:
        """Whether a level that lasts so long gets through."""
        return duration_ns >= self.response_ns
