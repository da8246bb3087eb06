"""The tables of ``docs/reliability.md``, from files of ``make campaign``, ``make soak`` and ``make lost-node``.

python docs/make/reliability.py [out]
"""

import json
import sys
from pathlib import Path
from typing import Any

from sections import table, write_sections

Known = dict[str, dict[str, Any]]


def campaign(found: Known) -> str:
    """Return the table with a row for every reader, and their sum."""
    counted = "inputs", "taken", "refused"
    rows = []
    for name, one in found.items():
        text = "; ".join(f"{kind}: {count}" for kind, count in one["found"].items()) or "0"
        rows.append((name, *(f"{one.get(key, 0):,}" for key in counted), text, str(one["peak_MB"])))
    totals = (f"{sum(one.get(key, 0) for one in found.values()):,}" for key in counted)
    wrong = sum(sum(one["found"].values()) for one in found.values())
    rows.append(("all", *totals, str(wrong), str(max(one["peak_MB"] for one in found.values()))))
    return table(("reader", *counted, "wrong", "peak, MB"), rows)


def _interval(rate: list[float], unit: str) -> str:
    return f"{rate[0]:.0f} {unit} ({rate[1]:.0f} to {rate[2]:.0f})"


def soak(found: Known) -> str:
    """Return the table with a row for every part that was run."""
    rows: dict[str, str] = {}
    if one := found.get("hour"):
        rows[f"{one['machine_s']:.0f} s of a machine, {one['windows']:,} windows"] = (
            f"memory grows by {_interval(one['growth_kB_per_h'], 'kB an hour')}, at {one['held_MB']:.0f} MB; "
            f"{one['equal']} of {one['restored']} restored plants went on alike"
        )
    if one := found.get("steps"):
        rows[f"{one['steps']:,} steps of environments, {one['episodes']:,} episodes"] = (
            f"memory grows by {_interval(one['growth_kB_per_million'], 'kB a million')}, at {one['held_MB']:.0f} MB"
        )
    if one := found.get("kills"):
        rows[f"{one['killed']} kills of {one['cuts']} cuts"] = (
            f"{one['equal']} of {one['cuts']} ended like a cut without a kill; {one['with_checkpoint']} kills left a "
            "checkpoint to resume from, others were before the first checkpoint or after the results"
        )
    if one := found.get("vectors"):
        for kind, same in one["same_rewards"].items():
            rows[kind] = "the rewards of one process" if same else "other rewards than in one process"
        rows["left open by them"] = _left(one["left"])
    if one := found.get("open"):
        rows[f"plants and environments, {one['times']} times"] = f"left open: {_left(one['left'])}"
    if one := found.get("sweep"):
        alike = "the same, bit for bit, as" if one["same_as_local"] else "not the same as"
        rows[f"{one['cuts']} cuts on two Ray nodes"] = (
            f"a node lost after {one['node_lost_after']}, the driver killed after {one['driver_killed_after']}; "
            f"missing {one['missing']}, twice {one['twice']}, repeated "
            f"{one['made_again_though_done']}, failed {one['failed']}; rows are {alike} those of this computer"
        )
    return table(("what", "result"), rows.items())


def _left(left: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in left.items())


def main() -> None:
    """Write the tables for which there are files."""
    out = Path(sys.argv[1] if sys.argv[1:] else "out")
    written = {}
    for name, made in (("campaign", campaign), ("soak", soak)):
        file = out / name / f"{name}.json"
        if file.exists():
            written[name] = made(json.loads(file.read_text(encoding="utf-8")))
    write_sections("reliability.md", written)


if __name__ == "__main__":
    main()
