"""``edmsim evaluate`` and ``search-gains``: comparing feed controllers, and looking for their gains."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import ERR, OUT, Json
from edmsim.cli.options import Unset, takes
from edmsim.errors import InputError

if TYPE_CHECKING:
    from rich.progress import TaskID


@takes("resolution", resolution=Unset("By default that of the environment."))
def evaluate(
    env_ids: Annotated[
        list[str],
        typer.Argument(metavar="ENV_ID...", help="Environments: edmsim/GapFeed-v2 ..., FILE.py:ID, or all."),
    ],
    controllers: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Feed controllers: {controllers}; by default the task's own."),
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Cuts of each controller; default by environment.")] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for a recording of every cut, for edmsim view.")
    ] = None,
    leaderboard: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write every cut into this leaderboard, .json.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page with table and figure, .md.")
    ] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer", help="Compare at finer resolutions and beyond the ranges instead.")
    ] = False,
    json: Json = False,
    **options: Any,
) -> None:
    """Compare feed controllers on the same randomised machines."""
    from edmsim.controllers.named_numbers import listed
    from edmsim.envs.registry import resolve
    from edmsim.evaluation import leaderboard as boards
    from edmsim.evaluation import page as pages
    from edmsim.evaluation.compare import check, evaluate, usual
    from edmsim.evaluation.compare import env_ids as all_ids
    from edmsim.evaluation.episode import episodes
    from edmsim.evaluation.table import as_json, render
    from edmsim.files import make_writable
    from edmsim.screen import ScreenProgress

    resolution = options.get("resolution")
    chosen = {
        env_id: usual(env_id) if controllers is None else listed(controllers)
        for env_id in (all_ids() if env_ids == ["all"] else map(resolve, env_ids))
    }
    for env_id, named in chosen.items():
        check(env_id, named, episodes(env_id) if seeds is None else seeds, resolution)
    if transfer:
        if leaderboard or record or page or json or resolution:
            raise InputError("--transfer takes an environment, --controllers and --seeds only")
        _move(chosen, seeds)
        return
    if page is not None:
        if page.suffix != ".md":
            raise InputError("a page is Markdown: name it .md", page)
        make_writable(page.parent)
    if leaderboard is not None:
        boards.read(leaderboard)  # an invalid file is refused before hours of cuts
    found = []
    with ScreenProgress(console=ERR, transient=True) as bar:
        for env_id, named in chosen.items():
            task = bar.add_task(env_id, total=None)

            def watch(done: int, total: int, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            found.append(evaluate(env_id, named, seeds, resolution=resolution, record=record, watch=watch))
            if leaderboard is not None:
                boards.write(leaderboard, found[-1:])
    if page is not None:
        pages.write(page, found)
    if json:
        sys.stdout.write(as_json(found) + "\n")
    else:
        for comparison in found:
            OUT.print(render(comparison, OUT.width))


def _move(chosen: dict[str, list[str]], seeds: int | None) -> None:
    """Show what controllers are worth elsewhere."""
    from edmsim.evaluation.transfer import USUAL_CUTS, render, transfer
    from edmsim.screen import ScreenProgress

    cuts = USUAL_CUTS if seeds is None else seeds
    for env_id, named in chosen.items():
        with ScreenProgress(console=ERR, transient=True) as bar:
            task = bar.add_task(env_id, total=None)

            def watch(done: int, total: int, bar: ScreenProgress = bar, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            moved = transfer(env_id, named, cuts, watch=watch)
        OUT.print(render(env_id, moved, cuts))


def search_gains(
    name: Annotated[
        list[str], typer.Argument(metavar="NAME...", help="Feed controllers, as those with a file in models/gains.")
    ],
    seed: Annotated[int, typer.Option(help="First training seed, and seed of the search.")] = 0,
    generations: Annotated[int | None, typer.Option(help="Generations after the first; 4 by default.")] = None,
    write: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the files of gains.")] = None,
) -> None:
    """Search the gains of feed controllers."""
    from edmsim.evaluation.search import GENERATIONS, POPULATION, as_toml, check, search
    from edmsim.screen import ScreenProgress

    if write is not None and not write.is_dir():
        raise InputError("there is no such folder", write)
    rounds = GENERATIONS if generations is None else generations
    for controller in name:
        check(controller, seed, rounds)
    with ScreenProgress(console=ERR, transient=True) as bar:
        for controller in name:
            task = bar.add_task(controller, total=POPULATION * (rounds + 1))

            def watch(tried: int, task: TaskID = task) -> None:
                bar.update(task, completed=tried)

            found = search(controller, seed, generations=rounds, watch=watch)
            gains = ", ".join(f"{key} {value:g}" for key, value in found.gains.items())
            message = f"{controller}: {gains}; score {found.score:.4g} (before {found.default_score:.4g})"
            OUT.print(message, highlight=False, soft_wrap=True)
            if write is not None:
                (write / f"{controller}.toml").write_text(as_toml(controller, seed, rounds, found), encoding="utf-8")
