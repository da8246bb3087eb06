"""``edmsim train``: train, export, and compare with classic controllers."""

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.registry import resolve
from edmsim.errors import InputError, refuse_unknown
from edmsim.learning import bandit, hyperparameters, policy_file, score
from edmsim.learning.hyperparameters import ALGORITHMS, Hyperparameters
from edmsim.runs import RunTable
from edmsim.screen import ScreenTable, ShownProgress

BANDIT = "bandit"
"""The algorithm that has no learner of stable-baselines3: see `edmsim.learning.bandit`."""


class TrainOptions(NamedTuple):
    """Options of a training, except the algorithm."""

    settings: Path | None = None  # file of hyperparameters that differ (see `edmsim.learning.hyperparameters.load`)
    residual: str | None = None  # law that the policy adds to
    teacher: str | None = None  # controller that imitation follows
    privileged_critic: bool = False
    start: str | None = None  # policy with which the training begins, as ``policy:NAME`` or a file of it
    # one in `record_every` of the first sub-environment's episodes is recorded into the folder ``episodes``
    record_every: int | None = None
    live: bool = False  # whether these are shown in rerun's viewer as they end
    safe: int | None = None  # number of machines on which the policy's return is compared with the start's

    def policy(self) -> policy_file.Policy | None:
        """Return the policy that the training starts from."""
        return None if self.start is None else policy_file.load(self.start)

    def of_result(self) -> dict[str, Any]:
        """Return the options that change the result, for JSON; a resumed training restores them."""
        settings = None if self.settings is None else str(self.settings)
        return {
            "settings": settings, "residual": self.residual, "teacher": self.teacher,
            "privileged_critic": self.privileged_critic, "start": self.start, "safe": self.safe,
        }  # fmt: skip

    def words(self) -> str:
        """Return the command-line options that change the result."""
        words: list[str] = []
        for name, value in self.of_result().items():
            if value is not None and value is not False:
                words += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
        return "".join(f" {shlex.quote(word)}" for word in words)

    def hyperparameters(self, env_id: str, algo: str) -> Hyperparameters:
        """Return the hyperparameters; the network is the starting policy's, unless the settings have one."""
        parameters = hyperparameters.load(env_id, algo, self.settings)
        more: dict[str, Any] = {}
        policy = self.policy()
        if policy is not None and parameters.network == hyperparameters.load(env_id, algo).network:
            card = policy.card
            shape: dict[str, Any] = {"widths": card.widths, "activation": card.activation}
            shape |= {"lstm": card.lstm} if parameters.network.lstm and card.lstm else {}
            more["network"] = parameters.network.model_copy(update=shape)
        if self.residual is not None:
            adds: dict[str, Any] = {"action": "speed", "decision_s": None}
            if other := [name for name in adds if parameters.environment.get(name, adds[name]) != adds[name]]:
                reason = f"--residual adds to a speed in every window: leave environment.{other[0]} out"
                raise InputError(reason, self.settings)
            more |= {"residual": self.residual, "environment": {**parameters.environment, **adds}}
        if self.teacher is not None:
            more["teacher"] = self.teacher
        if self.privileged_critic:
            more["privileged_critic"] = True
        return parameters.model_copy(update=more)


def run(
    env_id: str, algo: str, out: Path, steps: int | None, seed: int, resume: bool, episodes: int,
    options: TrainOptions = TrainOptions(),  # noqa: B008 - it cannot be changed
) -> list[ScreenTable]:
    """Train a policy, write its files to `out`, and return tables: settings of a bandit, scores over `episodes`."""
    if episodes < 0 or episodes == 1:
        raise InputError(f"{episodes} episodes give no mean with an error: give 2 or more, or 0 for none")
    refuse_unknown("algorithm", algo, (*ALGORITHMS, BANDIT))
    file = out / "policy.json"
    if not resume:
        hyperparameters.refuse_training(out)
        if file.exists():  # it may be the start, which --safe compares with
            raise InputError("this folder has a policy, which the training would replace: give another folder", out)
    if algo == BANDIT:
        return _bandit(env_id, file, steps, seed, resume, episodes, options)
    from edmsim.learning.train import TrainingProgress, train  # raises `InputError` if the extra is missing

    if options.safe is not None:
        score.check_safe(options.safe, options.start)
    if resume and options.words():
        raise InputError(f"--resume uses the options with which the training began: leave out{options.words()}")
    named = resolve(env_id)
    parameters = None if resume else options.hyperparameters(named, algo)
    if parameters is not None:
        hyperparameters.steps_of(parameters, algo, steps)
    with ShownProgress(keep=True) as bar:

        def watch(progress: TrainingProgress) -> None:
            shown_return = "" if math.isnan(progress.mean_return) else f"return {progress.mean_return:.1f}"
            bar.show("train", min(progress.steps, progress.total), progress.total, shown_return)

        trained = train(
            named, algo, out, steps=steps, seed=seed, resume=resume, watch=watch, parameters=parameters,
            callbacks=_recorders(options, out), begin_from=options.policy(), options=options.of_result(),
        )
        done = trained.run
        options = options._replace(**done.options)
        words = f"{done.env_id if named == env_id else env_id} --algo {algo} --steps {done.steps} --seed {seed}"
        card, packed = trained.export(f"edmsim train {words}{options.words()}")
        # an interrupted comparison must not leave a policy that was not accepted
        written = file if options.safe is None else file.with_name("candidate.json")
        policy_file.write(card, packed, written)
        curve = in_words(*np.array(trained.curve).reshape(-1, 2).T.tolist())
        made = trained.model.num_timesteps  # whole rollouts
        bar.show("train", made, made, f"{made:,} steps, return {curve}")
        if options.safe is not None and options.start is not None:
            verdict = score.accept(done.env_id, written, options.start, options.safe, bar.show)
            bar.show("accept", 1, 1, verdict.words())
        return _scored(done.env_id, file, episodes, bar)


def _bandit(
    env_id: str, file: Path, steps: int | None, seed: int, resume: bool, episodes: int, options: TrainOptions
) -> list[ScreenTable]:
    """Train a bandit in the folder of its file, and score it."""
    if others := options._replace(settings=None).words():
        raise InputError(f"a bandit chooses settings of a law: leave out{others}")
    if options.record_every is not None or options.live:
        raise InputError("a bandit learns from shifts of single machines, which are not recorded: leave out "
                         "--record-every and --live")  # fmt: skip
    if resume and options.settings is not None:
        raise InputError(f"--resume uses the options with which the training began: leave out{options.words()}")
    named = resolve(env_id)
    settings = None if resume else bandit.settings_of(named, options.settings)
    with ShownProgress(keep=True) as bar:

        def watch(machines: int, total: int) -> None:
            bar.show("train", machines, total, f"{machines} of {total} machines recorded")

        card = bandit.train(
            named, file.parent, steps=steps, seed=seed, resume=resume, settings=settings, watch=watch,
            command=f"edmsim train {env_id} --algo {BANDIT}", options=options.words(),
        )  # fmt: skip
        bandit.write(card, file)
        return [bandit.described(card), *_scored(named, file, episodes, bar)]


def _scored(env_id: str, file: Path, episodes: int, bar: ShownProgress) -> list[ScreenTable]:
    """Measure a policy, and write its scores into its card."""
    if not episodes:
        return []
    runs = file.with_name("score.runs.jsonl")  # of the cuts of an interrupted scoring
    scores = score.measure(env_id, str(file), episodes, bar.show, table=RunTable(runs))
    score.write_card(str(file), scores, env_id)
    runs.unlink(missing_ok=True)
    return [score.render(str(file), env_id, scores)]


def _recorders(options: TrainOptions, out: Path) -> list[Any]:
    """Return the callback that records episodes of the first sub-environment, if the options request it."""
    if options.record_every is None and not options.live:
        return []
    from edmsim.envs.episode import EVERY
    from edmsim.envs.sb3 import RecordEpisodes

    every = EVERY if options.record_every is None else options.record_every
    return [RecordEpisodes(out / "episodes", every, options.live)]


AT_ENDS = 10
"""Divisor of a curve's points: medians of its first and last tenth are its ends (ours: single points are noise)."""
RISEN = 0.2  # above this share of the whole rise a curve has begun to rise (ours)
LEAST_RISE = 3.0  # least rise that counts, as a multiple of the lesser scatter of the first and last part (ours)


def _scatter(at: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return the range of the values about their linear trend; in a steep rise it is greater than the noise."""
    if len(values) < 2:
        return 0.0
    return float(np.ptp(values - np.polynomial.Polynomial.fit(at, values, 1)(at)))


def in_words(steps: Sequence[int], returns: Sequence[float]) -> str:
    """Return in words when a learning curve rises: mean returns (NaN before an episode ends) over steps or decisions.

    >>> in_words([1_000, 2_000, 3_000, 4_000, 5_000], [0.0, 1.0, 0.0, 60.0, 100.0])
    'flat until about 3,000 steps, then rising from 0 to 100'
    >>> in_words([1_000, 2_000, 3_000], [5.0, 5.0, 4.0])
    'no rise above the scatter in 3,000 steps: from 5 to 4'
    """
    known = [(step, value) for step, value in zip(steps, returns, strict=True) if not math.isnan(value)]
    if not known:
        return "unknown, as no episode has ended: give more --steps"
    at, values = (np.array(column, float) for column in zip(*known, strict=True))
    part = max(len(values) // AT_ENDS, 1)
    begin, end = float(np.median(values[:part])), float(np.median(values[-part:]))
    scatter = min(_scatter(at[:part], values[:part]), _scatter(at[-part:], values[-part:]))
    if end - begin <= LEAST_RISE * scatter or end <= begin:
        return f"no rise above the scatter in {at[-1]:,.0f} steps: from {begin:.0f} to {end:.0f}"
    below = np.flatnonzero(values < begin + RISEN * (end - begin))
    last = int(below[-1]) if len(below) else 0
    if last < part:
        return f"rising from the beginning, from {begin:.0f} to {end:.0f}"
    digits = -max(int(math.log10(max(at[last], 1.0))) - 1, 0)
    return f"flat until about {round(at[last], digits):,.0f} steps, then rising from {begin:.0f} to {end:.0f}"
