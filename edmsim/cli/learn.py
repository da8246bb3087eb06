"""Commands of policies and controllers: train, dataset, evaluate."""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import OUT, RESUME, Environment, Json, interruptible, print_line
from edmsim.cli.options import Unset, takes
from edmsim.envs.registry import resolve
from edmsim.errors import InputError
from edmsim.files import check_suffix, make_writable


@takes("seed")
def train(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder for policy, checkpoint and tensorboard logs.")],
    algo: Annotated[str, typer.Option(help="ppo, recurrent-ppo, ppo-lag, sac, tqc, imitation or bandit.")] = "ppo",
    steps: Annotated[
        int | None, typer.Option(help="Total number of steps, rounded up to whole rollouts; default by environment.")
    ] = None,
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
        int | None, typer.Option(metavar="N", min=1, help="Record every N-th episode of the first sub-environment.")
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
    from edmsim.evaluation.episode import is_part
    from edmsim.learning.command import BANDIT, TrainOptions, run
    from edmsim.learning.hyperparameters import has_training

    kinds = TrainOptions(settings, residual, teacher, privileged_critic, start, record_every, live, safe)
    words = ["edmsim", "train", env_id, "--algo", algo, "--seed", str(options["seed"]), "--resume", "--out", str(out)]
    for name, value in (("--steps", steps), ("--score", score), ("--record-every", record_every)):
        words += [] if value is None else [name, str(value)]
    words += ["--live"] if live else []
    again = f"to continue: {shlex.join(words)}"
    with interruptible(lambda: again if has_training(out) else "nothing was trained"):
        tables = run(env_id, algo, out, steps, options["seed"], resume, score, kinds)
    for table in tables:
        OUT.print(table)
    policy = shlex.quote(f"policy:{out / 'policy.json'}")
    use = f"Cut with it: edmsim cut PROGRAM --controller {policy} --out DIR"
    if is_part(resolve(env_id)) or algo == BANDIT:  # a bandit's law may be too fast for the usual machine
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


@takes("resolution", resolution=Unset("Default: that of the environment; for a policy all, fast in Part and shifts."))
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
        Path | None, typer.Option(metavar="FILE", help="Table of all cuts, .jsonl; those it has are not made again.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page with a table and figures, .md.")
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Evaluate a policy in its own environment, with counts and voltage: a "
                                          "file, or a name under models/policies. Repeatable."),
    ] = None,
    write_card: Annotated[bool, typer.Option("--write-card", help="Write the scores to the policy file.")] = False,
    json: Json = False,
    **options: Any,
) -> None:
    """Compare feed controllers on the same randomised machines."""
    from edmsim.evaluation import compare, episode
    from edmsim.learning import policy_file, score
    from edmsim.numeric import listed, whole_from
    from edmsim.runs import RunTable

    resolution, named = options.get("resolution"), env_ids or []
    if write_card and not policy:
        raise InputError("--write-card writes to a policy's file: give the policy with --policy")
    if not named and not policy:
        raise InputError("name an environment, or a policy with --policy; see edmsim evaluate --help")
    of_envs = {"--controllers": controllers, "--record": record, "--leaderboard": leaderboard, "--page": page}
    if not named and (without := [flag for flag, value in of_envs.items() if value is not None]):
        raise InputError(f"{without[0]} is for environments: name one, or leave it out")
    if "all" in named and len(named) > 1:
        raise InputError("all names every environment: leave out the others, or all")
    if policy and not named and seeds is not None:
        whole_from("seeds", seeds, 2)
    chosen = {
        env_id: compare.usual(env_id) if controllers is None else listed(controllers)
        for env_id in (compare.env_ids() if named == ["all"] else map(resolve, named))
    }
    for name in policy or ():
        score.env_id_of(name)  # an unknown one is refused before the first cut
    for env_id, laws in chosen.items():
        compare.check(env_id, laws, episode.lines_of(env_id).seeds if seeds is None else seeds, resolution)
    if page is not None:
        check_suffix(page, "a page", ".md")
    if leaderboard is not None:
        check_suffix(leaderboard, "a leaderboard", ".jsonl")
    for file in (leaderboard, page):
        if file is not None:
            make_writable(file.parent)
    until_written = page or (policy_file.locate(policy[0]) if policy and write_card else None)
    journal = None if until_written is None else until_written.with_suffix(".runs.jsonl")
    runs = RunTable(journal)
    cuts = runs if leaderboard is None else RunTable(leaderboard, texts=compare.CUT_TEXTS)
    saved = leaderboard is not None or journal is not None
    found, scores = [], {}
    unsaved = "nothing was saved; --leaderboard, --page and --write-card save finished cuts"
    with interruptible(RESUME if saved else unsaved) as bar:
        for env_id, laws in chosen.items():
            watch = bar.of(env_id)
            found.append(
                compare.evaluate(env_id, laws, seeds, resolution=resolution, record=record, watch=watch, table=cuts)
            )
        for name in policy or ():
            scores[name] = score.measure(
                score.env_id_of(name), name, USUAL_EPISODES if seeds is None else seeds, bar.show,
                () if resolution is None else (resolution,), runs,
            )  # fmt: skip
            if write_card:
                score.write_card(name, scores[name])
    if page is not None:
        compare.write_page(page, found)
    if journal is not None:
        journal.unlink(missing_ok=True)
    if json:
        sys.stdout.write(compare.as_json(found, scores) + "\n")
        return
    for shown in (*(compare.render(made, OUT.width) for made in found), *map(score.render, scores.values())):
        OUT.print(shown)
