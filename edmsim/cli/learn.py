"""``edmsim train`` and ``dataset``: policies, and what they may be learned from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, say
from edmsim.cli.options import takes


@takes("seed")
def train(
    env_id: Annotated[
        str, typer.Argument(help="Environment: edmsim/GapFeed-v2 ..., or FILE.py:ID.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for policy, checkpoint and tensorboard logs.")],
    algo: Annotated[str, typer.Option(help="ppo, recurrent-ppo, ppo-lag, sac, tqc or imitation.")] = "ppo",
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
    """Train a policy (extra rl)."""
    from edmsim.envs.registry import resolve
    from edmsim.evaluation.parts import is_part
    from edmsim.learning.command import TrainOptions, run

    kinds = TrainOptions(settings, residual, teacher, privileged_critic, start, record_every, live, safe)
    try:
        table = run(env_id, algo, out, steps, options["seed"], resume, score, kinds)
    except KeyboardInterrupt:
        say("interrupted; run the same command with --resume to continue")
        raise typer.Exit(INTERRUPTED) from None
    if table is not None:
        OUT.print(table)
    policy = f"policy:{out / 'policy.json'}"
    use = f"Cut with it: edmsim cut PROGRAM --controller {policy} --out DIR"
    if is_part(resolve(env_id)):
        use = f"Compare it: edmsim evaluate {env_id} --controllers {policy}"
    OUT.print(use, highlight=False, soft_wrap=True, markup=False)


@takes("seed")
def dataset(
    env_id: Annotated[
        str, typer.Argument(help="Environment: edmsim/GapFeed-v2 ..., or FILE.py:ID.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for the data sets; an interrupted recording is resumed.")],
    controllers: Annotated[
        str, typer.Option(metavar="A,B", help="Feed controllers: {controllers}.")
    ] = "fixed,counts,voltage",
    steps: Annotated[int, typer.Option(help="Windows per controller, rounded up to whole episodes.")] = 100_000,
    **options: Any,
) -> None:
    """Record controllers as data sets of Minari (extra offline)."""
    from edmsim.controllers.named_numbers import listed
    from edmsim.envs.registry import resolve
    from edmsim.learning.dataset import record
    from edmsim.progress import ShownProgress

    with ShownProgress() as bar:
        try:
            made = record(resolve(env_id), listed(controllers), steps, out, watch=bar.show, **options)
        except KeyboardInterrupt:
            say("interrupted; run the same command to continue")
            raise typer.Exit(INTERRUPTED) from None
    for row in made:
        OUT.print(f"{row.dataset_id}: {row.episodes} episodes, {row.steps} steps, {row.breaks} with a broken wire, "
                  f"mean return {row.mean_return:.1f}", highlight=False, soft_wrap=True, markup=False)
    OUT.print(f"Load them: MINARI_DATASETS_PATH={out} python -c 'import minari; "
              f"print(minari.load_dataset(\"{made[0].dataset_id}\"))'", highlight=False, soft_wrap=True, markup=False)
