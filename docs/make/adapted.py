"""A policy that adapts beside laws on held-back machines: what it earns and loses, and its ratio to the best law.

python docs/make/adapted.py                          # tables of training.md and tasks/max-rate-shift.md, and the card
python docs/make/adapted.py policy:out/adapt/policy.json --cuts 4    # one of your own; prints them only

Cuts that are missing are made, one by one, and noted in ``out/headroom`` and ``out/adapted``: interrupted, the same
command goes on. A shift takes some half a minute of a processor.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from headroom import Cuts
from sections import write_sections

from edmsim.evaluation.compare import Figure, held_back, mean, ratio
from edmsim.evaluation.episode import Result, cut
from edmsim.learning import score

DOCS = Path(__file__).parents[1]
PAGES = DOCS / "training.md", DOCS / "tasks" / "max-rate-shift.md"
ENV_ID, POLICY, LAW = "edmsim/MaxRateShift-v0", "policy:MaxRateShift-adapt", "adaptive-hold"
CONSTANT = (
    f"{LAW}:filter_s=0.02,patience_s=0.06,proportional_um_s=300,integral_um_s2=30,limit_share=0.65,"
    "limit_spread=0.66,break_weight=1.5,short_weight=0.5,shortest_us=12.5"
)
"""The policy's law with the setting that cut the most, in the sum over the training machines, less the time of the
wires that it lost there: one for all."""
MACHINES = 48
ELSEWHERE = {
    "higher: 80 to 100 mm": {"height_mm": [80.0, 100.0]},
    "less pressure: 20 to 50 kPa": {"flushing_Pa": [20e3, 50e3]},
}
"""Places beyond the ranges of the training machines, each with shifts of `SHORT_S`."""
SHORT_S, PLACE_MACHINES = 300.0, 3
FOUND = Path("out/adapted")


def shown(figure: Figure, digits: int = 0) -> str:
    """Return a figure with its interval."""
    return f"{figure.value:.{digits}f} ({figure.low:.{digits}f} to {figure.high:.{digits}f})"


def table(policy: str, seeds: Sequence[int], cuts: Cuts) -> str:
    """Return what the controllers earn, and under it each machine."""
    names, law = {policy: f"`{policy}`", CONSTANT: "one setting for all", LAW: f"`{LAW}`"}, cuts.of(LAW, seeds)
    rows = ["| controller | return | net rate, mm2/min | of the law's, % | wires lost |", "|---|---|---|---|---|"]
    for name, text in names.items():
        part = ratio(100 * cuts.of(name, seeds), law)
        figures = mean(cuts.of(name, seeds)), mean(cuts.of(name, seeds, "rate_mm2_min")), part
        lost = int(cuts.of(name, seeds, "lost").sum())
        rows.append(f"| {text} | {shown(figures[0])} | {shown(figures[1], 1)} | {shown(figures[2])} | {lost} |")
    each = mean(100 * cuts.of(policy, seeds) / law)
    of_one = ratio(100 * cuts.of(policy, seeds), cuts.of(CONSTANT, seeds))
    rows += ["", f"{len(seeds)} held-back machines, shifts of 20 minutes, `fast`; intervals are 95 % bootstraps over "
             "the machines. The share of the law's return is the ratio of the sums, in pairs. The machines' own "
             f"ratios of policy and law are {shown(each)} % on average. One setting for all is `{CONSTANT}`: the "
             "policy's law with the setting that cut the most on the training machines, without adaptation. The "
             f"policy earns {shown(of_one)} % of it. Rates and lost wires, machine by machine:", ""]  # fmt: skip
    rows += [f"| machine | {' | '.join(names.values())} |", "|---" * (len(names) + 1) + "|"]
    for seed in seeds:
        pairs = [[cuts.of(name, [seed], what)[0] for what in ("rate_mm2_min", "lost")] for name in names]
        cells = [f"{rate:.1f}; {lost:.0f}" for rate, lost in pairs]
        rows.append(f"| {seed} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def elsewhere(policy: str) -> str:
    """Return what policy and law earn on machines beyond the ranges of the training."""
    FOUND.mkdir(parents=True, exist_ok=True)
    rows = [f"| place | `{policy}`: rate, wires | `{LAW}` | ratio, % |", "|---|---|---|---|"]
    for place, options in ELSEWHERE.items():
        results = {
            name: [_cut_once(name, seed, place, options) for seed in held_back(PLACE_MACHINES)]
            for name in (policy, LAW)
        }
        returns = {name: np.array([one.total_return for one in made]) for name, made in results.items()}
        cells = [
            f"{np.mean([one.rate_mm2_min for one in made]):.1f}; {sum(one.wires_lost for one in made)}"
            for made in results.values()
        ]
        rows.append(f"| {place} | {cells[0]} | {cells[1]} | {shown(ratio(100 * returns[policy], returns[LAW]))} |")
    rows += ["", f"{PLACE_MACHINES} machines each, shifts of {SHORT_S / 60:.0f} minutes."]
    return "\n".join(rows)


def _cut_once(name: str, seed: int, place: str, options: dict[str, list[float]]) -> Result:
    """Make a cut, or take it from the file that it was noted in."""
    file = FOUND / f"{place.partition(':')[0]}-{seed}-{name.replace('/', '-').replace(':', '-')}.json"
    if not file.exists():
        file.write_text(json.dumps(list(cut(ENV_ID, seed, name, episode_s=SHORT_S, **options))), encoding="utf-8")
    return Result(*json.loads(file.read_text(encoding="utf-8")))


def main() -> None:
    """Make the cuts that are missing, then write or print the tables."""
    parser = argparse.ArgumentParser(description="Compare a policy that adapts with laws.")
    parser.add_argument("policy", nargs="?", default=POLICY)
    parser.add_argument("--cuts", type=int, default=MACHINES, help="held-back machines")
    arguments = parser.parse_args()
    seeds, cuts = list(held_back(arguments.cuts)), Cuts("MaxRateShift")
    cuts.make([arguments.policy, LAW, CONSTANT], seeds)
    found = table(arguments.policy, seeds, cuts)
    print(found)
    if arguments.policy != POLICY:
        return
    for page in PAGES:
        write_sections(page, {"adapted": found})
    scores = [score.score(cuts.results(name, seeds), "fast") for name in (POLICY, LAW)]
    score.write_card(POLICY.removeprefix("policy:"), [scores[0]._replace(controller="policy"), scores[1]])
    write_sections(PAGES[0], {"adapted-elsewhere": elsewhere(POLICY)})


if __name__ == "__main__":
    main()
