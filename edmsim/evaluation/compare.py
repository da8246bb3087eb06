"""Compare controllers on identical machines: their cuts, figures with intervals, and tables and pages of these."""

import inspect
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.text import Text

from edmsim import __version__, files, models, numeric, runs, screen, user_code
from edmsim.controllers import choices, from_text
from edmsim.envs import arguments, pass_laws, registry
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.evaluation.episode import FINISHED, HELD_BACK, ORACLE, Result, cut, engine_of, is_part, lines_of
from edmsim.plant.resolution import resolution as check_resolution
from edmsim.recording.figures.palette import BLUE, MUTED
from edmsim.recording.report import FigureKind, kinds_of

CONFIDENCE = 0.95  # level of all intervals
RESAMPLES = 2000  # bootstrap resamples (ours: the ends of the intervals then vary by a few percent of their width)
MOST_SHARE = 0.9  # greatest share of a pair in the divisor of a ratio with an interval (ours)


@dataclass(frozen=True)
class Figure:
    """A figure with its 95 % interval; all NaN if nothing was measured."""

    value: float
    low: float
    high: float


_OF_CUTS = kinds_of(Result)
FIGURES = {
    "score": FigureKind("", "score", 2), "rate_mm2_min": _OF_CUTS["rate_mm2_min"],
    "oracle_share": FigureKind("%", "share of the oracle's rate"),
    **{name: _OF_CUTS[name] for name in (
        "short_share", "open_share", "total_return", "error_um", "edge_error_um", "ra_um",
    )},
    "time_s": FigureKind("s", "time of finished cuts"), "breaks_per_m": FigureKind("", "wire breaks per m"),
    "jams_per_m": FigureKind("", "jams per m"), "cost": _OF_CUTS["cost"],
}  # fmt: skip
"""Figures of a controller, by name."""
WIDE = 170  # width of a terminal from which the table shows intervals
HEADS = {
    "score": "score", "rate_mm2_min": "mm2/min", "oracle_share": "of oracle", "short_share": "short",
    "open_share": "open", "total_return": "return", "error_um": "path um", "edge_error_um": "edge um",
    "ra_um": "Ra um", "time_s": "s", "breaks_per_m": "breaks/m", "jams_per_m": "jams/m", "cost": "cost",
}  # fmt: skip
"""Headings of the columns on the screen."""
NARROW = {"score", "rate_mm2_min", "short_share", "open_share", "edge_error_um", "ra_um", "time_s"}
"""Figures that a narrow terminal shows."""
RARE = {"breaks_per_m", "jams_per_m"}  # figures that are often 0, with intervals that are hard to read


@dataclass(frozen=True)
class Comparison:
    """Comparison of controllers in one environment."""

    env_id: str
    resolution: str
    seeds: tuple[int, ...]  # held-back seeds; every controller makes one cut per seed
    results: dict[str, list[Result]]  # cuts of each controller, in the order of `seeds`
    figures: dict[str, dict[str, Figure]]  # figures of each controller, by the names in `FIGURES`

    @classmethod
    def of(cls, env_id: str, resolution: str, seeds: tuple[int, ...], results: dict[str, list[Result]]) -> Self:
        """Return the comparison of cuts, which include those of score 0 and 1."""
        lines = lines_of(env_id)
        oracle, blind = results[lines.reference], results[lines.blind]
        figures = {name: figures_of(made, oracle, blind) for name, made in results.items()}
        return cls(env_id, resolution, seeds, results, figures)


@refuses_wrong_types
def evaluate(
    env_id: str, controllers: Sequence[str] | None = None, seeds: int | None = None, *,
    resolution: str | None = None, record: str | Path | None = None, watch: Callable[[int, int], None] | None = None,
    table: runs.RunTable | None = None,
) -> Comparison:
    """Compare controllers on the same cuts, on all cores.

    Parameters
    ----------
    env_id : str
        One of `env_ids`, or the id of your own environment (see `edmsim.envs.register`).
    controllers : sequence of str, optional
        See `edmsim.controllers.from_text`; for Part `edmsim.envs.pass_laws.from_text`. By default `usual`. The
        task's references of score 0 and 1 (`edmsim.evaluation.episode.Lines`) always run,
        as they scale the other scores.
    seeds : int, optional
        Number of held-back seeds, 2 or more: cuts of each controller. By default that of the environment's
        benchmark.
    resolution : {"fast", "default", "fine"}, optional
        By default the environment's.
    record : path, optional
        Folder for recordings; each cut has its own (`edmsim.evaluation.episode.recording_folder`).
    watch : callable, optional
        Called with the number of finished cuts and of all cuts.
    table : edmsim.runs.RunTable, optional
        Finished cuts, to which the missing ones are added; so an interrupted evaluation resumes. See `leaderboard`.

    Returns
    -------
    Comparison
        It depends only on the arguments, not on the number of cores.

    Raises
    ------
    InputError
        If an environment, controller or resolution is unknown, `seeds` is below 2, or the folder is not writable.
    """
    controllers = usual(env_id) if controllers is None else controllers
    lines = lines_of(env_id)
    seeds = lines.seeds if seeds is None else seeds
    check(env_id, controllers, seeds, resolution)
    if record is not None:
        if is_part(env_id):
            raise InputError(f"episodes of {env_id} are not recorded: edmsim cut --passes records the same part")
        record = files.make_writable(record)
    resolution = resolution or registry.arguments_with(env_id).resolution
    results = run(env_id, list(dict.fromkeys([*controllers, lines.blind, lines.reference])), seeds, resolution, watch,
                  record, table)  # fmt: skip
    return Comparison.of(env_id, resolution, held_back(seeds), results)


def run(
    env_id: str, controllers: Sequence[str], seeds: int, resolution: str,
    watch: Callable[[int, int], None] | None = None, record: Path | None = None, table: runs.RunTable | None = None,
) -> dict[str, list[Result]]:
    """Make every controller's cuts; see `evaluate` for the arguments."""
    # the oracle's cuts take longest, because it rehearses: they run first, so that no core waits for them at the end
    jobs = [(name, seed) for name in reversed(controllers) for seed in held_back(seeds)]
    of_cuts = {name: {**made_with(env_id, name), "resolution": resolution} for name in controllers}
    versions = {name: runs.identity(content) for name, content in of_cuts.items()}
    ids = [runs.identity({**of_cuts[name], "seed": seed, "record": record and str(record)}) for name, seed in jobs]
    table = table or runs.RunTable()
    for name in ids:
        if name in table.rows:  # raises for a damaged row before the first cut
            _result_of(table.rows[name], table.file)
    rows = runs.perform(
        partial(_row, env_id, resolution, record, versions), jobs, watch, engine=engine_of(env_id, len(jobs)),
        table=table, ids=ids,
    )  # fmt: skip
    made = {job: _result_of(row, table.file) for job, row in zip(jobs, rows, strict=True)}
    return {name: [made[name, seed] for seed in held_back(seeds)] for name in controllers}


def made_with(env_id: str, controller: str) -> dict[str, Any]:
    """Return all that determines a controller's episodes of an environment, for JSON."""
    family, options = registry.find(env_id)
    digests = runs.digests_of([controller, inspect.getfile(family), *options.values()])
    return {
        **arguments.plain(options), "edmsim": __version__, "env_id": env_id, "controller": controller,
        "files": sorted(digests.values()),
    }  # fmt: skip


def _row(
    env_id: str, resolution: str, record: Path | None, versions: Mapping[str, str], job: tuple[str, int]
) -> dict[str, Any]:
    """Make a controller's cut of a seed."""
    result = cut(env_id, job[1], job[0], resolution, record)
    return {"env_id": env_id, "resolution": resolution, "version": versions[job[0]], **result._asdict()}


def _result_of(row: Mapping[str, Any], file: str | Path | None) -> Result:
    """Return the cut of a table's row; raises `InputError` if a value is missing or has the wrong type."""
    try:
        made = Result(*(row[name] for name in Result._fields))
    except KeyError as error:
        raise InputError(f"a row of this table of cuts has no {error}", file) from None
    kinds = {"controller": "a text", "outcome": "a text", "seed": "a whole number"}
    for figure, value in made._asdict().items():
        kind = kinds.get(figure, "a number")
        fits = {"a text": isinstance(value, str), "a whole number": numeric.whole(value) is not None}
        if not fits.get(kind, numeric.real(value) is not None):
            raise InputError(f"{figure} of the cut {row['id']} is {value!r}, and must be {kind}", file)
    return made


CUT_TEXTS = ("id", "env_id", "resolution", "controller")  # columns of text in a table of cuts


@refuses_wrong_types
def leaderboard(file: str | Path) -> dict[tuple[str, str], Comparison]:
    """Return the comparisons of a table of cuts, by environment id and resolution; none if there is no such file.

    If a cut was repeated, the last one counts. If a controller's files or edmsim's version changed, only its
    cuts with the last version count. A comparison has the seeds of its references; a controller without cuts of all
    of them is left out.

    Raises
    ------
    InputError
        If the file is not a table of cuts, or is damaged.
    """
    cuts: dict[tuple[str, str], dict[str, dict[int, Result]]] = {}
    rows = runs.read_rows(file, texts=CUT_TEXTS)
    last = {tuple(row[name] for name in CUT_TEXTS[1:]): row["version"] for row in rows if "version" in row}
    for row in rows:
        made_cut, of_env = _result_of(row, file), cuts.setdefault((row["env_id"], row["resolution"]), {})
        version = last.get(tuple(row[name] for name in CUT_TEXTS[1:]))
        if row.get("version", version) == version:
            of_env.setdefault(row["controller"], {})[row["seed"]] = made_cut
    found = {}
    for (env_id, resolution), made in sorted(cuts.items()):
        try:
            lines = lines_of(env_id)
        except InputError as error:
            raise InputError(error.reason, file) from None
        seeds = tuple(sorted(made.get(lines.blind, {}).keys() & made.get(lines.reference, {}).keys()))
        if seeds:
            complete = {name: made[name] for name in sorted(made) if made[name].keys() >= set(seeds)}
            results = {name: [by_seed[seed] for seed in seeds] for name, by_seed in complete.items()}
            found[env_id, resolution] = Comparison.of(env_id, resolution, seeds, results)
    return found


def held_back(seeds: int) -> tuple[int, ...]:
    """Return the first held-back seeds."""
    return tuple(range(HELD_BACK, HELD_BACK + seeds))


@refuses_wrong_types
def usual(env_id: str) -> list[str]:
    """Return the default controllers of a comparison: the task's classic controllers and its shipped policies."""
    return [*lines_of(env_id).compared, *(f"policy:{name}" for name in models.policies(env_id))]


def env_ids() -> tuple[str, ...]:
    """Return the ids of the benchmark environments."""
    return registry.registered_ids()


def check_controllers(controllers: Sequence[str], env_id: str) -> None:
    """Raise `InputError` if no controller is named, or one cannot be made; those of Part are laws of passes."""
    make, known = (pass_laws.from_text, pass_laws.LAWS) if is_part(env_id) else (from_text, choices())
    for name in controllers:
        if name != ORACLE:
            make(name)
    if not controllers:
        raise InputError(f"no controller is named; choose from {', '.join(known)}")


def check(env_id: str, controllers: Sequence[str], seeds: int, resolution: str | None) -> None:
    """Raise `InputError` if `evaluate` cannot use these arguments."""
    if resolution is not None:
        check_resolution(resolution)
    check_controllers(controllers, env_id)
    numeric.whole_from("seeds", seeds, 2)  # one gives no interval


def figures_of(results: Sequence[Result], oracle: Sequence[Result], blind: Sequence[Result]) -> dict[str, Figure]:
    """Return a controller's figures from its cuts and those of reference and blind controller, seed by seed."""
    # rates, shares and errors are means over the cuts; breaks and jams are their sums over the sum of lengths cut;
    # the share of the oracle's rate is the mean rate over the oracle's mean rate; the score is the
    # interquartile mean of `scores`

    def values(name: str, of: Iterable[Result] = results) -> NDArray[np.float64]:
        return np.array([getattr(r, name) for r in of], np.float64)

    def of_each(name: str, of: Iterable[Result] = results) -> Figure:
        known = values(name, of)[np.isfinite(values(name, of))]
        return ratio(known, np.ones_like(known))  # none is below 0, nor are the ends of its interval

    metres = values("length_mm") * 1e-3
    return {
        "score": interquartile_mean(scores(results, oracle, blind)),
        "rate_mm2_min": of_each("rate_mm2_min"),
        "oracle_share": ratio(values("rate_mm2_min"), values("rate_mm2_min", oracle)),
        **{name: of_each(name) for name in ("short_share", "open_share")},
        "total_return": mean(values("total_return")),
        **{name: of_each(name) for name in ("error_um", "edge_error_um", "ra_um")},
        "time_s": of_each("time_s", [r for r in results if r.outcome == FINISHED]),
        "breaks_per_m": per_metre(values("wires_lost"), metres),
        "jams_per_m": per_metre(values("jammed"), metres),
        "cost": of_each("cost"),
    }


def scores(results: Sequence[Result], oracle: Sequence[Result], blind: Sequence[Result]) -> NDArray[np.float64]:
    """Return the score of every cut: 0 is the blind controller's return on the same machine, 1 the reference's."""
    # leave out machines on which the reference has no greater return: they give no scale
    made, most, least = (np.array([r.total_return for r in of]) for of in (results, oracle, blind))
    tells = most > least
    return np.asarray((made - least)[tells] / (most - least)[tells])


def interquartile_mean(values: NDArray[np.float64]) -> Figure:
    """Mean of the middle half of values, with its bootstrap interval, as Agarwal et al. (NeurIPS 2021) recommend."""
    from scipy.stats import trim_mean

    return _of_one(partial(trim_mean, proportiontocut=0.25), values)


def median(values: NDArray[np.float64]) -> Figure:
    """Median with its bootstrap interval."""
    return _of_one(np.median, values)


def _of_one(statistic: Callable[..., Any], values: NDArray[np.float64]) -> Figure:
    """Return a statistic with its percentile bootstrap interval: zero width for equal values, NaN for one or none."""
    from scipy.stats import bootstrap

    if len(values) < 2 or np.ptp(values) == 0.0:
        value = float(statistic(values)) if len(values) else np.nan
        return Figure(value, *[value if len(values) > 1 else np.nan] * 2)
    interval = bootstrap(
        (values,), statistic, vectorized=True, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
        method="percentile", rng=np.random.default_rng(0),
    ).confidence_interval
    return Figure(float(statistic(values)), float(interval.low), float(interval.high))


def mean(values: NDArray[np.float64]) -> Figure:
    """Mean with Student's interval."""
    if len(values) < 2:
        return Figure(float(values.mean()) if len(values) else np.nan, np.nan, np.nan)
    value, count = float(values.mean()), len(values)
    half = students_t(count - 1) * float(values.std(ddof=1)) / math.sqrt(count)
    return Figure(value, value - half, value + half)


def students_t(freedom: int) -> float:
    """Return half the width of Student's interval, in standard errors; of n values the freedom is n - 1."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + CONFIDENCE / 2))


def per_metre(events: NDArray[np.float64], metres: NDArray[np.float64]) -> Figure:
    """Events over length cut, with an interval."""
    # without any event `ratio` has no interval; the upper end is then the rate at which 5 % of such comparisons
    # would have no event in this length (Poisson: -ln 0.05 events, the "rule of three")
    if events.any() or metres.sum() == 0:
        return ratio(events, metres)
    return Figure(0.0, 0.0, float(-np.log(1.0 - CONFIDENCE) / metres.sum()))


def ratio(upper: NDArray[np.float64], lower: NDArray[np.float64]) -> Figure:
    """Sum over sum of pairs, with Student's interval; it is NaN if one pair has nearly the whole divisor."""
    # A percentile bootstrap of three to twelve skewed pairs holds the true ratio in 66 to 90 % of all cases. With the
    # error of the jackknife Student's t does in 90 to 97 %, on the logarithm, which negative values do not have.
    count, whole = len(upper), float(lower.sum())
    if count == 0 or whole == 0:
        return Figure(np.nan, np.nan, np.nan)
    value = float(upper.sum()) / whole
    if count < 2 or lower.max() > MOST_SHARE * whole:
        return Figure(value, np.nan, np.nan)
    without = (upper.sum() - upper) / (whole - lower)
    half = students_t(count - 1) * float(without.std()) * math.sqrt(count - 1)
    if value == 0.0 or (upper < 0.0).any():
        return Figure(value, value - half, value + half)
    return Figure(value, value * math.exp(-half / value), value * math.exp(half / value))


def shown(name: str, figure: Figure) -> str:
    """Return a figure with its interval as text; empty if the figure is NaN."""
    if math.isnan(figure.value):
        return ""
    kind = FIGURES[name]
    is_share = kind.unit == "%"
    values = [100 * v if is_share else v for v in (figure.value, figure.low, figure.high)]
    unit = " %" if is_share else ""
    texts = [f"{v:.0f}" if abs(v) >= 99.5 else f"{v:.{kind.digits}f}" for v in values]
    if name in RARE and figure.value == 0.0:
        return f"none (at most {texts[2]})"
    between = "" if math.isnan(figure.low) else f" ({texts[1]} to {texts[2]})"
    return f"{texts[0]}{unit}{between}"


def ranked(comparison: Comparison, by: str = "score") -> list[str]:
    """Return the controllers, sorted by a figure, the greatest first."""
    return sorted(comparison.figures, key=lambda name: -np.nan_to_num(comparison.figures[name][by].value))


def columns(comparison: Comparison) -> list[str]:
    """Return the figures that the environment has."""
    return [name for name in FIGURES if any(not math.isnan(f[name].value) for f in comparison.figures.values())]


def render(comparison: Comparison, width: int) -> Group:
    """Return the table for the terminal, best controller first, and the meaning of its columns.

    A wide terminal shows every figure with its interval, a narrow one only the most important figures.
    """
    wide = width >= WIDE
    used = [name for name in columns(comparison) if wide or name in NARROW]
    heads = [HEADS[name] for name in used] + ([] if wide else ["breaks", "jams"])
    title = f"{comparison.env_id}, {len(comparison.seeds)} cuts each, resolution {comparison.resolution}"
    table = screen.ScreenTable(
        "controller", numbers=heads, title=title, box=None, padding=(0, 2, 0, 0), title_justify="left"
    )
    for controller in ranked(comparison):
        figures = comparison.figures[controller]
        cells = [shown(name, figures[name]) for name in used]
        if wide:
            cells = [cell.replace(" (", "\n(") for cell in cells]
        else:
            made = comparison.results[controller]
            events = sum(cut.wires_lost for cut in made), sum(cut.jammed for cut in made)
            cells = [*(cell.split(" (")[0] for cell in cells), *map(str, events)]
        table.add_row(user_code.policy_of(controller), *cells)
    return Group(table, Text(f"\n{_meaning(comparison, wide)}"))


def _meaning(comparison: Comparison, wide: bool) -> str:
    lines = lines_of(comparison.env_id)
    text = (
        f"score: 0 is what {lines.blind} earns, and 1 what {lines.reference} earns, the reference. "
        "short, open: shares of the pulses that are shorts or do not ignite."
    )
    if wide:
        return text + " In parentheses: 95 % intervals over the cuts."
    cuts = len(comparison.seeds)
    return f"{text} breaks, jams: of all {cuts} cuts together. --json prints more figures, with 95 % intervals."


def as_json(comparisons: Sequence[Comparison], policies: Mapping[str, Sequence[Any]] | None = None) -> str:
    """Return environments, then policies, as JSON; unknown values are null."""
    found = [
        {
            "env_id": made.env_id,
            "resolution": made.resolution,
            "seeds": list(made.seeds),
            "edmsim_version": __version__,
            "controllers": {
                name: {key: _known(vars(figure)) for key, figure in figures.items()}
                for name, figures in made.figures.items()
            },
            "cuts": [_known(result._asdict()) for results in made.results.values() for result in results],
        }
        for made in comparisons
    ]  # fmt: skip
    of_policies = [
        {"policy": name, "scores": [_known(row._asdict()) for row in rows]} for name, rows in (policies or {}).items()
    ]
    return json.dumps([*found, *of_policies], indent=2, allow_nan=False)


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with None for NaN."""
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in values.items()}


def markdown_table(comparison: Comparison) -> list[str]:
    """Return the lines of the table in Markdown, the best controller first, with all intervals."""
    used = columns(comparison)
    heads = " | ".join(FIGURES[name].heading for name in used)
    lines = [f"| controller | {heads} |", "|---" * (len(used) + 1) + "|"]
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        lines.append(f"| `{controller}` | " + " | ".join(cells) + " |")
    lines += ["", f"{len(comparison.seeds)} cuts each, resolution `{comparison.resolution}`."]
    return lines


NAME_LETTERS = 48  # longer names of controllers appear without their parameters in a figure; the table has them


def write_page(file: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the page, and its figures as ``NAME-ENVIRONMENT.png`` in the same folder; see `draw_returns`."""
    from edmsim.recording.figures.style import own_style, write_figure

    files.make_writable(file.parent)
    parts = ["# Controllers compared", ""]
    for made in comparisons:
        name = f"{file.stem}-{re.sub(r'[^0-9A-Za-z]+', '-', made.env_id.removeprefix('edmsim/'))}.png"
        with own_style():
            write_figure(draw_returns(made), file.with_name(name))
        lines = lines_of(made.env_id)
        parts += [
            f"## {made.env_id}", "", f"![Return of every cut, and the mean of each controller]({quote(name)})", "",
            "*Returns of the same machines under all controllers: a dot for each machine; the line is the mean with "
            "its 95 % interval.*", "", *markdown_table(made), "",
            f"Score: 0 is what `{lines.blind}` earns, 1 what `{lines.reference}` earns.", "",
        ]  # fmt: skip
    with files.replacing(file) as partial:
        partial.write_text("\n".join(parts), encoding="utf-8")


def draw_returns(made: Comparison) -> Any:
    """Draw the returns of every controller, the best mean on top: a dot for a machine, the mean with its interval."""
    # the dot of a machine has the same vertical position within the row of each controller
    from matplotlib.figure import Figure as Drawing

    names = ranked(made, "total_return")
    figure = Drawing(figsize=(7.2, 0.9 + 0.42 * len(names)), layout="constrained", dpi=110)
    axes = figure.add_subplot()
    within = np.linspace(0.28, -0.28, len(made.seeds))
    for row, name in enumerate(reversed(names)):
        returns = [cut.total_return for cut in made.results[name]]
        mean = made.figures[name]["total_return"]
        axes.plot(returns, row + within, ".", color=MUTED, ms=4)
        axes.plot([mean.low, mean.high], [row, row], color=BLUE, lw=1.2)
        axes.plot([mean.value, mean.value], [row - 0.3, row + 0.3], color=BLUE, lw=2.0)
    axes.set_yticks(range(len(names)), [_short(name) for name in reversed(names)])
    axes.set_xlabel("return of a cut")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _short(name: str) -> str:
    return name if len(name) <= NAME_LETTERS else f"{name.partition(':')[0]} ..."
