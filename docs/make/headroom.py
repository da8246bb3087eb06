"""``docs/headroom.md``: how much learning can gain in each task, from constants to laws that know the machine.

python docs/make/headroom.py               # the page of docs/headroom.json
python docs/make/headroom.py MaxRate       # makes the cuts of a task that are missing in out/headroom, then the page
python docs/make/headroom.py all

After an interruption the same command resumes, because every finished cut is a line of ``out/headroom/TASK.jsonl``.
Remove this file if the physics change. Constants and laws are chosen on `TRAINING` seeds and measured on held-back
ones.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sections import DOCS, table

from edmsim.envs.registry import env_id_of, make_family
from edmsim.evaluation.compare import CUT_TEXTS, Figure, held_back, leaderboard, mean
from edmsim.evaluation.episode import OF_TASK, ORACLE_GAPS_UM, Result, cut_job, engine_of
from edmsim.runs import RunTable, perform

FOUND, PAGE, CUTS = DOCS / "headroom.json", DOCS / "headroom.md", Path("out/headroom")
BOARD = DOCS / "leaderboard.jsonl"
SHIFTS = "MaxRateShift", "ThinWireShift"
"""Tasks whose cuts made here are added to the leaderboard, because they take long."""
TRAINING = range(100, 124)
USUAL_SEEDS = 12
"""Number of training seeds to choose a constant and a law, and of held-back seeds to measure them."""
SEEDS = {"Contour": 6, "ThinWireShift": 6}
"""The same for tasks whose cuts take long."""
LEAST_GAIN = 1.2
"""Least ratio of returns, of a law with privileged knowledge and the best law without, for which learning can pay
(ours)."""
OF_MACHINE = {"MaxRateShift": {1_000_008: ("adaptive-hold:limit_share=0.6,limit_spread=0.1",)}}
"""Laws that begin a shift with a machine's limit from an earlier shift, for a machine that lost many wires."""
SERVO_SETTINGS = """In MaxRateShift a law that knows the wire's limit was tried on one machine: it loses fewer wires
there and earns less. Settings of the servo were not tried here: see
[a policy that learns them](training.md#adapt-to-a-machine)."""
SERVO = "set-point:open_target_share="
GAP = f"{SERVO}0.05"


@dataclass(frozen=True)
class Candidates:
    """Candidates of a task.

    Attributes
    ----------
    constants, laws : tuple of str
        Constant settings, and laws that measure the gap; none sees more than a machine shows.
    variants : tuple of str
        Further parameters of laws. The best of all laws on each machine is the choice of a law that knows its
        constants.
    privileged : tuple of str
        Laws that see the true gap, bend or temperature; the best on each machine counts.
    of_machine : dict of int to tuple of str
        Laws that know the limit of one held-back machine, by its seed; it was found by trials on this machine.
    chosen : (str, str) or None
        The constant and the law with the highest return on training machines, if `docs/make/lines.py` found them;
        None to find them here.
    """

    constants: tuple[str, ...]
    laws: tuple[str, ...]
    variants: tuple[str, ...]
    privileged: tuple[str, ...]
    chosen: tuple[str, str] | None = None
    of_machine: dict[int, tuple[str, ...]] = field(default_factory=dict)

    @property
    def all(self) -> tuple[str, ...]:
        """All candidates without repetition, except those of single machines."""
        return tuple(dict.fromkeys([*self.constants, *self.laws, *self.variants, *self.privileged]))


FEEDS = Candidates(
    tuple(f"fixed:feed_um_s={feed}" for feed in (12, 16, 20, 24, 28, 36)),
    ("delay", "fuzzy", "voltage", "adaptive-off-time", "counts"),
    (*(f"delay:reference_us={us:g}" for us in (1.0, 1.4, 2.4, 3.2)),
     *(f"voltage:reference_V={v}" for v in (6, 10, 14))),
    tuple(f"oracle:gap_target_um={gap:g}" for gap in ORACLE_GAPS_UM),
)  # fmt: skip
_CORNER, _TRIM = OF_TASK["Corner"], OF_TASK["Trim"]
TASKS = {
    "GapFeed": FEEDS,
    "HeightStep": FEEDS,
    "Contour": FEEDS,
    "Corner": Candidates(
        tuple(f"{SERVO}{share:g},on_factor=1,period_factor={period:g}"
              for share in (0.4, 0.5, 0.6) for period in (0.7, 1.0)),
        tuple(name for name in _CORNER.compared if "corner_factor" in name or "pull" in name or name == "voltage"),
        tuple(f"{_CORNER.blind},pull_N_m={pull:g},fade_um=50" for pull in (-0.25, -0.75)),
        (_CORNER.reference,),
    ),
    "MaxRate": Candidates(
        ("fixed-period", *(f"fixed-period:period_us={period}" for period in (35, 45, 50))),
        ("heat-flux", *(f"heat-flux:hold_share={share:g}" for share in (0.3, 0.5))),
        ("heat-flux:hold_share=0.6",),
        ("heat-oracle",),
        ("fixed-period:period_us=35", "fixed-period:period_us=35"),
    ),
    "ThinWire": Candidates(
        tuple(f"{GAP},period_factor={factor:g}" for factor in (0.25, 0.35, 0.5, 0.7, 1.4)),
        tuple(f"climb:{GAP.partition(':')[2]}{change}" for change in ("", ",climb_s=2.5")),
        (),
        ("oracle",),
        (f"{GAP},period_factor=0.35", f"climb:{GAP.partition(':')[2]},climb_s=2.5"),
    ),
    "Trim": Candidates(
        tuple(f"fixed:feed_um_s={feed},offset_um={off}" for feed in (50, 100, 200) for off in (-8, -4, -2, 0, 4)),
        tuple(f"{SERVO}{share:g},proportional_um_s=200,integral_um_s2=400,offset_um={off}"
              for share in (0.4, 0.6) for off in (-4, -2, 0)),
        (),
        _TRIM.rehearsed,
    ),
    **{
        shift: Candidates((OF_TASK[shift].blind,), OF_TASK[shift].compared, (), (),
                          (OF_TASK[shift].blind, OF_TASK[shift].reference), OF_MACHINE.get(shift, {}))
        for shift in SHIFTS
    },
}  # fmt: skip
"""Candidates by task. ThinWire and Trim have no law that sees more than a machine shows; each machine's best constant
takes its place."""


OF_PART = (
    "Part is not measured here: [its page](tasks/part.md) has what the best of four variants of its law earns "
    "on each machine."
)


def row_of(result: Result) -> dict[str, Any]:
    """Return the stored row of a cut."""
    return {
        "controller": result.controller, "seed": result.seed, "return": round(result.total_return, 1),
        "rate_mm2_min": round(result.rate_mm2_min, 2), "lost": result.wires_lost + result.jammed,
        "result": list(result),
    }


def _made(env_id: str, job: tuple[str, int]) -> dict[str, Any]:
    return row_of(cut_job(env_id, job))


class Cuts:
    """The cuts of a task, from the leaderboard and from disk; missing cuts are made by `make`.

    Parameters
    ----------
    task : str
    """

    def __init__(self, task: str) -> None:
        self.task = task
        self._made: dict[tuple[str, int], dict[str, Any]] = {}
        CUTS.mkdir(parents=True, exist_ok=True)
        board = leaderboard(BOARD).get((env_id_of(task), "fast"))
        for result in (made for cuts in board.results.values() for made in cuts) if board else ():
            self._made[result.controller, result.seed] = row_of(result)
        self._table = RunTable(CUTS / f"{task}.jsonl")
        for row in self._table.rows.values():
            self._made[row["controller"], row["seed"]] = row

    def make(self, names: Sequence[str], seeds: Sequence[int]) -> None:
        """Make the missing cuts of controllers x seeds, and print the progress."""
        missing = [(name, seed) for seed in seeds for name in names if (name, seed) not in self._made]
        env_id, began = env_id_of(self.task), time.monotonic()

        def watch(done: int, _: int) -> None:
            left = f", {(time.monotonic() - began) / done * (len(missing) - done) / 60:.0f} min left" if done else ""
            sys.stderr.write(f"{self.task}: {done} of {len(missing)} cuts{left}\n")

        rows = perform(
            partial(_made, env_id), missing, watch, engine=engine_of(env_id, len(missing)), table=self._table,
            ids=[f"{name} {seed}" for name, seed in missing],
        )  # fmt: skip
        self._made.update(zip(missing, rows, strict=True))

    def has(self, name: str, seed: int) -> bool:
        """Return whether a cut has been made."""
        return (name, seed) in self._made

    def of(self, name: str, seeds: Sequence[int], what: str = "return") -> np.ndarray:
        """Return a figure of a controller's cuts, (seeds,)."""
        return np.array([self._made[name, seed][what] for seed in seeds], float)

    def results(self, name: str, seeds: Sequence[int]) -> list[Result]:
        """Return the results of a controller's cuts."""
        return [Result(*self._made[name, seed]["result"]) for seed in seeds]

    def rows(self, names: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
        """Return the cuts of some controllers as rows of the leaderboard."""
        env_id, resolution = env_id_of(self.task), make_family(self.task).resolution
        return [
            {"id": f"{env_id} {name} {made.seed}", "env_id": env_id, "resolution": resolution, **made._asdict()}
            for name in names for made in self.results(name, seeds)
        ]  # fmt: skip


def headroom(task: str) -> dict[str, Any]:
    """Return the figures of a task's lines for the page; make the missing cuts."""
    candidates, count = TASKS[task], SEEDS.get(task, USUAL_SEEDS)
    training, held = list(TRAINING)[:count], list(held_back(count))
    cuts = Cuts(task)
    if candidates.chosen is None:
        cuts.make([*candidates.constants, *candidates.laws], training)
    cuts.make(candidates.all, held)
    for seed, names in candidates.of_machine.items():
        cuts.make(names, [seed])
    if task in SHIFTS:
        board = RunTable(BOARD, texts=CUT_TEXTS)
        there = {(row["env_id"], row["controller"], row["seed"]) for row in board.rows.values()}
        made = cuts.rows(candidates.all, held)
        board.keep([
            *board.rows.values(),
            *(row for row in made if (row["env_id"], row["controller"], row["seed"]) not in there),
        ])

    def best(names: Sequence[str]) -> str:
        return max(names, key=lambda name: float(cuts.of(name, training).mean()))

    def best_each(names: Sequence[str]) -> list[str]:
        chosen = np.argmax([cuts.of(name, held) for name in names], axis=0)
        return [names[k] for k in chosen]

    constant, law = candidates.chosen or (
        best(candidates.constants), best([*candidates.constants, *candidates.laws])
    )
    known = tuple(dict.fromkeys([*candidates.constants, *candidates.laws, *candidates.variants]))
    on_each = [
        max((*known, *candidates.of_machine.get(seed, ())), key=lambda name: cuts.of(name, [seed])[0])
        for seed in held
    ]
    first, each = ("without adaptation", {}) if task in SHIFTS else (
        "best constant", {"best constant of each machine": best_each(candidates.constants)}
    )
    lines = {
        first: [constant] * count,
        "best law": [law] * count,
        **each,
        "law that knows each machine": on_each,
        **({"privileged law": best_each(candidates.privileged)} if candidates.privileged else {}),
    }
    rows = {}
    for line, names in lines.items():
        returns, rates, lost = (
            np.array([cuts.of(name, [seed], what)[0] for name, seed in zip(names, held, strict=True)])
            for what in ("return", "rate_mm2_min", "lost")
        )
        one = names[0] if len(set(names)) == 1 else ""
        rows[line] = {"name": one, "returns": returns.tolist(), "rates": rates.tolist(), "lost": int(lost.sum())}
    return {"seeds": count, "lines": rows}


def shown(figure: Figure, digits: int = 0) -> str:
    """Return a figure with its interval as text."""
    return f"{figure.value:.{digits}f} ({figure.low:.{digits}f} to {figure.high:.{digits}f})"


def margin(found: dict[str, Any]) -> tuple[Figure, float, str]:
    """Return the gain of the better privileged line over the best law: its mean, its share, and the line's name."""
    law = np.array(found["lines"]["best law"]["returns"])
    ends = ("privileged law", "law that knows each machine")
    more = {end: np.array(found["lines"][end]["returns"]) for end in ends if end in found["lines"]}
    end = max(more, key=lambda name: float(more[name].mean()))
    return mean(more[end] - law), float(more[end].mean() / law.mean() - 1.0), end


def verdict(above: Figure, share: float) -> str:
    """Return whether learning can pay in a task, as text."""
    if share < LEAST_GAIN - 1.0:
        return "comparison only"
    return "learning" if above.low > 0.0 else "learning, not significant"


INTRODUCTION = """\
# Headroom of the tasks

The headroom of a task is the difference between the best law that sees only what a machine can measure and a
controller that knows more. `python docs/make/headroom.py ThinWire` measures it for a task, shows its progress,
and resumes after an interruption. `docs/headroom.json` has the figures of every machine.

Constants and laws were chosen on training machines: seeds from 100 on, as many as the held-back machines on which
they were measured. In MaxRate and ThinWire they were chosen on 24, in MaxRate with seeds from 1 on. In the shifts
they are the [reference lines](benchmark.md). Returns have 95 % intervals over the held-back machines. The
lines are:

- *best constant*: the setting with the highest mean return on the training machines; in the shifts it is *without
  adaptation*, the controller of score 0;
- *best law*: the best there of constants and laws without privileged knowledge;
- *best constant of each machine*: the best on this very machine, found by trying all of them;
- *law that knows each machine*: the best of constants, laws and further parameters of these laws on this very
  machine, as if its constants were known. Both are the best of several cuts, which includes some luck;
- *privileged law*: sees the true gap, bend or temperature. In ThinWire and Trim it is the best of several
  constants for each machine.
"""


def page(board: dict[str, Any]) -> str:
    """Return the page of the documentation."""
    rows = []
    for task, found in ((name, board[name]) for name in board if name not in SHIFTS):
        above, share, end = margin(found)
        best = mean(np.array(found["lines"]["best law"]["returns"]))
        more = mean(np.array(found["lines"][end]["returns"]))
        gain = f"{shown(above)}, {100 * share:.0f} %"
        rows.append((task, shown(best), f"{shown(more)}, {end}", gain, verdict(above, share)))
    heads = "task", "best law", "with privileged knowledge", "above the best law", "use"
    parts = [
        INTRODUCTION, "## Summary", "", table(heads, rows), "",
        f"Use a task with less than {100 * (LEAST_GAIN - 1):.0f} % above the best law to compare laws and "
        "learners, but not to show that learning pays.", "", OF_PART, "", *_of_shifts(board),
    ]  # fmt: skip
    for task, found in board.items():
        rows = []
        for line, row in found["lines"].items():
            mean_return, rate = mean(np.array(row["returns"])), mean(np.array(row["rates"]))
            name = f"`{row['name']}`" if row["name"] else ""
            rows.append((line, shown(mean_return), shown(rate, 1), str(row["lost"]), name))
        made = table(("line", "return", "net rate, mm2/min", "wires lost, jams", "controller"), rows)
        parts += [f"## {task}", "", made, "", f"{found['seeds']} machines, resolution `fast`.", ""]
    return "\n".join(parts)


def _of_shifts(board: dict[str, Any]) -> list[str]:
    """Return the paragraphs on the shifts: gain of adaptation, and gain known to be possible beyond it."""
    sentences = []
    for task in (name for name in SHIFTS if name in board):
        lines = {line: np.array(row["returns"]) for line, row in board[task]["lines"].items()}
        best, first = lines["best law"], lines["without adaptation"]
        above, share, end = margin(board[task])
        sentences += [
            f"- {task}: the best law, `{board[task]['lines']['best law']['name']}`, adapts. It earns "
            f"{shown(mean(best - first))} more than the line without adaptation, "
            f"{100 * (best.mean() / first.mean() - 1):.0f} %. The {end} earns {shown(above)} more than the best law, "
            f"{100 * share:.0f} %.",
        ]  # fmt: skip
    if not sentences:
        return []
    return ["In the shifts a law can learn about its machine:", "", *sentences, "", SERVO_SETTINGS, ""]


def main() -> None:
    """Make the missing cuts of the requested tasks, and write the page."""
    parser = argparse.ArgumentParser(description="Measure what tasks have left to be learned.")
    parser.add_argument("tasks", nargs="*", choices=[*TASKS, "all", []], help="tasks to measure, or all")
    chosen = parser.parse_args().tasks
    board = json.loads(FOUND.read_text(encoding="utf-8")) if FOUND.exists() else {}
    for task in TASKS if "all" in chosen else chosen:
        board[task] = headroom(task)
        board = {name: board[name] for name in TASKS if name in board}
        FOUND.write_text(json.dumps(board, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(board), encoding="utf-8")


if __name__ == "__main__":
    from headroom import main as run  # because other processes import functions by module

    run()
