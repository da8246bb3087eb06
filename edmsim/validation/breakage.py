"""Rows on wire rupture: operating points that held or broke, and the mean current at which the wire breaks.

The limit is measured as Sato et al. did: the pause is shortened step by step until the wire breaks, while the
feed follows the pulses, and the largest mean current it had held is noted, short-circuit pulses left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from edmsim.controllers import from_text, make
from edmsim.cosim.straight import cut_straight
from edmsim.evaluation.stable_rate import quick_counts, shorten_pauses
from edmsim.machine.machine import Machine
from edmsim.machine.parts import Generator, Positive
from edmsim.validation.rows import Check, Row, mean_and_interval
from edmsim.validation.setups import altered

SATO = "Sato et al., Wire-break Prevention on WEDM, J. Japan Soc. Electrical Machining Engineers (2013)"
MORI = "Mori, Kitamura, Kunieda, Abe: wire breaking in WEDM seen through transparent electrodes"
COOLING = "Sato et al., explanation of the limit: the wire is less likely to be cooled"
STRENGTH = "tension against the hot wire's strength (derived)"
PAGE = "docs/theory/emergence.md"

PEAK_A, PULSE_US = 700.0, 1.4
"""Triangular pulse of Sato's stable cutting, an upper bound: 0.49 mC. Here a rectangle of the same charge."""
LEAST_PEAK_A, MOST_PEAK_A = 600.0, 940.0
"""Peak currents of Sato's 67 conditions."""
STABLE_HZ = 60e3
"""Discharges per second in Sato's stable cutting of 80 mm."""
PAUSE_US, BREAKING_PAUSE_US = 8.0, 6.0
"""Pause of that stable cutting, and the pause at which the wire broke in all four trials (his table 2)."""
LONGEST_PERIOD_US = 60.0
"""Pulse and pause the search begins with: a third of any limit found (ours)."""
HOLD_S = 0.3
"""Time at each step, several times the wire's thermal time constant of some 20 ms (ours)."""
APPROACH_S = 2.0
"""Time the feed is given to find its level first (ours)."""
OPEN_SHARE = 0.3
"""Share of open pulses that the feed holds, far from shorts (ours)."""


def sato_rig(
    height_mm: float, changes: Mapping[str, float] | None = None, *, tension: float = 22.0, peak_A: float = PEAK_A
) -> Machine:
    """Return the set-up of Sato et al.: 0.3 mm brass wire, 22 N, 13 m/min, short pulses of high current on steel.

    Voltage (80 V) is the nominal one of the ignition law; flushing is a modern machine's 2 bar.
    """
    burning_V = Machine.load().material.burning_voltage_V.value
    # the supply only has to lie well above the burning voltage for the current to be known
    generator = _generator(current_A=peak_A / 2, t_on_us=PULSE_US, open_V=80.0, ohm=400.0 / peak_A,
                           burning_V=burning_V, period_us=LONGEST_PERIOD_US)
    machine = _with_generator(Machine.load(wire="brass-300", height_mm=height_mm, tension=tension), generator)
    rig = {
        "base.guides.wire_speed_m_s": 13.0 / 60.0,
        "base.dielectric.flushing_pressure_Pa": 2e5,
    }
    return altered(machine, {**rig, **(changes or {})})


def mori_rig() -> Machine:
    """Return the set-up of Mori et al.: 0.2 mm brass, 11 A for 1 us, pauses of 4 us, 75 V, a piece 1 mm wide.

    Tension and ignition wait were not published: the default stress, and 50 us. The piece was SiC; steel here.
    """
    burning_V = Machine.load().material.burning_voltage_V.value
    generator = _generator(current_A=11.0, t_on_us=1.0, open_V=75.0, ohm=(75.0 - burning_V) / 11.0,
                           burning_V=burning_V, period_us=5.0, wait_us=50.0)
    return _with_generator(Machine.load(wire="brass-200", height_mm=1.0), generator)


def _generator(
    *, current_A: float, t_on_us: float, open_V: float, ohm: float, burning_V: float, period_us: float,
    wait_us: float = 20.0,
) -> Generator:
    def constant(value: float) -> Positive:
        return Positive(value=value, source="set for a check")

    return Generator(
        title="pulse of a published rig, started by the ignition",
        mode="iso-energetic",
        open_voltage_V=constant(open_V),
        supply_voltage_V=constant(burning_V + current_A * ohm),
        resistance_ohm=constant(ohm),
        t_on_us=constant(t_on_us),
        t_period_us=constant(period_us),
        ignition_wait_us=constant(wait_us),
        mean_current_limit_A=constant(1e3),
    )


def _with_generator(machine: Machine, generator: Generator) -> Machine:
    rig = machine.model_copy(
        update={
            "generator": generator,
            "t_on_us": generator.t_on_us.value,
            "t_period_us": generator.t_period_us.value,
        }
    )
    rig.check()
    return rig


def break_limit_A(machine: Machine, seed: int) -> float:
    """Largest mean current, without short-circuit pulses, that the wire held for `HOLD_S`.

    Where the shortest pause does not break it, the largest current there was: then a lower bound of the limit.
    """
    servo = from_text(quick_counts(OPEN_SHARE))
    held, _ = shorten_pauses(machine, seed, servo, hold_s=HOLD_S, approach_s=APPROACH_S)
    return max((step.current_A for step in held), default=0.0)


def _limits(machine: Machine, seeds: Sequence[int]) -> list[float]:
    return [break_limit_A(machine, seed) for seed in seeds]


def stable_point(seeds: Sequence[int]) -> list[Row]:
    """The limit on 80 mm against Sato's stable cutting, whose wire broke when the pause fell from 8 to 6 us."""
    charge = PEAK_A / 2 * PULSE_US * 1e-6
    stable_A = charge * STABLE_HZ
    broke_A = charge / (1 / STABLE_HZ - (PAUSE_US - BREAKING_PAUSE_US) * 1e-6)
    mean, half = mean_and_interval(_limits(sato_rig(80.0), seeds))
    return [
        Row.band("rupture", "mean current at the limit, 80 mm, 0.3 mm wire", SATO, low=stable_A, high=broke_A,
                 simulated=mean, uncertainty=half, unit="A", note=f"{PAGE}#wire-rupture")
    ]


def concentration(seeds: Sequence[int]) -> list[Row]:
    """Mori's rig: in how many runs the wire breaks."""
    runs = [_mori_breaks(seed) for seed in seeds]
    return [
        Row.band("rupture", "share of runs that break, 1 mm wide piece, pause 4 us", MORI, low=1.0, high=1.0,
                 published="15 of 15", simulated=sum(runs) / len(runs), note=f"{PAGE}#wire-rupture")
    ]


def _mori_breaks(seed: int) -> bool:
    controller = make("counts", start_feed_um_s=20.0, integral_um_s2=200.0, filter_s=0.05)
    return cut_straight(mori_rig(), controller, seed, settle_s=0.5, seconds=2.0).broken


THIN_MM, MIDDLE_MM, THICK_MM = 20.0, 60.0, 100.0
"""Heights of Sato's trials."""
FREE_JET_PA = 6.3e3
"""Flushing pressure with the nozzle off the piece (derived): all that is left is the stagnation pressure of a free
jet, here of Sato's 6 l/min out of a bore of 6 mm (usual), 3.5 m/s."""


def limits(seeds: Sequence[int]) -> list[Row]:
    """What the limit does with height, flushing, cooling and tension."""
    flushing, cooling = "base.dielectric.flushing_pressure_Pa", "base.cooling.convection_W_m2K"
    thin, middle, thick = (_limits(sato_rig(h), seeds) for h in (THIN_MM, MIDDLE_MM, THICK_MM))
    convection = sato_rig(THIN_MM).base.cooling.convection_W_m2K.value
    off = {h: _limits(sato_rig(h, {flushing: FREE_JET_PA}), seeds) for h in (THIN_MM, MIDDLE_MM)}
    uncooled = _limits(sato_rig(MIDDLE_MM, {cooling: 0.7 * convection}), seeds)
    taut = _limits(sato_rig(THIN_MM, tension=33.0), seeds)
    gentle, hard = (_limits(sato_rig(MIDDLE_MM, peak_A=peak), seeds) for peak in (LEAST_PEAK_A, MOST_PEAK_A))
    one_limit, half_one = mean_and_interval([b / a for a, b in zip(gentle, hard, strict=True)])
    slopes = [math.log(b / a) / math.log(THICK_MM / THIN_MM) for a, b in zip(thin, thick, strict=True)]
    lost_thin = [1 - b / a for a, b in zip(thin, off[THIN_MM], strict=True)]
    lost_middle = [1 - b / a for a, b in zip(middle, off[MIDDLE_MM], strict=True)]
    slope, half = mean_and_interval(slopes)
    return [
        _sign("limit over 20 to 100 mm", SATO, True, thin, thick, "A"),
        Row.band("rupture", "limit over 20 to 100 mm, log-log slope", SATO, low=0.0, high=1.0,
                 published="less than in proportion", simulated=slope, uncertainty=half),
        Row.value("rupture", "limit, 60 mm, peak 940 A over 600 A", f"{SATO}: one threshold of mean current",
                  published=1.0, simulated=one_limit, within=0.2, uncertainty=half_one),
        _sign("limit, 60 mm, nozzle off", SATO, False, middle, off[MIDDLE_MM], "A"),
        _sign("share lost with the nozzle off, 20 to 60 mm", SATO, True, lost_thin, lost_middle),
        _sign("limit, 60 mm, convection x0.7", COOLING, False, middle, uncooled, "A"),
        _sign("limit, 20 mm, tension 22 to 33 N", STRENGTH, False, thin, taut, "A"),
    ]


def _sign(
    name: str, source: str, rises: bool, before: Sequence[float], after: Sequence[float], unit: str = ""
) -> Row:
    mean, half = mean_and_interval([b - a for a, b in zip(before, after, strict=True)])
    return Row.sign("rupture", name, source, rises=rises, simulated=mean, uncertainty=half, unit=unit)


CHECKS: tuple[Check, ...] = (stable_point, concentration, limits)
