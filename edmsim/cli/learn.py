"""Commands of policies and controllers: train, dataset, evaluate."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import OUT, RESUME, Environment, Json, interruptible, print_line
from edmsim.cli.options import Unset, takes
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.evaluation.transfer import TransferRow
    from edmsim.learning.score import Score
    from edmsim.runs import RunTable


@takes("seed")
def train(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder for policy, checkpoint and tensorboard logs.")],
    algo: Annotated[str, typer.Option(help="ppo, recurrent-ppo, ppo-lag, sac, tqc, imitation or bandit.")] = "ppo",
    steps: Annotated[int | None, typer.Option(help="Total number of steps; default by environment.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the folder's checkpoint.")] = False,
    score: Annotated[
        int, typer.Option(metavar="EPISODES", help="Number of held-back episodes to score the policy; 0 for none.")
    ] = 20,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hyperparameters to change, such as best.toml of edmsim tune.")
    ] = None,
    residual: Annotated[
        str | None, typer.Option(metavar="LAW", help="Let the policy correct the feed of this controller.")
    ] = None,
    teacher: Annotated[
        str | None, typer.Option(metavar="CONTROLLER", help="Controller to imitate; it may see the true gap.")
    ] = None,
    privileged_critic: Annotated[
        bool, typer.Option("--privileged-critic", help="Let the value network see gap, heat and constants.")
    ] = False,
    start: Annotated[
        str | None, typer.Option(metavar="POLICY", help="Start from this policy: policy:GapFeed-ppo, or policy:FILE.")
    ] = None,
    record_every: Annotated[
        int | None, typer.Option(metavar="N", help="Record every N-th episode of the first sub-environment.")
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Show them in rerun's viewer when they end.")] = False,
    safe: Annotated[
        int | None,
        typer.Option(
            metavar="MACHINES",
            help="Accept the policy only if it earns no less than its start on as many other machines.",
        ),
    ] = None,
    **options: Any,
) -> None:
    """Train a policy (extra rl, but for the bandit)."""
    from edmsim.envs.registry import resolve
    from edmsim.evaluation.episode import is_part
    from edmsim.learning.command import TrainOptions, run

    kinds = TrainOptions(settings, residual, teacher, privileged_critic, start, record_every, live, safe)
    with interruptible("run the same command with --resume to continue"):
        tables = run(env_id, algo, out, steps, options["seed"], resume, score, kinds)
    for table in tables:
        OUT.print(table)
    policy = f"policy:{out / 'policy.json'}"
    use = f"Cut with it: edmsim cut PROGRAM --controller {policy} --out DIR"
    if is_part(resolve(env_id)):
        use = f"Compare it: edmsim evaluate {env_id} --controllers {policy}"
    print_line(use)


@takes("seed")
def dataset(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder for the data sets; an interrupted recording is resumed.")],
    controllers: Annotated[
        str, typer.Option(metavar="A,B", help="Feed controllers: {controllers}.")
    ] = "fixed,counts,voltage",
    steps: Annotated[int, typer.Option(help="Windows per controller, rounded up to whole episodes.")] = 100_000,
    **options: Any,
) -> None:
    """Record controllers as data sets of Minari (extra offline)."""
    from edmsim.envs.registry import resolve
    from edmsim.learning.dataset import record
    from edmsim.numeric import listed

    with interruptible() as bar:
        made = record(resolve(env_id), listed(controllers), steps, out, watch=bar.show, **options)
    for row in made:
        print_line(
            f"{row.dataset_id}: {row.episodes} episodes, {row.steps} steps, {row.breaks} with a broken wire, "
            f"mean return {row.mean_return:.1f}"
        )
    print_line(
        f"Load them: MINARI_DATASETS_PATH={out} python -c 'import minari; "
        f"print(minari.load_dataset(\"{made[0].dataset_id}\"))'"
    )


USUAL_EPISODES = 20  # held-back episodes that a policy is measured on at every resolution (ours)


@takes("resolution", resolution=Unset("Default: that of the environment; for a policy all."))
def evaluate(
    env_ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ENV_ID...]", help="Environments: edmsim/GapFeed-v2 ..., FILE.py:ID, or all."),
    ] = None,
    controllers: Annotated[
        str | None, typer.Option(metavar="A,B", help="Feed controllers: {controllers}; default: those of the task.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(help="Number of cuts per controller; default by environment, 20 for a policy.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for recordings of all cuts, for edmsim view.")
    ] = None,
    leaderboard: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write all cuts to this leaderboard, .json.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page with a table and figures, .md.")
    ] = None,
    places: Annotated[
        bool, typer.Option("--places", help="Also compare at finer resolutions and outside the training ranges.")
    ] = False,
    policy: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Evaluate a policy in its own environment, with counts and voltage: a "
                                          "file, or a name under models/policies. Repeatable."),
    ] = None,
    write_card: Annotated[
        bool, typer.Option("--write-card", help="Write the scores to the policy file.")
    ] = False,
    json: Json = False,
    **options: Any,
) -> None:
    """Compare feed controllers on the same randomised machines."""
    from edmsim.envs.registry import resolve
    from edmsim.evaluation import leaderboard as boards
    from edmsim.evaluation.compare import check, evaluate, usual
    from edmsim.evaluation.compare import env_ids as all_ids
    from edmsim.evaluation.episode import episodes
    from edmsim.evaluation.table import as_json, render, write_page
    from edmsim.evaluation.transfer import USUAL_CUTS, transfer
    from edmsim.files import make_writable
    from edmsim.learning.policy_file import locate
    from edmsim.numeric import listed
    from edmsim.runs import RunTable

    resolution, named = options.get("resolution"), env_ids or []
    if not named and not policy:
        raise InputError("name an environment, or a policy with --policy; see edmsim evaluate --help")
    chosen = {
        env_id: usual(env_id) if controllers is None else listed(controllers)
        for env_id in (all_ids() if named == ["all"] else map(resolve, named))
    }
    for env_id, laws in chosen.items():
        check(env_id, laws, episodes(env_id) if seeds is None else seeds, resolution)
    if page is not None and page.suffix != ".md":
        raise InputError("a page is Markdown: name it .md", page)
    if leaderboard is not None:
        boards.read(leaderboard)  # an invalid file is refused before hours of cuts
    for file in (leaderboard, page):
        if file is not None:
            make_writable(file.parent)
    out = leaderboard or page or (locate(policy[0]) if policy and write_card else None)
    runs = None if out is None else out.with_suffix(".runs.jsonl")
    table, found, moved, scores = RunTable(runs), [], {}, {}
    then = "nothing was saved, as with --leaderboard, --page or --write-card" if runs is None else RESUME
    with interruptible(then) as bar:
        for env_id, laws in chosen.items():
            watch = bar.of(env_id)
            made = evaluate(env_id, laws, seeds, resolution=resolution, record=record, watch=watch, table=table)
            found.append(made)
            if leaderboard is not None:
                boards.write(leaderboard, [made])
            if places:
                cuts = USUAL_CUTS if seeds is None else seeds
                moved[env_id] = transfer(env_id, laws, cuts, watch=bar.of(f"{env_id}, places"), table=table)
        for name in policy or ():
            scores[name] = _measured(name, seeds, resolution, write_card, bar.show, table)
    if page is not None:
        write_page(page, found)
    if runs is not None:
        runs.unlink(missing_ok=True)
    if json:
        sys.stdout.write(as_json(found, moved, scores) + "\n")
        return
    for comparison in found:
        OUT.print(render(comparison, OUT.width))
    _show(moved, scores, seeds)


def _measured(
    policy: str, seeds: int | None, resolution: str | None, write: bool, watch: Any, table: RunTable
) -> list[Score]:
    from edmsim.learning.score import RESOLUTIONS, env_id_of, measure, write_card

    episodes = USUAL_EPISODES if seeds is None else seeds
    at = RESOLUTIONS if resolution is None else (resolution,)
    scores = measure(env_id_of(policy), policy, episodes, watch, at, table)
    if write:
        write_card(policy, scores)
    return scores


def _show(moved: dict[str, list[TransferRow]], scores: dict[str, list[Score]], seeds: int | None) -> None:
    from edmsim.evaluation import transfer
    from edmsim.learning import score

    for env_id, rows in moved.items():
        OUT.print(transfer.render(env_id, rows, transfer.USUAL_CUTS if seeds is None else seeds))
    for measured in scores.values():
        OUT.print(score.render(measured))
