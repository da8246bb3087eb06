"""Gas and debris in a rough cut's water, before and behind the wire; writes the table of theory/gas.md.

    python docs/make/gas_balance.py

The state at the end of the rough cut of 30 mm, and of Sato's stable cutting of 80 mm with an unbreakable wire.
"""

import numpy as np
from numpy.typing import NDArray
from sections import table, write_sections

from edmsim.evaluation.stable_rate import OPEN_SHARE
from edmsim.machine.machine import Machine
from edmsim.validation.breakage import ROUGH_MM, STABLE_MM, rough_rig, sato_rig
from edmsim.validation.lag import ROUGH_OPEN_SHARE
from edmsim.validation.setups import UNBREAKABLE, servo_cut

SEEDS = range(1, 17)
STABLE_PERIOD_US = 11.2
"""Period with which the model has the 60 000 discharges per second of Sato's stable cutting."""
STATES = {
    "wake_gas": ("gas behind the wire, `b`", 2),
    "covered": ("front that gas covers, `a`", 2),
    "steam": ("of it by steam, `a_s`", 2),
    "gas": ("of it by permanent gas, `a_g`", 2),
    "debris": ("debris of the gap's water, `c`", 4),
    "wake_debris": ("debris of the water behind the wire, `c_w`", 5),
}
"""Entries of a snapshot, with their texts and digits."""


def states(machine: Machine, open_share: float) -> tuple[float, dict[str, NDArray[np.float64]]]:
    """Return the discharges per second, and each state of the slices: means over the seeds."""
    cuts = [servo_cut(machine, seed, open_share=open_share) for seed in SEEDS]
    slices = cuts[0].plant.resolution.slices
    found = [cut.plant.snapshot() for cut in cuts]
    means = {name: np.mean([np.asarray(one[name])[:slices] for one in found], axis=0) for name in STATES}
    return float(np.mean([cut.ignitions / cut.seconds for cut in cuts])), means


def main() -> None:
    """Make the cuts, and write their table into the page."""
    sato = sato_rig(STABLE_MM, UNBREAKABLE).with_(t_period_us=STABLE_PERIOD_US)
    cases = {ROUGH_MM: states(rough_rig(ROUGH_MM), ROUGH_OPEN_SHARE), STABLE_MM: states(sato, OPEN_SHARE)}
    heads = [f"{height:g} mm, {rate_Hz / 1e3:.0f} kHz: middle, faces" for height, (rate_Hz, _) in cases.items()]
    rows = []
    for name, (text, digits) in STATES.items():
        each = [means[name] for _, means in cases.values()]
        places = [(one[len(one) // 2], (one[0] + one[-1]) / 2) for one in each]
        rows.append((text, *(f"{middle:.{digits}f}, {faces:.{digits}f}" for middle, faces in places)))
    write_sections("theory/gas.md", {"gas balance": table(("", *heads), rows)})


if __name__ == "__main__":
    main()
