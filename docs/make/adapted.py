"""An adapting policy compared with laws on held-back machines: return, lost wires, and ratio to the best law.

python docs/make/adapted.py                          # tables of tasks/max-rate-shift.md, and the card
python docs/make/adapted.py policy:out/adapt/policy.json --cuts 4    # your own policy; only prints the tables

Missing cuts are made and stored in ``out/headroom`` and ``out/adapted``, so after an interruption the same command
resumes. A shift takes about half a minute of processor time.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from headroom import Cuts, shown
from sections import table, write_sections

from edmsim.errors import InputError
from edmsim.evaluation.compare import held_back, mean, ratio
from edmsim.evaluation.episode import HELD_BACK, Result, cut
from edmsim.learning import bandit, score

ENV_ID, POLICY, LAW = "edmsim/MaxRateShift-v0", "policy:MaxRateShift-adapt", "adaptive-hold"
FIRST, MACHINES = HELD_BACK + 36, 72
"""Seed of the first machine and their number, a day of machine time for each controller. The held-back machines
before had served to measure other policies."""
FEW = 2
"""Number of wires lost by the law up to which its wires do not limit it."""
ELSEWHERE = {
    "higher: 80 to 100 mm": {"height_mm": [80.0, 100.0]},
    "less pressure: 20 to 50 kPa": {"flushing_Pa": [20e3, 50e3]},
}
"""Conditions beyond the ranges of the training machines, with shifts of `SHORT_S`."""
SHORT_S, PLACE_MACHINES = 300.0, 3
FOUND = Path("out/adapted")


def law_below(policy: str) -> str:
    """Return the law of a bandit with its first setting, which is the same for all machines."""
    file = bandit.find(policy)
    if file is None:
        raise InputError(f"'{policy}' is not a policy that adapts")
    return bandit.load(file).law


def earnings(names: dict[str, str], seeds: Sequence[int], cuts: Cuts) -> str:
    """Return the table of returns of the policy, its law and the reference; `names` has their texts on the page."""
    (policy, one, _), law = names, cuts.of(LAW, seeds)
    rows = []
    for name, text in names.items():
        part = ratio(100 * cuts.of(name, seeds), law)
        figures = mean(cuts.of(name, seeds)), mean(cuts.of(name, seeds, "rate_mm2_min")), part
        lost = int(cuts.of(name, seeds, "lost").sum())
        rows.append((text, shown(figures[0]), shown(figures[1], 1), shown(figures[2]), str(lost)))
    each = mean(100 * cuts.of(policy, seeds) / law)
    of_one = ratio(100 * cuts.of(policy, seeds), cuts.of(one, seeds))
    heads = "controller", "return", "net rate, mm2/min", "of the law's, %", "wires lost"
    return f"{table(heads, rows)}\n\n" + (
        f"{len(seeds)} held-back machines, seeds {seeds[0]} to {seeds[-1]}, shifts of 20 minutes, `fast`; intervals "
        "are those of 95 % over the machines. The share of the law's return is the ratio of the sums, in pairs. "
        f"The machines' own ratios of policy and law are {shown(each)} % on average. One setting for all is `{one}`: "
        f"the policy's law with its first setting, without adaptation. The policy earns {shown(of_one)} % of it."
    )


def groups(names: dict[str, str], seeds: Sequence[int], cuts: Cuts) -> str:
    """Return the table of shares of the law's return and of lost wires, by whether wires limit the law."""
    few = cuts.of(LAW, seeds, "lost") <= FEW
    rows = []
    for label, chosen in ((f"at most {FEW}", few), ("more", ~few)):
        there = np.array(seeds)[chosen].tolist()
        if not there:
            continue
        shares = [shown(ratio(100 * cuts.of(name, there), cuts.of(LAW, there))) for name in names if name != LAW]
        lost = [str(int(cuts.of(name, there, "lost").sum())) for name in names]
        rows.append((label, str(len(there)), *shares, ", ".join(lost)))
    policy, one, _ = names.values()
    heads = "wires that the law loses", "machines", f"{policy}, % of the law's", f"{one}, %", "wires lost by each"
    return table(heads, rows)


def machines(names: dict[str, str], seeds: Sequence[int], cuts: Cuts) -> str:
    """Return the table of rates and lost wires on every machine."""
    rows = []
    for seed in seeds:
        pairs = [[cuts.of(name, [seed], what)[0] for what in ("rate_mm2_min", "lost")] for name in names]
        rows.append((str(seed), *(f"{rate:.1f}; {lost:.0f}" for rate, lost in pairs)))
    return f"Rates and lost wires, machine by machine:\n\n{table(('machine', *names.values()), rows)}"


def elsewhere(policy: str) -> str:
    """Return the table of policy and law on machines beyond the ranges of the training."""
    FOUND.mkdir(parents=True, exist_ok=True)
    rows = []
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
        rows.append((place, *cells, shown(ratio(100 * returns[policy], returns[LAW]))))
    heads = "place", f"`{policy}`: rate, wires", f"`{LAW}`", "ratio, %"
    return f"{table(heads, rows)}\n\n{PLACE_MACHINES} machines each, shifts of {SHORT_S / 60:.0f} minutes."


def _cut_once(name: str, seed: int, place: str, options: dict[str, list[float]]) -> Result:
    """Return the result of a cut, from its file if it was made before."""
    file = FOUND / f"{place.partition(':')[0]}-{seed}-{name.replace('/', '-').replace(':', '-')}.json"
    if not file.exists():
        file.write_text(json.dumps(list(cut(ENV_ID, seed, name, episode_s=SHORT_S, **options))), encoding="utf-8")
    return Result(*json.loads(file.read_text(encoding="utf-8")))


def main() -> None:
    """Make the missing cuts, then write or print the tables."""
    parser = argparse.ArgumentParser(description="Compare a policy that adapts with laws.")
    parser.add_argument("policy", nargs="?", default=POLICY)
    parser.add_argument("--cuts", type=int, default=MACHINES, help="number of held-back machines")
    arguments = parser.parse_args()
    seeds, cuts = range(FIRST, FIRST + arguments.cuts), Cuts("MaxRateShift")
    policy = arguments.policy
    names = {policy: f"`{policy}`", law_below(policy): "one setting for all", LAW: f"`{LAW}`"}
    cuts.make(list(names), seeds)
    found = "\n\n".join(make(names, seeds, cuts) for make in (earnings, groups, machines))
    if policy != POLICY:
        print(found)
        return
    write_sections("tasks/max-rate-shift.md", {"adapted": found})
    scores = [score.score(cuts.results(name, seeds), "fast") for name in (POLICY, LAW)]
    score.write_card(POLICY, [scores[0]._replace(controller="policy"), scores[1]])
    write_sections("tasks/max-rate-shift.md", {"adapted-elsewhere": elsewhere(POLICY)})


if __name__ == "__main__":
    main()
