"""What ``edmsim train`` does: train, export, measure against classic controllers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from edmsim.envs.registry import resolve
from edmsim.errors import InputError
from edmsim.learning import policy_file
from edmsim.learning.score import RESOLUTIONS, RIVALS, measure, render

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from edmsim.learning.train import TrainingProgress

def run(
    env_id: str, algo: str, out: Path, steps: int | None, seed: int, resume: bool, episodes: int, console: Console
) -> Table | None:
    """Train a policy, write it as ``policy.json`` and ``policy.npz`` into the folder, and measure it.

    Parameters
    ----------
    env_id, algo, out, steps, seed, resume
        See `train.train`.
    episodes : int
        Held-back episodes at every resolution, 2 or more, or 0 not to measure.
    console : rich.console.Console
        For the progress bar.

    Returns
    -------
    rich.table.Table or None
        The scores; None without episodes.

    Raises
    ------
    InputError
        An argument that cannot be used, or the extra ``rl`` is not installed.
    """
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    if episodes < 0 or episodes == 1:
        raise InputError(f"{episodes} episodes give no mean with an error: give 2 or more, or 0 for none")
    from edmsim.learning.train import train  # refuses, in one line, where the extra is missing

    file = out / "policy.json"
    bar = Bar(
        TextColumn("{task.percentage:5.1f} %"), BarColumn(bar_width=24), TimeRemainingColumn(),
        TextColumn("{task.fields[told]}"), console=console,
    )
    task = bar.add_task("train", total=None, told="training")

    def watch(progress: TrainingProgress) -> None:
        bar.start()  # not before the first window: bad input shall print its one line only
        told = "" if math.isnan(progress.mean_return) else f"return {progress.mean_return:.1f}"
        bar.update(task, completed=progress.steps, total=progress.total, told=told)

    try:
        trained = train(resolve(env_id), algo, out, steps=steps, seed=seed, resume=resume, watch=watch)
        from edmsim.learning.export import export

        done = trained.run
        named = done.env_id if resolve(env_id) == env_id else env_id
        card, packed = export(trained, f"edmsim train {named} --algo {algo} --steps {done.steps} --seed {seed}")
        policy_file.write(card, packed, file)
        if not episodes:
            return None
        measuring = bar.add_task("score", total=(1 + len(RIVALS)) * len(RESOLUTIONS) * episodes, told="measuring")
        bar.start()
        scores = measure(done.env_id, str(file), episodes, lambda _done, _total: bar.advance(measuring))
    finally:
        if bar.live.is_started:
            bar.stop()
    policy_file.write(card.model_copy(update={"scores": [row._asdict() for row in scores]}), packed, file)
    return render(scores)
