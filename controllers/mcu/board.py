"""The board: all chips at their addresses, and the lines through optocouplers to machine and generator.

The optocouplers invert and low-pass (4.2, 4.2.1; row T-84). An AND gate buffers a line of the 8255 and drives the
coupler's LED. Its light makes a FET conduct, which pulls the machine's input to earth, logic 0; if the LED is off, a
pull-up resistor makes it 1. So a lit LED means 0. The slow couplers filter out the short impulses of the sparks.
"""

import random
from collections.abc import Callable, Mapping, Set
from functools import partial
from typing import Any, NamedTuple

from edmsim.controllers.mcu.chips import bus, ppi
from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.chips.dac import COARSE, PulseGeneratorLine, PulseSettings
from edmsim.controllers.mcu.chips.display import Kdc8279
from edmsim.controllers.mcu.chips.pic import EMERGENCY, KEYBOARD, Pic8259
from edmsim.controllers.mcu.chips.pit import Pit8253
from edmsim.controllers.mcu.chips.ppi import Ppi8255
from edmsim.controllers.mcu.chips.uart import Usart8251
from edmsim.controllers.mcu.firmware.poscal import BYTE
from edmsim.controllers.protocols import Step
from edmsim.controllers.pulse_counters import PulseAnalyser
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

# Injection of the two faults that the 1982 machine still had (rows T-29, T-30).
# Their probabilities are ours. Draws are numbered, so faults are reproducible with the same seed and history.

NOISE_FROM_A = 1.5  # mean current above which sparks disturb the serial lines (row T-29)
DROPS_BELOW_V, RUNS_FROM_V = 6.5, 7.0
"""V(t(p)) below which the generator drops out, and from which it always runs (row T-A5)."""


class _Drawn(Snapshots):
    """A fault with a probability; its state is the number of draws."""

    def __init__(self, seed: int, chance: float) -> None:
        self._random = random.Random(seed)
        self._seed, self.chance, self.drawn = seed, chance, 0

    def draw(self) -> bool:
        """Return whether the fault occurs."""
        self.drawn += 1
        return self._random.random() < self.chance

    def restore(self, state: Mapping[str, Any]) -> None:
        """Load a snapshot."""
        super().restore(state)
        self._random, drawn, self.drawn = random.Random(self._seed), self.drawn, 0
        for _ in range(drawn):
            self.draw()


class SerialNoise(_Drawn):
    """Inverts a bit of a character with a probability (ours) while the mean current is above 1.5 A."""

    STATE = ("drawn", "disturbed")

    def __init__(self, seed: int, chance: float = 0.05) -> None:
        super().__init__(seed, chance)
        self.disturbed = self._bit = 0

    def draw(self) -> bool:
        """Draw also the bit."""
        hit = super().draw()
        self._bit = self._random.randrange(8)
        return hit

    def __call__(self, byte: int, mean_current_A: float) -> int:
        """Return the character as it arrives."""
        if mean_current_A <= NOISE_FROM_A or not self.draw():
            return byte
        self.disturbed += 1
        return byte ^ 1 << self._bit


class DropOut(_Drawn):
    """Stops the generator below 6.5 V of V(t(p)), up to 7 V with a probability (ours), until 7 V or a new start."""

    STATE = ("drawn", "out")

    def __init__(self, seed: int, chance: float = 0.5) -> None:
        super().__init__(seed, chance)
        self.out = False

    def set(self, volts: float, starts: bool = False) -> bool:
        """Set a new voltage, or start the generator at one; return whether it has dropped out."""
        if starts or volts >= RUNS_FROM_V:
            self.out = False
        if volts < DROPS_BELOW_V:
            self.out = True
        elif volts < RUNS_FROM_V and not self.out:
            self.out = self.draw()
        return self.out


# End switches and wire-break switch: one common interrupt, and the effect of each (rows T-46, T-47).

X_END, Y_END, WIRE_BREAK, STOP_BUTTON = "x end", "y end", "wire break", "emergency stop"
NAMES = (X_END, Y_END, WIRE_BREAK, STOP_BUTTON)
"""The document names the first three; the operator's button is the emergency switch of its 4.1."""


class SafetySwitches(Snapshots):
    """Switches ORed into one interrupt; they also switch off supply and generator. `stuck` ones never open."""

    STATE = ("_open",)

    def __init__(self, on_rise: Callable[[], None], stuck: Set[str] = frozenset()) -> None:
        self._on_rise = on_rise
        self.stuck = stuck
        self._open: set[str] = set()

    @property
    def open(self) -> tuple[str, ...]:
        """Names of the open switches, until they are released."""
        return tuple(name for name in NAMES if name in self._open)

    @property
    def steppers_supplied(self) -> bool:
        """Whether the steppers have their supply."""
        return not self._open & {X_END, Y_END, STOP_BUTTON}

    @property
    def generator_allowed(self) -> bool:
        """Whether the generator may run."""
        return not self._open & {WIRE_BREAK, STOP_BUTTON}

    def trip(self, name: str) -> None:
        """Open a switch, unless it is stuck; raises `InputError` if there is no such switch."""
        if name not in NAMES:
            raise InputError(f"there is no switch {name!r}; there are {', '.join(NAMES)}")
        if name in self.stuck:
            return
        before = bool(self._open)
        self._open.add(name)
        if not before:
            self._on_rise()

    def release(self) -> None:
        """Release all switches: table off its ends, a wire threaded, the button pulled."""
        self._open.clear()


SPARK_IMPULSE_NS = 1_000
"""Duration of the impulse that a spark couples into the lines (ours: while its current rises and rings)."""
STEP_PULSE_NS = 42_000
"""Duration of a pulse on STEP (ours: POSITI between both writes to the port, 130 T-states of 3.072 MHz)."""


class Optocouplers(NamedTuple):
    """The couplers of the control lines and switches."""

    led_lit_at: int = 0  # level of the gate that lights the LED; the figure is lost (row T-A17)
    # shorter changes do not pass (data sheet of the H11F: 15 us on and off)
    response_ns: int = 15_000

    def lines(self, port: int) -> int:
        """Return the levels at the machine of the eight bits of a port."""
        lit = port if self.led_lit_at else ~port
        return ~lit & 0xFF

    def passes(self, duration_ns: int) -> bool:
        """Return whether a level of this duration passes."""
        return duration_ns >= self.response_ns


class LineOrder(NamedTuple):
    """Bits of port 4022H, printed in order for the first five (row T-A9); spare ones have a use here (row T-85)."""

    oev: int = 0
    x_direction: int = 1
    x_pulse: int = 2
    y_direction: int = 3
    y_pulse: int = 4
    t_i_coarse: int = 5
    t_p_coarse: int = 6
    low_tension: int = 7


class Faults(NamedTuple):
    """Injected faults, None for no fault, and the names of safety switches that never open."""

    noise: SerialNoise | None = None
    drop_out: DropOut | None = None
    stuck: frozenset[str] = frozenset()


class _WiredCounters(PulseAnalyser):
    """Counters whose strobes go to the latches of an 8255."""

    def __init__(self, port: Ppi8255) -> None:
        super().__init__()
        self._port = port

    def result_waits(self) -> bool:
        return any(self._port.full)

    def put_result(self, short: int, open: int) -> None:
        self._port.strobe(ppi.A, short)
        self._port.strobe(ppi.B, open)


def _unseen(step: Step) -> None:
    """Ignore a step."""


class Board(Snapshots):
    """Chips, wires, and the machine's side of them; `on_step` is called at each edge that moves a stepper."""

    STATE = (
        "now_ns", "codes", "_levels", "steps", "open_V", "mean_current_A", "bus", "faults", "counters", "timers",
        "machine_port", "counter_port", "interrupts", "display", "terminal", "host", "switches", "generator_line",
    )  # fmt: skip
    steps: list[Step]

    def __init__(
        self, settings: PulseSettings | None = None, lines: LineOrder | None = None, faults: Faults | None = None,
        couplers: Optocouplers | None = None,
    ) -> None:
        self.settings = settings or PulseSettings()
        self.lines = lines or LineOrder()
        if sorted(self.lines) != list(range(8)):
            raise InputError(f"the lines of port 4022H are its bits 0 to 7, each once, not {self.lines}")
        self.faults = faults or Faults()
        self.couplers = couplers or Optocouplers()
        self.now_ns = 0
        self.steps = []
        self.on_step: Callable[[Step], None] = _unseen
        self.codes = [0, 0]  # codes of the DACs of t(i) and t(p), with `COARSE` for that range
        self.open_V = 0.0
        self.mean_current_A = 0.0
        # bytes that the serial channel has sent; not part of the state
        self.sent, self.sent_to_host = bytearray(), bytearray()
        self._levels = 1 << self.lines.oev
        self.bus = Bus()
        self.machine_port = Ppi8255(self._drive)
        self.counter_port = Ppi8255(self._reset_counters)
        self.counters = _WiredCounters(self.counter_port)
        self.timers = Pit8253()
        self.interrupts = Pic8259()
        self.display = Kdc8279()
        self.terminal, self.host = Usart8251(self.sent.append), Usart8251(self.sent_to_host.append)
        self.switches = SafetySwitches(partial(self.interrupts.request, EMERGENCY), self.faults.stuck)
        self.generator_line = PulseGeneratorLine(self.couplers.response_ns)
        for first, size, chip in (
            (bus.PORT2A, 4, self.machine_port), (bus.PORT3A, 4, self.counter_port), (bus.TIMERS, 4, self.timers),
            (bus.INTERRUPTS, 2, self.interrupts), (bus.DISPLAY, 2, self.display), (bus.TERMINAL, 2, self.terminal),
            (bus.HOST, 2, self.host),
        ):  # fmt: skip
            self.bus.attach(first, size, chip)

    @property
    def generator_on(self) -> bool:
        """Whether the generator fires: OEV allows it, the wire is not broken, and the supply has not dropped out."""
        dropped = self.faults.drop_out is not None and self.faults.drop_out.out
        return self.generator_line.running and self.switches.generator_allowed and not dropped

    @property
    def times_us(self) -> tuple[float, float]:
        """T(i) and t(p) of the codes."""
        return self.settings.times_us(*self.codes)

    @property
    def low_tension(self) -> bool:
        """Whether the spare line that lowers the wire's tension is active."""
        return bool(self._levels >> self.lines.low_tension & 1)

    def spark(self) -> None:
        """Apply the impulses of sparks to the line of the switches: couplers that are fast enough interrupt."""
        if self.couplers.passes(SPARK_IMPULSE_NS):
            self.interrupts.request(EMERGENCY)

    def receive(self, byte: int, from_host: bool = False) -> None:
        """Receive a character over a serial line, disturbed if that fault is injected."""
        if self.faults.noise is not None:
            byte = self.faults.noise(byte, self.mean_current_A)
        (self.host if from_host else self.terminal).arrive(byte)

    def scan_keys(self, closed: frozenset[int], shift: bool = False, ctrl: bool = False) -> None:
        """Let the 8279 scan its keys once."""
        if self.display.scan(closed, shift, ctrl):
            self.interrupts.request(KEYBOARD)

    def _drive(self, port: int, byte: int) -> None:
        """Process outputs of the 8255 that drives DACs, generator and steppers."""
        if port != ppi.C:
            self.codes[port] = byte | self.codes[port] & COARSE
            if port == ppi.B:
                self._drop_out(starts=False)
            return
        lines, levels = self.lines, self.couplers.lines(byte)
        risen, changed = levels & ~self._levels, levels ^ self._levels
        self._levels = levels
        for which, line in ((ppi.A, lines.t_i_coarse), (ppi.B, lines.t_p_coarse)):
            self.codes[which] = self.codes[which] & BYTE | COARSE * (levels >> line & 1)
        if changed >> lines.oev & 1:
            stops = bool(levels >> lines.oev & 1)
            self.generator_line.switch(stops, self.now_ns, self.open_V)
            if not stops:
                self._drop_out(starts=True)
        if not (self.switches.steppers_supplied and self.couplers.passes(STEP_PULSE_NS)):
            return
        for axis, pulse, direction in ((0, lines.x_pulse, lines.x_direction), (1, lines.y_pulse, lines.y_direction)):
            if risen >> pulse & 1:
                step = Step(self.now_ns, axis, 1 if levels >> direction & 1 else -1)
                self.steps.append(step)
                self.on_step(step)

    def _drop_out(self, starts: bool) -> None:
        """Let the generator drop out at its present V(t(p)), if that fault is injected."""
        if self.faults.drop_out is not None:
            self.faults.drop_out.set(self.settings.t_p.volts(self.codes[ppi.B] & BYTE), starts)

    def _reset_counters(self, port: int, byte: int) -> None:
        """Process line C7 of the 8255 that reads the counters."""
        if port == ppi.C and byte >> ppi.RESET_BIT & 1:
            self.counters.clear()
