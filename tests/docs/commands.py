"""How the commands of the documentation are checked and run: in this process, and shorter than a reader would."""

import os
import re
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial, partialmethod
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer

from edmsim.cli import app as cli

from .pages import BIN, ROOT

CUT_S, LOG_S, EPISODE_S = 2.5, 40.0, 2.0
"""Machine time of a cut, where the page does not want less, of one whose log is fitted afterwards, and of an episode
in which controllers are compared."""
FEW_ENVS = 2  # sub-environments of a training
SHORT: dict[str, tuple[str, ...]] = {
    "cut": ("--resolution", "fast", "--quiet"), "check": (), "view": (), "report": (),
    "train": ("--steps", "64", "--score", "2"), "dataset": ("--steps", "20"),
    "evaluate": ("--seeds", "2", "--resolution", "fast"), "calibrate": ("--json",), "validate": (), "bench": (),
    "console 1982": ("--resolution", "fast"), "console servo": (), "console positioner": (),
    "measure table": ("--runs", "2"), "measure guides": ("--height", "3", "--quiet"),
    "sweep run": ("--processes", "1"), "sweep show": (), "tune controller": ("--trials", "1", "--seeds", "1"),
    "tune technology": (), "tune drive": (), "gap": (),
}  # fmt: skip
"""What is added to a command so that it is short; `replaced` says what of its work is left away."""


@cache
def _commands() -> Any:
    return typer.main.get_command(cli.app)


def parse(words: list[str]) -> None:
    """Fail if the command line would not take these words; a usage line with placeholders has its options checked."""
    group = _commands()
    name, *arguments = [word.strip("[]") for word in words[1:]] or ["--help"]
    if name.startswith("--"):
        assert name in ("--help", "--version"), words
        return
    assert name in group.commands, f"there is no command {name}"
    command = group.commands[name]
    if hasattr(command, "commands") and arguments:
        name, *arguments = arguments
        assert name in command.commands, f"there is no command {words[1]} {name}"
        command = command.commands[name]
    if any(word in arguments for word in ("ENV_ID", "PROGRAM", "DIR", "FILE", "...", "N")):
        known = {option for parameter in command.get_params(typer.Context(command)) for option in parameter.opts}
        assert {word for word in arguments if word.startswith("--")} <= known, words
    elif arguments and "--help" not in arguments:
        command.make_context(name, list(arguments))


def check(words: list[str]) -> None:
    """Fail if a command names what does not exist: an option, a target, a module, an extra, a file."""
    program, *rest = words
    program = program.removeprefix(BIN)
    if program == "edmsim":
        parse(words[: words.index("<")] if "<" in words else words)
    elif program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        for target in rest:
            assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), target
    elif program in ("python", "python3"):
        assert find_spec(rest[1]) if rest[0] == "-m" else (ROOT / rest[0]).is_file(), words
    elif program == "pip":
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for extras in re.findall(r"(?:\.|edmsim)\[([\w,-]+)\]", " ".join(rest)):
            assert set(extras.split(",")) <= set(project["optional-dependencies"]), extras
        assert "-c" not in rest or (ROOT / rest[rest.index("-c") + 1]).is_file()
    elif program in ("source", "."):
        assert rest == [f"{BIN}activate"]
    else:
        assert entry_points(group="console_scripts", name=program), f"nothing here installs {program}"


def recipe(target: str) -> list[list[str]]:
    """Return the commands of edmsim that a target of the Makefile runs."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    lines = found[1].splitlines() if found else []
    return [["edmsim", *line.split()[1:]] for line in lines if line.startswith("\t$(BIN)/edmsim ")]


def run(words: list[str], page: str) -> int:
    """Run a command of edmsim that a page of this text shows, shortened; returns its exit status."""
    assert words[0].removeprefix(BIN) == "edmsim", f"{words[0]} is not run here: name it in NOT_RUN, with the reason"
    source = os.devnull
    if "<" in words:
        words, source = words[: words.index("<")], words[words.index("<") + 1]
    arguments = list(words[1:])
    if not {"--help", "--version"}.intersection(arguments):
        arguments += SHORT[" ".join(arguments[: 1 + (arguments[0] in cli.COMMANDS)])]
    is_gap_run = arguments[0] == "gap" and {"--serial", "--samples", "--log"}.intersection(arguments)
    if "--film" in arguments or is_gap_run:
        arguments += ["--seconds", "0.5"]
    if arguments[0] == "cut" or "--max-time" in arguments:
        seconds = CUT_S
        if "--max-time" in arguments:
            seconds = min(float(arguments.pop(arguments.index("--max-time") + 1)), CUT_S)
            arguments.remove("--max-time")
        elif "--out" in arguments and f"calibrate {arguments[arguments.index('--out') + 1]}/" in page:
            seconds = LOG_S
        arguments += ["--max-time", str(seconds)]
    with pytest.MonkeyPatch.context() as patch, _standard_input(source):
        patch.setattr(sys, "argv", ["edmsim", *arguments])
        with pytest.raises(SystemExit) as left:
            cli.main()
    code = left.value.code
    return code if isinstance(code, int) else 0


@contextmanager
def _standard_input(file: str) -> Iterator[None]:
    before = os.dup(0)
    with open(file, "rb") as opened:
        os.dup2(opened.fileno(), 0)
    try:
        yield
    finally:
        os.dup2(before, 0)
        os.close(before)


def replaced(patch: pytest.MonkeyPatch) -> None:
    """Leave away what takes a screen, or minutes; tests of their own run each of these."""
    from stable_baselines3 import PPO

    from edmsim import envs, measure, runs, validation
    from edmsim.bench import figures as bench
    from edmsim.bench import profile, revisions
    from edmsim.calibration import comparison, fit
    from edmsim.consoles import autotune
    from edmsim.envs.episode import Task
    from edmsim.hil import gap
    from edmsim.recording.rerun import viewer

    def shown(command: list[str], env: dict[str, str]) -> int:
        assert env["RUST_LOG"]
        assert any(word.endswith(".rrd") and Path(word).is_file() for word in command)
        return 0

    # tests/recording/test_playback.py opens recordings
    patch.setattr(viewer, "subprocess", SimpleNamespace(call=shown))
    # tests/bench measures, tests/validation runs all checks
    patch.setattr(bench, "measure", lambda: {"pulses_per_s": 1e6, "realtime_factor": 100.0})
    rates = {"pulses_per_s_fast": np.array([1e6, 2e6])}
    patch.setattr(revisions, "compare", lambda revision, *_: revisions.Pairs(revision, rates, rates))
    shares = dict.fromkeys(profile.PARTS, 1.0 / len(profile.PARTS))
    patch.setattr(profile, "profile", lambda _: {"fast": profile.LoopProfile(400.0, 410.0, shares, 1000)})
    patch.setattr(bench, "serial_figures", lambda watch: {"powercore_realtime_factor": 60.0})
    patch.setattr(gap, "delay_table", partial(gap.delay_table, draws=1))
    patch.setattr(validation, "run", partial(validation.run, modules=("closed_forms",)))
    # tests/measure cuts a leaning block, tests/consoles/servo finds gains
    guides = measure.GuidesFound(0.1, 0.0, (0.01, 0.01), np.array([0.5, 1.5]), np.array([-3.0, -1.0]))
    patch.setattr(measure, "measure_guides", lambda *_, **__: guides)
    answer = autotune.AxisTrace(np.array([0.0, 0.01, 0.02]), np.array([autotune.STEP_COUNTS, 5, 0]))
    response = autotune.AxisResponse(*[answer] * 3)
    found = autotune.Tuning(("P1",), {"P": 1}, response, response)
    patch.setattr(autotune, "autotune", lambda *_: found)
    # tests/calibration finds constants again
    patch.setattr(comparison, "NOISE_CUTS", 8)
    patch.setattr(fit, "MOST_STRETCHES", 2)
    patch.setattr(fit, "MOST_ROUNDS", 1)
    patch.setattr(comparison, "WHOLLY_SETTLED_DIAMETERS", comparison.SETTLED_DIAMETERS)
    # tests/evaluation, and the pages of the benchmark, have whole episodes
    patch.setattr(Task, "__init__", partialmethod(Task.__init__, episode_s=EPISODE_S))
    # tests/sweep begins processes
    in_threads = type("InThreads", (runs.Threads,), {"__init__": lambda self, count=None: None})
    patch.setattr(runs, "Processes", in_threads)
    learn, vec_env = PPO.learn, envs.make_sb3_vec_env

    def learned(self: PPO, total_timesteps: int, *more: Any, **options: Any) -> PPO:
        return learn(self, min(total_timesteps, self.n_steps * self.n_envs), *more, **options)

    def few(env_id: str, num_envs: int, **options: Any) -> Any:
        return vec_env(env_id, min(num_envs, FEW_ENVS), **options)

    patch.setattr(PPO, "learn", learned)  # one rollout
    patch.setattr(envs, "make_sb3_vec_env", few)
