"""One window of pulses: counts and measurements of a plant, for controllers and recorders."""

from typing import NamedTuple


class PulseWindow(NamedTuple):
    """Results of a window of pulses. A machine measures no gap, deflection, temperature, debris, gas and craters."""

    start_ns: int  # machine time at the beginning of the window
    duration_ns: int  # duration
    short: int  # pulses of each class; their sum is `pulses`
    open: int
    spark: int
    arc: int
    # voltage and current: means over the window, of the working pulses only; see `edmsim.plant.gap.generator` for
    # equalising pulses
    mean_voltage_V: float
    mean_current_A: float
    mean_delay_us: float  # mean ignition delay of the pulses that ignited; NaN if none did
    gap_um: float  # mean gap at the places of ignition; NaN without ignitions
    deflection_um: tuple[float, float]  # mean deflection of the wire over height and time
    vibration2_um2: float  # variance of that deflection within the window, sum of both axes
    wire_temperature_K: float  # highest temperature of a slice's wire
    debris: float  # mean debris share of the gap's water
    coverage: float  # mean share of the wire's front covered by gas, at the window's end
    energy_J: float  # sum over the window's discharges
    crater_um3: float  # the same
    broken: bool  # whether the wire broke in this window
    # ignitions in each fifth of the workpiece's (greatest) height, from below, as the currents of the two contacts
    # locate them: with an error of 2 mm (standard deviation)
    fifths: tuple[int, ...] = (0, 0, 0, 0, 0)

    @property
    def pulses(self) -> int:
        """Pulses fired in the window: 255, or as many as were asked for, unless the wire broke."""
        return self.short + self.open + self.spark + self.arc
