"""``edmsim train``: train a policy, export it, and score it next to classic controllers.

``edmsim evaluate --policy NAME --write-card`` measures a policy again and writes the scores into its card. A safe
training accepts its policy only if its return on other machines is not lower than that of its start.
"""

import math
import shlex
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim import numeric, runs, screen, user_code
from edmsim.envs import families, registry
from edmsim.errors import InputError, refuse_unknown, refuses_wrong_types
from edmsim.evaluation import compare, episode
from edmsim.geometry import Floats
from edmsim.learning import bandit, hyperparameters, policy_file
from edmsim.plant.resolution import RESOLUTIONS

RIVALS = ("counts", "voltage")
"""Controllers with which policies are compared: that of 1982, and the classic servo on the mean voltage."""
FIRST_SEED = episode.HELD_BACK - 100_000
"""First seed of the machines that test a policy: comparisons use others, since their seeds must not choose a policy;
training, which draws its seeds from 32 bits, meets one only by chance."""
LEAST_MACHINES = 4
"""Least number of machines (ours: with three, Student's interval is 4.3 standard errors on either side)."""
MOST_LOSS_SHARE = 0.02
"""How far below zero the difference's interval may reach, as a share of the start's return (ours: a policy compared
with itself must pass; one whose loss is unknown must not)."""


def measured_with(env_id: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return rivals and resolutions of an environment; parts and shifts take long, so only those of the training."""
    if episode.is_part(env_id):
        return ("technology", "corrected"), ("fast",)
    if issubclass(registry.find(env_id)[0], families.Shift):
        return ("adaptive-hold",), ("fast",)
    return RIVALS, tuple(RESOLUTIONS)


class Score(NamedTuple):
    """Means and counts over episodes."""

    controller: str
    resolution: str
    seeds: int
    # mean_return, return_error: mean return, and its standard error
    mean_return: float
    return_error: float
    rate_mm2_min: float  # area cut over machine time, with the threading after every lost wire
    # path error (see `edmsim.evaluation.episode.Result`); for parts the edge error; None for straight cuts
    error_um: float | None
    time_s: float  # mean machine time of an episode
    # breaks, limits: number of episodes that ended by a wire break, or by another limit such as a persistent short
    breaks: int
    limits: int


@refuses_wrong_types
def measure(
    env_id: str, policy: str, episodes: int, watch: Callable[[str, int, int], None] | None = None,
    resolutions: Sequence[str] = (), table: runs.RunTable | None = None,
) -> list[Score]:
    """Return the scores of a policy and its rivals, resolution by resolution.

    Parameters
    ----------
    env_id : str
    policy : str
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.
    episodes : int
        Number of episodes, 2 or more.
    watch : callable, optional
        Called with a resolution, and its number of finished and of all episodes.
    resolutions : sequence of {"fast", "default", "fine"}
        By default all; for parts and shifts only "fast".
    table : edmsim.runs.RunTable, optional
        Finished cuts; see `edmsim.evaluation.compare.evaluate`.

    Raises
    ------
    InputError
        If `episodes` is below 2.
    """
    numeric.whole_from("episodes", episodes, 2)  # a standard error needs two
    scores = []
    rivals, usual = measured_with(env_id)
    controllers = [f"policy:{user_code.policy_of(policy)}", *rivals]
    for resolution in resolutions or usual:
        made_so_far = None if watch is None else partial(watch, f"{policy}, {resolution}")
        results = compare.run(env_id, controllers, episodes, resolution, made_so_far, table=table)
        scores += [score(made, resolution) for made in results.values()]
    return [row._replace(controller="policy") if row.controller.startswith("policy:") else row for row in scores]


def score(results: Sequence[episode.Result], resolution: str) -> Score:
    """Return the score of a controller's cuts."""
    returns = np.array([result.total_return for result in results])
    known = [(r.error_um if np.isfinite(r.error_um) else r.edge_error_um) for r in results]
    errors = [error for error in known if np.isfinite(error)]
    seconds = sum(result.time_s for result in results)
    # the rate of a cut counts the threading after a wire lost at its end, its machine time does not
    net_s = sum(60.0 * r.area_mm2 / r.rate_mm2_min if r.rate_mm2_min else r.time_s for r in results)
    return Score(
        results[0].controller, resolution, len(results), float(returns.mean()),
        float(returns.std(ddof=1) / np.sqrt(len(results))), 60.0 * sum(r.area_mm2 for r in results) / net_s,
        float(np.mean(errors)) if errors else None, seconds / len(results), sum(r.broke for r in results),
        sum(r.jammed for r in results),
    )


def write_card(policy: str, scores: Sequence[Score], env_id: str | None = None) -> None:
    """Write scores of `measure` into a policy's card, in place of those at the same resolutions.

    `env_id` is the environment of the scores, by default the policy's; scores of other environments stay in the card.
    """
    card = _card(policy)
    elsewhere = {} if env_id is None or registry.find(env_id) == registry.find(card.env_id) else {"env_id": env_id}
    measured = {(row.resolution, elsewhere.get("env_id")) for row in scores}
    others = [row for row in card.scores if (row["resolution"], row.get("env_id")) not in measured]
    card = card.model_copy(update={"scores": [*others, *(row._asdict() | elsewhere for row in scores)]})
    file = policy_file.locate(policy)
    if isinstance(card, bandit.BanditCard):
        bandit.write(card, file)
    else:
        policy_file.write(card, file.with_suffix(".npz").read_bytes(), file)


def _card(policy: str) -> policy_file.Card | bandit.BanditCard:
    file = bandit.find(policy)
    return policy_file.load(policy).card if file is None else bandit.load(file)


def env_id_of(policy: str) -> str:
    """Return the environment of a policy's training."""
    return _card(policy).env_id


def render(policy: str, env_id: str, scores: list[Score]) -> screen.ScreenTable:
    """Return the scores of a policy in an environment as a table."""
    numbers = ("return", "mm2/min", "error, um", "breaks", "jams")
    title = f"{policy} in {env_id}; mean return ± its standard error"
    table = screen.ScreenTable("controller", "resolution", numbers=numbers, keys=2, title=title)
    for row in scores:
        error = "" if row.error_um is None else f"{row.error_um:.2f}"
        table.add_row(
            row.controller, row.resolution, f"{row.mean_return:.1f} ± {row.return_error:.1f}",
            f"{row.rate_mm2_min:.2f}", error, f"{row.breaks} of {row.seeds}", f"{row.limits} of {row.seeds}",
        )
    return table


class Verdict(NamedTuple):
    """Comparison of a policy with its start on the same machines."""

    # start, difference: mean return of the start, and of the paired differences, with their 95 % intervals
    start: compare.Figure
    difference: compare.Figure
    machines: int

    @property
    def accepted(self) -> bool:
        """Whether the lower end of the interval is within the allowed loss."""
        return bool(self.difference.low >= -MOST_LOSS_SHARE * abs(self.start.value))

    def words(self) -> str:
        """Return the verdict as a line of text."""
        value, low, high = self.difference.value, self.difference.low, self.difference.high
        how = "accepted" if self.accepted else "refused"
        return (f"{how}: on {self.machines} other machines its return differs by {value:+.4g} ({low:+.4g} to "
                f"{high:+.4g}) from its start's {self.start.value:.4g}")  # fmt: skip


def check_safe(machines: int, start: str | None) -> None:
    """Raise `InputError` before the training if there are too few machines, or no start."""
    if machines < LEAST_MACHINES:
        raise InputError(f"{machines} machines are too few to accept a policy: give {LEAST_MACHINES} or more")
    if start is None:
        raise InputError("--safe compares with what the training starts from: give --start policy:NAME")


def verdict(returns: Sequence[float], start_returns: Sequence[float]) -> Verdict:
    """Compare the returns of a policy and of its start, machine by machine."""
    new, old = np.array(returns, float), np.array(start_returns, float)
    return Verdict(compare.mean(old), compare.mean(new - old), len(new))


def accept(
    env_id: str, trained: Path, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Compare a trained policy with its start; if accepted, it becomes ``policy.json`` of its folder.

    Otherwise it becomes ``refused.json``, and the start ``policy.json``. The start is a file or a name. `watch` is
    called with a name, finished cuts and all.
    """
    both = f"policy:{trained}", f"policy:{user_code.policy_of(start)}"
    jobs = [(name, FIRST_SEED + k) for k in range(machines) for name in both]
    engine = episode.engine_of(env_id, len(jobs))
    results = runs.perform(partial(episode.cut_job, env_id), jobs, watch and partial(watch, "accept"), engine=engine)
    returns = [result.total_return for result in results]
    found = verdict(returns[::2], returns[1::2])
    file, refused = trained.with_name("policy.json"), trained.with_name("refused.json")
    first = policy_file.locate(start)
    for ending in (".json", ".npz"):
        trained.with_suffix(ending).replace((file if found.accepted else refused).with_suffix(ending))
        if found.accepted:
            refused.with_suffix(ending).unlink(missing_ok=True)
        else:
            shutil.copy(first.with_suffix(ending), file.with_suffix(ending))
    return found


# The whole command.

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
        chosen = {**self._asdict(), "settings": None if self.settings is None else str(self.settings)}
        return {name: value for name, value in chosen.items() if name not in ("record_every", "live")}

    def words(self) -> str:
        """Return the command-line options that change the result."""
        words: list[str] = []
        for name, value in self.of_result().items():
            if value is not None and value is not False:
                words += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
        return "".join(f" {shlex.quote(word)}" for word in words)

    def parameters(self, env_id: str, algo: str) -> hyperparameters.Hyperparameters:
        """Return the hyperparameters; a start sets the network's shape and the noise, unless the settings do."""
        parameters = hyperparameters.load(env_id, algo, self.settings)
        more: dict[str, Any] = {}
        policy = self.policy()
        if policy is not None:
            chosen, usual = parameters.network, hyperparameters.load(env_id, algo).network
            names = ("widths", "activation", *(("lstm",) if chosen.lstm and policy.card.lstm else ()))
            shape = {n: getattr(policy.card, n) for n in names if getattr(chosen, n) == getattr(usual, n)}
            if chosen.log_std_init is None:
                shape["log_std_init"] = hyperparameters.LOG_STD_AFTER_START
            more["network"] = chosen.model_copy(update=shape)
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


def train_and_score(
    env_id: str, algo: str, out: Path, steps: int | None, seed: int, resume: bool, episodes: int,
    options: TrainOptions = TrainOptions(),  # noqa: B008 - it cannot be changed
) -> list[screen.ScreenTable]:
    """Train a policy, write its files to `out`, and return tables: settings of a bandit, scores over `episodes`."""
    if episodes < 0 or episodes == 1:
        raise InputError(f"{episodes} episodes give no mean with an error: give 2 or more, or 0 for none")
    refuse_unknown("algorithm", algo, (*hyperparameters.ALGORITHMS, BANDIT))
    file = out / "policy.json"
    if not resume:
        hyperparameters.refuse_training(out)
        if file.exists():  # it may be the start, which --safe compares with
            raise InputError("this folder has a policy, which the training would replace: give another folder", out)
    if algo == BANDIT:
        return _bandit(env_id, file, steps, seed, resume, episodes, options)
    from edmsim.learning.train import TrainingProgress, train  # raises `InputError` if the extra is missing

    if options.safe is not None:
        check_safe(options.safe, options.start)
    if resume and options.words():
        raise InputError(f"--resume uses the options with which the training began: leave out{options.words()}")
    named = registry.resolve(env_id)
    parameters = None if resume else options.parameters(named, algo)
    if parameters is not None:
        hyperparameters.steps_of(parameters, algo, steps)
    with screen.ShownProgress(keep=True) as bar:

        def watch(now: TrainingProgress) -> None:
            shown_return = "" if math.isnan(now.mean_return) else f"return {now.mean_return:.1f}"
            bar.show("train", min(now.steps, now.total), now.total, shown_return)

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
            found = accept(done.env_id, written, options.start, options.safe, bar.show)
            bar.show("accept", 1, 1, found.words())
        return _scored(done.env_id, file, episodes, bar)


def _bandit(
    env_id: str, file: Path, steps: int | None, seed: int, resume: bool, episodes: int, options: TrainOptions
) -> list[screen.ScreenTable]:
    """Train a bandit in the folder of its file, and score it."""
    if others := options._replace(settings=None).words():
        raise InputError(f"a bandit chooses settings of a law: leave out{others}")
    if options.record_every is not None or options.live:
        raise InputError("a bandit learns from shifts of single machines, which are not recorded: leave out "
                         "--record-every and --live")  # fmt: skip
    if resume and options.settings is not None:
        raise InputError(f"--resume uses the options with which the training began: leave out{options.words()}")
    named = registry.resolve(env_id)
    settings = None if resume else bandit.settings_of(named, options.settings)
    with screen.ShownProgress(keep=True) as bar:

        def watch(machines: int, total: int) -> None:
            bar.show("train", machines, total, f"{machines} of {total} machines recorded")

        card = bandit.train(
            named, file.parent, steps=steps, seed=seed, resume=resume, settings=settings, watch=watch,
            command=f"edmsim train {env_id} --algo {BANDIT}", options=options.words(),
        )  # fmt: skip
        bandit.write(card, file)
        return [bandit.described(card), *_scored(named, file, episodes, bar)]


def _scored(env_id: str, file: Path, episodes: int, bar: screen.ShownProgress) -> list[screen.ScreenTable]:
    """Measure a policy, and write its scores into its card."""
    if not episodes:
        return []
    journal = file.with_name("score.runs.jsonl")  # of the cuts of an interrupted scoring
    scores = measure(env_id, str(file), episodes, bar.show, table=runs.RunTable(journal))
    write_card(str(file), scores, env_id)
    journal.unlink(missing_ok=True)
    return [render(str(file), env_id, scores)]


def _recorders(options: TrainOptions, out: Path) -> list[Any]:
    """Return the callback that records episodes of the first sub-environment, if the options request it."""
    if options.record_every is None and not options.live:
        return []
    from edmsim.envs.sb3 import RecordEpisodes

    every = {} if options.record_every is None else {"every": options.record_every}
    return [RecordEpisodes(out / "episodes", **every, live=options.live)]


AT_ENDS = 10
"""Divisor of a curve's points: medians of its first and last tenth are its ends (ours: single points are noise)."""
RISEN = 0.2  # above this share of the whole rise a curve has begun to rise (ours)
LEAST_RISE = 3.0  # least rise that counts, as a multiple of the lesser scatter of the first and last part (ours)


def _scatter(at: Floats, values: Floats) -> float:
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
