"""The two digital-to-analogue converters that set the pulse generator, and the allowed pairs of codes.

V(t(i)), 0..5 V, sets the pulse duration, V(t(p)), 0..15 V, the repetition (row T-32). The relation of times and
voltages, and the curve of pairs that draw 2 A (figure 4-3), are lost. Ours are straight lines; the mean current
assumes that all pulses ignite at once; all constants are arguments (row T-35).

Eight bits over the whole range of 1000 us would be steps of 4 us. So the pulse generator has two ranges for both
times (row T-A15), selected by a ninth bit of the code, `COARSE`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from edmsim.controllers.mcu.firmware.poscal import BYTE
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

T_I_FULL_V, T_P_FULL_V = 5.0, 15.0  # voltages of code 255 with nominal trims (row T-32)
LIMIT_A = 2.0  # largest mean current of the generator (row T-34)
SHORTEST_T_I_US, SHORTEST_T_P_US = 1.0, 2.0  # the shortest pulse (row T-1), and 500 kHz (row T-36)
LONGEST_T_I_US, LONGEST_T_P_US = 1000.0, 10_000.0
"""Ends of the coarse ranges: the longest pulse and period of the document (rows T-1, T-2)."""
COARSE = 0x100  # bit of a code that selects the coarse range; the lower eight are the converter's
MOST_CODE = COARSE | BYTE


@dataclass(frozen=True)
class Dac:
    """One converter with its amplifier, whose gain and zero are trimmed with ten-turn potentiometers (row T-33)."""

    full_V: float  # voltage of code 255
    gain: float = 1.0  # nominally 1
    offset_V: float = 0.0  # nominally 0

    def volts(self, code: int) -> float:
        """Return the voltage of a code, at least 0."""
        return max(self.gain * self.full_V * code / BYTE + self.offset_V, 0.0)


@dataclass(frozen=True)
class PulseSettings:
    """Times in us of the codes, and the current that they draw."""

    t_i: Dac = Dac(T_I_FULL_V)
    t_p: Dac = Dac(T_P_FULL_V)
    t_i_us_V: float = 10.0  # fine range (ours: 2 V and 10 V are the 20 us and 100 us of a usual cut)
    t_p_us_V: float = 10.0
    t_i_coarse_us_V: float = LONGEST_T_I_US / T_I_FULL_V  # coarse range: the full voltages are 1000 us and 10 ms
    t_p_coarse_us_V: float = LONGEST_T_P_US / T_P_FULL_V
    pulse_A: float = 6.61  # current of a pulse (ours: 6.6 A, that of the default machine)
    # quantity that rises with V(t(p)), row T-A16; for the frequency, code 1 is the longest period
    law: Literal["period", "frequency"] = "period"

    def times_us(self, t_i_code: int, t_p_code: int) -> tuple[float, float]:
        """Return t(i) and t(p) in us of two codes; t(p) is at least 2 us."""
        return self._t_i_us(t_i_code), self._t_p_us(t_p_code)

    def mean_current_A(self, t_i_code: int, t_p_code: int) -> float:
        """Return the modelled mean current, ``pulse_A * t(i) / t(p)``, with t(i) at most t(p)."""
        t_i_us, t_p_us = self.times_us(t_i_code, t_p_code)
        return self.pulse_A * min(t_i_us / t_p_us, 1.0)

    def check(self, t_i_code: int, t_p_code: int) -> None:
        """Refuse a pair of codes that draws more than 2 A (row T-34), and invalid codes."""
        for name, code in (("t(i)", t_i_code), ("t(p)", t_p_code)):
            if not (isinstance(code, int) and 0 <= code <= MOST_CODE):
                raise InputError(f"the code of {name} is 0..{MOST_CODE}, not {code!r}")
        current = self.mean_current_A(t_i_code, t_p_code)
        if current > LIMIT_A:
            t_i_us, t_p_us = self.times_us(t_i_code, t_p_code)
            enough = [us for us in map(self._t_p_us, range(MOST_CODE + 1)) if self.pulse_A * t_i_us <= LIMIT_A * us]
            way_out = f"t(p) must be at least {math.ceil(min(enough))} us" if enough else "no t(p) is long enough"
            raise InputError(
                f"t(i) {time_text(t_i_us)} us in t(p) {time_text(t_p_us)} us draws {current:.2f} A, above the "
                f"generator's {LIMIT_A:g} A: {way_out}"
            )

    def code_of_t_i(self, us: float) -> int:
        """Return the code nearest to a pulse duration, in the finest range that contains it."""
        return _nearest("t(i)", us, self._t_i_us, min(us, SHORTEST_T_I_US))

    def code_of_t_p(self, us: float) -> int:
        """Return the code nearest to a period; see `code_of_t_i`."""
        return _nearest("t(p)", us, self._t_p_us, 0.0)

    def _t_i_us(self, code: int) -> float:
        us_V = self.t_i_coarse_us_V if code & COARSE else self.t_i_us_V
        return round(self.t_i.volts(code & BYTE) * us_V, 6)

    def _t_p_us(self, code: int) -> float:
        us_V = self.t_p_coarse_us_V if code & COARSE else self.t_p_us_V
        volts = self.t_p.volts(code & BYTE)
        if self.law == "frequency":
            longest_us = self.t_p.volts(BYTE) * us_V
            return max(round(longest_us * self.t_p.volts(1) / volts, 6), SHORTEST_T_P_US) if volts else math.inf
        return max(round(volts * us_V, 6), SHORTEST_T_P_US)


def time_text(us: float) -> str:
    """Return a time in us as the terminal shows it: four digits, or whole us."""
    return f"{us:.4g}" if us < LONGEST_T_I_US else f"{us:.0f}"


def _nearest(name: str, us: float, us_of: Callable[[int], float], least_us: float) -> int:
    """Return the code whose time is nearest and at least the least, in the first range that contains it."""
    for first in (0, COARSE):
        times = {code: us_of(code) for code in range(first + BYTE, first - 1, -1)}
        longest = max(time for time in times.values() if time < math.inf)
        if 0 <= us <= longest:
            return min((code for code in times if times[code] >= least_us), key=lambda code: abs(times[code] - us))
    raise InputError(f"{name} is {us:g} us, but the voltage reaches from 0 to {longest:g} us only")


class PulseGeneratorLine(Snapshots):
    """OEV: 0 runs the pulse generator, 1 stops it and the high voltage, of which a charge remains (row T-27)."""

    STATE = ("running", "_stored_V", "_since_ns", "_before_V", "_began_ns")

    def __init__(self, response_ns: int = 0, decay_s: float = 5.0) -> None:
        self.response_ns = response_ns  # least duration of a level that passes the optocoupler
        # time constant of the remaining voltage (ours: the document only warns of it)
        self.decay_s = decay_s
        self.running = False
        self._stored_V = 0.0
        self._since_ns = 0
        self._before_V, self._began_ns = 0.0, -1

    def switch(self, oev: bool, now_ns: int, open_V: float) -> None:
        """Set the line's level; `open_V` is the open voltage while the generator runs."""
        if not oev and not self.running:
            self._before_V, self._began_ns = self.voltage_V(now_ns), now_ns
            self.running, self._stored_V = True, open_V
        elif oev and self.running:
            self.running, self._since_ns = False, now_ns
            if now_ns - self._began_ns <= self.response_ns:
                self._stored_V = self._before_V

    def voltage_V(self, now_ns: int) -> float:
        """Voltage on the open electrode in V, which decays after a stop."""
        if self.running or not self._stored_V:
            return self._stored_V
        return self._stored_V * math.exp(-(now_ns - self._since_ns) * 1e-9 / self.decay_s)
