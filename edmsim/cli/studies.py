"""Commands that measure the model: calibrate, validate, bench; and warm-up."""

from __future__ import annotations

import json as codec
import math
import shlex
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import OUT, Json, interruptible, print_line, say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.errors import FAILED, InputError
from edmsim.files import check_suffix, make_writable

if TYPE_CHECKING:
    from rich.console import RenderableType

    _Result = tuple[Mapping[str, object], RenderableType]
    """In numbers, and as a table."""

_BY_LOG = Unset("Default: as in the log.")


@takes(
    "machine", SET_UP, "resolution", "seed",
    **dict.fromkeys(("machine", "material", "wire", "generator", "height_mm"), _BY_LOG),
    resolution=Unset("Default: as in the log, or fast."),
)
def calibrate(
    log: Annotated[Path, typer.Argument(help="Table of windows, .parquet or CSV.", show_default=False)],
    out: Annotated[Path, typer.Option(help="TOML file for the machine; material and wire go to the same folder.")],
    fit: Annotated[
        str | None, typer.Option(metavar="A,B", help="Constants or sections to fit; default: the usual three.")
    ] = None,
    json: Json = False,
    **options: Any,
) -> None:
    """Fit the model's constants to a machine's log."""
    from edmsim import calibration
    from edmsim.calibration import comparison, output
    from edmsim.calibration import fit as fitting
    from edmsim.job.settings import CutSettings
    from edmsim.numeric import listed
    from edmsim.runs import RunTable

    check_suffix(out, "the fitted machine", ".toml")
    make_writable(out.parent)
    table = calibration.read_log(log)
    seed = options.pop("seed")
    settings, notices = calibration.settings_for(table, **options)
    chosen = calibration.DEFAULT_CONSTANTS if fit is None else listed(fit)
    runs = out.with_suffix(".runs.jsonl")
    set_up = fitting.machine_of(settings)
    for notice in (*notices, *fitting.held(settings, set_up, chosen)):
        say(notice)
    with interruptible() as bar:

        def watch(progress: comparison.CalibrationProgress) -> None:
            misfit = "" if math.isnan(progress.misfit) else f", misfit {progress.misfit:.2f}"
            bar.show("calibrate", text=f"{progress.cuts} cuts simulated{misfit}")

        found = calibration.calibrate(
            table, set_up, chosen, seed=seed, resolution=settings.resolution, table=RunTable(runs), watch=watch
        )
    files = output.write(found, table.name, out, [name for name, _ in settings.overrides])
    runs.unlink(missing_ok=True)
    if json:
        sys.stdout.write(output.as_json(found, files) + "\n")
        return
    OUT.print(output.render(found, settings.resolution))
    usual, of_set_up = CutSettings(), ("material", "wire", "generator", "resolution")
    others = {name: now for name in of_set_up if (now := getattr(settings, name)) != getattr(usual, name)}
    fitted = " ".join(f"--{part} {shlex.quote(str(value))}" for part, value in {**others, **files}.items())
    print_line(f"Cut with it: edmsim cut PROGRAM {fitted} --out DIR")


def validate(
    failed: Annotated[bool, typer.Option("--failed", help="Show only rows that fail, with the reasons.")] = False,
    json: Json = False,
) -> None:
    """Compare the model with publications, row by row."""
    from edmsim.runs import Processes
    from edmsim.validation import report, run

    with interruptible("no row was shown") as bar:
        rows = run(bar.of("validate"), engine=Processes())
    if json:
        sys.stdout.write(report.as_json(rows, report.failed(rows) if failed else None) + "\n")
    else:
        OUT.print(report.render_failed(rows) if failed else report.render(rows))
    if any(row.unexpected for row in rows):
        raise typer.Exit(FAILED)


def bench(
    against: Annotated[
        str | None, typer.Option(metavar="REVISION", help="Compare with a revision of this checkout, in pairs.")
    ] = None,
    pairs: Annotated[int | None, typer.Option(min=1, help="Pairs of --against; default: 10.")] = None,
    profile: Annotated[bool, typer.Option("--profile", help="Show the time of each part of a pulse.")] = False,
    serial: Annotated[bool, typer.Option("--serial", help="Measure edmsim gap --serial.")] = False,
    training: Annotated[
        bool, typer.Option("--training", help="Measure a training with PPO, compared with HalfCheetah-v5 (extra rl).")
    ] = False,
    figure: Annotated[Path | None, typer.Option(help="Picture of the profile: .png, .svg or .pdf.")] = None,
    json: Json = False,
) -> None:
    """Measure the speed of this computer in processor time."""
    if against is None and pairs is not None:
        raise InputError("--pairs are those of a comparison: give the revision with --against")
    measurements: dict[str, Callable[[Callable[[str], None]], _Result]] = {
        **({"profile": partial(_profiled, figure)} if profile or figure is not None else {}),
        **({} if against is None else {"against": partial(_compared, against, pairs)}),
        **({"serial": _answered} if serial else {}),
        **({"training": _trained} if training else {}),
    }  # fmt: skip
    with interruptible("no measurement was completed") as bar:
        found = {
            name: measure(lambda phase: bar.show("measure", text=phase))
            for name, measure in (measurements or {"speed": _measured}).items()
        }
    if json:
        numbers = {name: numbers for name, (numbers, _) in found.items()}
        sys.stdout.write(codec.dumps(numbers if len(found) > 1 else next(iter(numbers.values())), indent=2) + "\n")
    else:
        for _, table in found.values():
            OUT.print(table)


def _measured(_: Callable[[str], None]) -> _Result:
    from edmsim.bench.figures import measure

    return _listed(measure(), "edmsim bench", lambda value: f"{value:,.0f}" if value > 1000 else f"{value:,.2f}")


def _answered(watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.serial import measure

    return _listed(measure(watch), "edmsim gap --serial", lambda value: f"{value:.3g}")


def _trained(watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.training import measure

    figures = measure(watch)
    return _listed(figures, "edmsim bench --training", lambda value: f"{value:,.0f}" if value > 1 else f"{value:.2f}")


def _listed(figures: Mapping[str, float], title: str, text: Callable[[float], str]) -> _Result:
    """Return figures with a table of them, a row each."""
    from edmsim.screen import ScreenTable

    table = ScreenTable("figure", numbers=("value",), title=title)
    for name, value in figures.items():
        table.add_row(name, text(value))
    return figures, table


def _compared(revision: str, count: int | None, watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.pairs import PAIRS, as_numbers, compare, render

    found = compare(revision, PAIRS if count is None else count, watch)
    return as_numbers(found), render(found)


def _profiled(figure: Path | None, watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.profile import as_numbers, draw, profile, render
    from edmsim.recording.figures.style import check_figure, write_figure

    if figure is not None:
        check_figure(figure)
        make_writable(figure.parent)
    found = profile(watch)
    if figure is not None:
        write_figure(draw(found), figure)
    return as_numbers(found), render(found)


_LINE = "G0 X0 Y0\nG1 X0.5\nM2\n"


def warm_up() -> None:
    """Compile beforehand what cuts and environments would wait for."""
    from edmsim.plant.kernel.memory import window_function
    from edmsim.plant.plant import shapes
    from edmsim.runs import perform

    total = len(shapes()) + 1
    with interruptible("what is compiled is kept") as bar:
        bar.show("compile", 0, total)
        perform(lambda shape: window_function(*shape), shapes(), lambda done, _: bar.show("compile", done, total))
        _use_once()
        bar.show("compile", total, total)
    OUT.print("All code of cuts and environments is compiled, for all resolutions.")


def _use_once() -> None:
    """Make a cut and a step of an environment: planners, observations and rewards are compiled with their types."""
    import tempfile

    import gymnasium as gym

    import edmsim
    import edmsim.envs

    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "line.ngc"
        program.write_text(_LINE, encoding="ascii")
        edmsim.cut(program, offset="none", resolution="fast", max_time_s=0.1)
    env = gym.make("edmsim/GapFeed-v2", resolution="fast")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
