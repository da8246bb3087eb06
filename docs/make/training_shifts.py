"""Returns of controllers in whole shifts on training machines, relative to the first controller.

python docs/make/training_shifts.py MaxRateShift 22200 16 adaptive-hold policy:MaxRateShift-adapt
python docs/make/training_shifts.py ThinWireShift 23000 12 climb:open_target_share=0.05 adaptive-hold:limit_share=0.2

The numbers are the first seed and the number of seeds. Laws are tried here, so that the held-back machines remain for
the comparison. A shift takes about 15 s of processor time; shifts are stored in ``out/headroom`` and not cut again.
"""

import argparse

from headroom import Cuts, shown

from edmsim.evaluation.compare import ratio
from edmsim.evaluation.episode import HELD_BACK


def main() -> None:
    """Cut the missing shifts, and print returns and lost wires."""
    parser = argparse.ArgumentParser(description="Compare controllers in shifts on training machines.")
    parser.add_argument("task", choices=("MaxRateShift", "ThinWireShift"))
    parser.add_argument("first", type=int, help="seed of the first machine")
    parser.add_argument("machines", type=int)
    parser.add_argument("controllers", nargs="+")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.machines)
    if seeds[-1] >= HELD_BACK:
        parser.error(f"seeds from {HELD_BACK} on are held back for the comparison")
    cuts = Cuts(options.task)
    cuts.make(options.controllers, seeds)
    first = cuts.of(options.controllers[0], seeds)
    for name in options.controllers:
        lost = sum(result.wires_lost for result in cuts.results(name, seeds))
        print(f"{shown(ratio(100 * cuts.of(name, seeds), first))} %, {lost} wires lost: {name}")


if __name__ == "__main__":
    main()
