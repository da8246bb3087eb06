"""``edmsim bench``: the speed of this computer, of two revisions in pairs, and of a pulse's parts."""

from __future__ import annotations

import json as codec
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmsim.cli.console import INTERRUPTED, OUT, say
from edmsim.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    _Result = tuple[Mapping[str, object], RenderableType]
    """In numbers, and as a table."""


def bench(
    against: Annotated[
        str | None, typer.Option(metavar="REVISION", help="Compare with a revision of this checkout, in pairs.")
    ] = None,
    pairs: Annotated[int, typer.Option(min=1, help="Pairs of --against.")] = 10,
    profile: Annotated[bool, typer.Option("--profile", help="Show the time of each part of a pulse.")] = False,
    serial: Annotated[bool, typer.Option("--serial", help="Measure edmsim gap --serial.")] = False,
    training: Annotated[
        bool, typer.Option("--training", help="Measure a training with PPO, compared with HalfCheetah-v5 (extra rl).")
    ] = False,
    figure: Annotated[Path | None, typer.Option(help="Picture of the profile: .png, .svg or .pdf.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Measure the speed of this computer in processor time."""
    from edmsim.progress import ShownProgress

    found: dict[str, _Result] = {}
    try:
        with ShownProgress() as bar:

            def watch(phase: str) -> None:
                bar.show("measure", text=phase)

            if profile or figure is not None:
                found["profile"] = _profiled(figure, watch)
            if against is not None:
                found["against"] = _compared(against, pairs, watch)
            if serial:
                found["serial"] = _answered(watch)
            if training:
                found["training"] = _trained(watch)
            if not found:
                found["speed"] = _measured()
    except KeyboardInterrupt:
        say("interrupted; no measurement was completed")
        raise typer.Exit(INTERRUPTED) from None
    if json:
        numbers = {name: numbers for name, (numbers, _) in found.items()}
        sys.stdout.write(codec.dumps(numbers if len(found) > 1 else next(iter(numbers.values())), indent=2) + "\n")
    else:
        for _, table in found.values():
            OUT.print(table)


def _measured() -> _Result:
    from edmsim.bench.figures import measure, render

    figures = measure()
    return figures, render(figures)


def _answered(watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.serial import measure, render

    found = measure(watch)
    return found, render(found)


def _trained(watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.training import measure, render

    found = measure(watch)
    return found, render(found)


def _compared(revision: str, count: int, watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.pairs import as_numbers, compare, render

    found = compare(revision, count, watch)
    return as_numbers(found), render(found)


def _profiled(figure: Path | None, watch: Callable[[str], None]) -> _Result:
    from edmsim.bench.profile import as_numbers, draw, profile, render
    from edmsim.files import make_writable, replacing
    from edmsim.job.result import FORMATS

    if figure is not None:
        if figure.suffix.removeprefix(".") not in FORMATS:
            raise InputError(f"a figure is written as one of {', '.join(FORMATS)}", figure)
        make_writable(figure.parent)
    found = profile(watch)
    if figure is not None:
        with replacing(figure) as partial:
            draw(found).savefig(partial, format=figure.suffix.removeprefix("."))
    return as_numbers(found), render(found)
