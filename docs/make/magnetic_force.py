"""The magnetic force on the wire in its slot, over that in ideally permeable metal; writes tables of theory/gas.md.

    python docs/make/magnetic_force.py

The field of `slot_field` is computed for pulses and metals. Half of a discharge's current flows through the middle of
the wire, as there are contacts at both guides. Takes ten minutes of processor time.
"""

import math
from collections.abc import Sequence

from sections import table, write_sections
from slot_field import Metal, pulse_share, slot, steady_share

STEEL = Metal(2.0e6, 100.0, 1.7)
"""Hardened tool steel: 0.4 to 0.65 uOhm m, initial permeability of 50 to 200, 1.6 to 1.8 T (data sheets)."""
STEELS = STEEL, Metal(2.5e6, 50.0, 1.6), Metal(1.6e6, 200.0, 1.8)
"""This steel, and those with the least and the greatest share."""
PEAK_A, ON_US = 700.0, 1.4
PULSES = {
    "rough, 9.8 mJ": (PEAK_A, ON_US), "rough, most current": (940.0, 1.4), "rough pass of a technology": (535.0, 1.1),
    "its fourth pass": (335.0, 0.6), "thin wire": (150.0, 0.7), "weak and long": (100.0, 3.0),
}  # fmt: skip
METALS = {
    "tool steel": STEELS,
    "cemented carbide, 10 % cobalt": (Metal(5e6, 3.0, 0.2), Metal(5e6, 2.0, 0.2), Metal(5e6, 5.0, 0.2)),
    "aluminium": (Metal(25e6, 1.0), Metal(18e6, 1.0), Metal(37e6, 1.0)),
    "copper": (Metal(58e6, 1.0), Metal(45e6, 1.0)),
    "austenitic steel": (Metal(1.4e6, 1.008), Metal(1.4e6, 1.0), Metal(1.3e6, 1.02)),
    "nickel alloy": (Metal(0.8e6, 1.0013), Metal(0.8e6, 1.0), Metal(0.8e6, 1.01)),
    "titanium alloy": (Metal(0.56e6, 1.0), Metal(0.5e6, 1.0), Metal(0.6e6, 1.0)),
}  # fmt: skip
PERMEABILITIES = 10.0, 100.0, 1000.0  # of a metal without saturation and eddy currents


def shown(shares: Sequence[float]) -> str:
    """Return a share and its range as text."""
    return f"{shares[0]:.3f}, {min(shares):.3f} to {max(shares):.3f}"


def main() -> None:
    """Compute the shares, and write their tables into the page."""
    at = slot()
    pulses = [
        [name, f"{peak_A:g}", f"{on_us:g}", shown([pulse_share(at, one, peak_A / 2, on_us) for one in STEELS])]
        for name, (peak_A, on_us) in PULSES.items()
    ]
    metals = [
        [name, f"{one.permeability:g}", "none" if math.isinf(one.saturation_T) else f"{one.saturation_T:g}",
         f"{one.conductivity_S_m / 1e6:g}", shown([pulse_share(at, of, PEAK_A / 2, ON_US) for of in (one, *ends)])]
        for name, (one, *ends) in METALS.items()
    ]  # fmt: skip
    steady = [
        [f"permeability {mu:g}, steady current", f"{steady_share(at, Metal(0.0, mu), PEAK_A / 2):.2f}"]
        for mu in PERMEABILITIES
    ]
    still, unsaturated = STEEL._replace(conductivity_S_m=0.0), STEEL._replace(saturation_T=math.inf)
    steady += [
        ["tool steel, steady current", f"{steady_share(at, still, PEAK_A / 2):.2f}"],
        ["tool steel without saturation, pulse", f"{pulse_share(at, unsaturated, PEAK_A / 2, ON_US):.2f}"],
        ["tool steel, pulse", f"{pulse_share(at, STEEL, PEAK_A / 2, ON_US):.2f}"],
    ]
    write_sections("theory/gas.md", {
        "magnetic share by effect": table(("metal", "share"), steady, numbers=1),
        "magnetic share by pulse": table(("pulse", "peak, A", "on-time, us", "share"), pulses, numbers=3),
        "magnetic share by metal": table(
            ("metal", "permeability", "saturation, T", "conductivity, MS/m", "share"), metals, numbers=4
        ),
    })  # fmt: skip


if __name__ == "__main__":
    main()
