"""Possible gain of a law that knows its machine on MaxRate: `python docs/make/heat_margin.py` prints a table.

tasks/max-rate.md refers to it. Machines are drawn with training seeds, and `heat-flux` cuts each of them with several
margins.
"""

import numpy as np
from sections import table

from edmsim.evaluation.episode import cut

ENV_ID = "edmsim/MaxRate-v1"
HOLDS = (0.3, 0.4, 0.5, 0.6)
SEEDS = range(40)


def main() -> None:
    """Print the table."""
    found = {hold: [cut(ENV_ID, seed, f"heat-flux:hold_share={hold:g}") for seed in SEEDS] for hold in HOLDS}
    rates = np.array([[result.rate_mm2_min for result in results] for results in found.values()])
    rows = [
        (f"{hold:g}", f"{rate.mean():.1f}", str(sum(result.wires_lost for result in results)))
        for (hold, results), rate in zip(found.items(), rates, strict=True)
    ]
    rows.append(("each machine's best", f"{rates.max(axis=0).mean():.1f}", ""))
    print(table(("share of the critical heat flux held", "mean rate, mm2/min", "wires lost in 40 cuts"), rows))


if __name__ == "__main__":
    main()
