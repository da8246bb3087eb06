"""The two digital-to-analogue converters that set the pulse generator, and which pairs of codes it can bear.

V(t(i)), 0..5 V, sets the pulse duration, V(t(p)), 0..15 V, the repetition (row T-32). What times the voltages mean,
and the curve of pairs that draw 2 A (figure 4-3), are lost; ours are straight lines, the mean current is that of
pulses that all ignite at once, and all constants can be given (row T-35).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from edmsim.controllers.mcu.firmware.arithmetic import BYTE
from edmsim.errors import InputError

T_I_FULL_V, T_P_FULL_V = 5.0, 15.0
"""Voltages of code 255 with untouched trims (row T-32)."""
LIMIT_A = 2.0
"""Largest mean current of the generator (row T-34)."""
SHORTEST_T_P_US = 2.0
"""500 kHz (row T-36)."""


@dataclass(frozen=True)
class Dac:
    """One converter with its amplifier, whose gain and zero are trimmed with ten-turn potentiometers (row T-33).

    Parameters
    ----------
    full_V : float
        Voltage of code 255.
    gain : float
        Trim of the gain; 1 is right.
    offset_V : float
        Trim of the zero; 0 is right.
    """

    full_V: float
    gain: float = 1.0
    offset_V: float = 0.0

    def volts(self, code: int) -> float:
        """Voltage of a code, in V; the amplifier gives none below 0."""
        return max(self.gain * self.full_V * code / BYTE + self.offset_V, 0.0)

    def code(self, volts: float) -> int:
        """Return the code whose voltage is nearest, of 0..255."""
        return min(max(round((volts - self.offset_V) / (self.gain * self.full_V) * BYTE), 0), BYTE)


@dataclass(frozen=True)
class PulseSettings:
    """What codes mean in us, and the current they draw.

    Parameters
    ----------
    t_i, t_p : Dac
    t_i_us_V, t_p_us_V : float
        us per volt (ours: with 10, 2 V and 10 V are the 20 us and 100 us of a usual cut, and below 7 V, where the
        generator drops out, lie the short periods in which its supply must give most).
    pulse_A : float
        Current of a pulse (ours: 6.6 A, that of the default machine).
    """

    t_i: Dac = Dac(T_I_FULL_V)
    t_p: Dac = Dac(T_P_FULL_V)
    t_i_us_V: float = 10.0
    t_p_us_V: float = 10.0
    pulse_A: float = 6.61

    def times_us(self, t_i_code: int, t_p_code: int) -> tuple[float, float]:
        """Return t(i) and t(p) in us that two codes mean; t(p) is never below 2 us."""
        return (
            round(self.t_i.volts(t_i_code) * self.t_i_us_V, 6),
            max(round(self.t_p.volts(t_p_code) * self.t_p_us_V, 6), SHORTEST_T_P_US),
        )

    def mean_current_A(self, t_i_code: int, t_p_code: int) -> float:
        """Return the modelled mean current, ``pulse_A * t(i) / t(p)``; t(i) fills at most all of t(p)."""
        t_i_us, t_p_us = self.times_us(t_i_code, t_p_code)
        return self.pulse_A * min(t_i_us / t_p_us, 1.0)

    def check(self, t_i_code: int, t_p_code: int) -> None:
        """Refuse a pair of codes that draws more than 2 A (row T-34), or is no pair of codes.

        Raises
        ------
        InputError
        """
        for name, code in (("t(i)", t_i_code), ("t(p)", t_p_code)):
            if not (isinstance(code, int) and 0 <= code <= BYTE):
                raise InputError(f"the code of {name} is 0..255, not {code!r}")
        current = self.mean_current_A(t_i_code, t_p_code)
        if current > LIMIT_A:
            t_i_us, t_p_us = self.times_us(t_i_code, t_p_code)
            raise InputError(
                f"t(i) {t_i_us:.4g} us in t(p) {t_p_us:.4g} us draws {current:.2f} A, above the generator's "
                f"{LIMIT_A:g} A: t(p) must be at least {math.ceil(self.pulse_A * t_i_us / LIMIT_A)} us"
            )

    def code_of_t_i(self, us: float) -> int:
        """Nearest code of a pulse duration.

        Raises
        ------
        InputError
            If it lies outside the range.
        """
        return self._code("t(i)", self.t_i, self.t_i_us_V, us)

    def code_of_t_p(self, us: float) -> int:
        """Nearest code of a period; see `code_of_t_i`."""
        return self._code("t(p)", self.t_p, self.t_p_us_V, us)

    def _code(self, name: str, dac: Dac, us_V: float, us: float) -> int:
        code = dac.code(us / us_V)
        if not abs(dac.volts(code) * us_V - us) <= 0.5 * dac.gain * dac.full_V / BYTE * us_V + 1e-9:
            most = dac.volts(BYTE) * us_V
            raise InputError(f"{name} is {us:g} us, but the voltage reaches from 0 to {most:g} us only")
        return code


class PulseGeneratorLine:
    """OEV: 0 runs the pulse generator, 1 stops it and the high voltage with it, which stays stored (row T-27).

    Parameters
    ----------
    decay_s : float
        Time constant with which the stored voltage goes (ours: the document gives none, only the warning).

    Attributes
    ----------
    running : bool
    """

    def __init__(self, decay_s: float = 5.0) -> None:
        self.decay_s = decay_s
        self.running = False
        self._stored_V = 0.0
        self._since_ns = 0
        self._before_V, self._began_ns = 0.0, -1

    def switch(self, oev: bool, now_ns: int, open_V: float) -> None:
        """Take the line's level; `open_V` is the open voltage while it runs.

        The instruction during which INIT lets the line fall is no time to charge anything.
        """
        if not oev and not self.running:
            self._before_V, self._began_ns = self.voltage_V(now_ns), now_ns
            self.running, self._stored_V = True, open_V
        elif oev and self.running:
            self.running, self._since_ns = False, now_ns
            if now_ns == self._began_ns:
                self._stored_V = self._before_V

    def voltage_V(self, now_ns: int) -> float:
        """Voltage on the open electrode, in V: after a stop it decays, and is not zero."""
        if self.running or not self._stored_V:
            return self._stored_V
        return self._stored_V * math.exp(-(now_ns - self._since_ns) * 1e-9 / self.decay_s)

    def snapshot(self) -> list[float]:
        """Everything that changes."""
        return [float(self.running), self._stored_V, self._since_ns, self._before_V, self._began_ns]

    def restore(self, state: list[float]) -> None:
        """Continue where `snapshot` was taken."""
        self.running, self._stored_V, self._since_ns = bool(state[0]), state[1], int(state[2])
        self._before_V, self._began_ns = state[3], int(state[4])
