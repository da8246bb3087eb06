"""Heat of the wire: closed forms of the balance the pulse loop carries on between pulses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmsim.machine.machine import Machine
from edmsim.plant.constants import heat_law
from edmsim.plant.resolution import resolution
from edmsim.plant.wire import HeatLaw, area_m2, heat_step
from edmsim.validation.rows import Check, Row

SCHACHT = "Schacht, KU Leuven 2004: Joule heat of a quarter of the wire's resistance against convection"
SATO = "Sato et al., J. Japan Soc. Electrical Machining Engineers (2013): 60 kHz, 9.8 mJ; balance in closed form"

STEP_US = 100.0
SETTLE_S = 0.5
"""Over twenty time constants of the thickest wire."""


def _settled_rise_K(law: HeatLaw, slices: int, spark_W: float = 0.0, current_A: float = 0.0) -> float:
    """Mean rise over the height after a steady power of sparks, spread over the slices, and a current."""
    temperature = np.full(slices, law.water_K)
    per_step = spark_W / slices * STEP_US * 1e-6 * law.kelvin_per_J
    for _ in range(round(SETTLE_S / (STEP_US * 1e-6))):
        temperature += per_step
        heat_step(temperature, law, STEP_US, current_A**2 * STEP_US)
    return float(temperature.mean()) - law.water_K


def check_joule_heat(seeds: Sequence[int]) -> list[Row]:
    """Rise at a steady current of a wire that stands: the loop's balance against Schacht's."""
    machine, res = Machine.load(), resolution("default")
    law = heat_law(machine, res)._replace(run_per_us=0.0)
    current = 30.0
    wire, convection = machine.wire, machine.base.cooling.convection_W_m2K.value
    joule_W_m = current**2 * wire.resistivity_Ohm_m.value / area_m2(machine.wire_diameter_um) / 4
    cold = joule_W_m / (convection * math.pi * machine.wire_diameter_um * 1e-6)
    return [
        Row.value(
            "wire", f"Joule heating at {current:g} A, 0.25 mm brass", SCHACHT,
            published=cold / (1 - wire.resistivity_per_K.value * cold),
            simulated=_settled_rise_K(law, res.slices, current_A=current), within=0.02, unit="K",
        )
    ]


def check_cooling(seeds: Sequence[int]) -> list[Row]:
    """Time constant of cooling in water: ``rho c d / (4 h)``."""
    machine, res = Machine.load(), resolution("default")
    law = heat_law(machine, res)._replace(run_per_us=0.0)
    temperature = np.full(res.slices, law.water_K + 100.0)
    steps = 100
    for _ in range(steps):
        heat_step(temperature, law, STEP_US, 0.0)
    constant_s = steps * STEP_US * 1e-6 / math.log(100.0 / float(temperature.mean() - law.water_K))
    wire = machine.wire
    expected_s = (
        wire.density_kg_m3.value * wire.heat_capacity_J_kgK.value * machine.wire_diameter_um * 1e-6
        / (4 * machine.base.cooling.convection_W_m2K.value)
    )
    return [
        Row.value(
            "wire", "time constant of cooling, 0.25 mm brass", "rho c d / (4 h), closed form",
            published=expected_s * 1e3, simulated=constant_s * 1e3, within=0.01, unit="ms",
        )
    ]


def check_spark_heat(seeds: Sequence[int]) -> list[Row]:
    """Mean rise of the 0.3 mm wire at 590 W over 80 mm, a tenth or three tenths of it into the wire."""
    machine = Machine.load(wire="brass-300", height_mm=80.0, tension=22.0)
    res = resolution("default")
    law = heat_law(machine, res)
    return [
        Row.value(
            "wire", f"mean rise at 590 W over 80 mm, {share:g} of it into the wire", SATO, published=published,
            simulated=_settled_rise_K(law, res.slices, spark_W=share * 590.0), within=0.05, unit="K",
        )
        for share, published in ((0.1, 56.0), (0.3, 170.0))
    ]


CHECKS: tuple[Check, ...] = (check_joule_heat, check_cooling, check_spark_heat)
