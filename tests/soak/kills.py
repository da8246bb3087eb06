"""A short cut that is killed (SIGKILL) at random moments and resumed, until it is finished."""

import os
import random
import signal
import time
import traceback
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import edmsim
from edmsim.job.cut import CHECKPOINT
from edmsim.recording.report import read_cut

LINE = "G21 G90\nG0 X0 Y0\nG1 X0.3\nM2\n"
SETTINGS: dict[str, Any] = {
    "resolution": "fast", "offset": "none", "height_mm": 5.0, "max_time_s": 6.0, "controller": "counts",
}
PER_CUT = 5
"""Kills of one cut before it may finish (ours)."""


def kill(count: int, folder: Path, seed: int = 1) -> dict[str, Any]:
    """Kill a cut `count` times, some times each; compare every finished one with an uninterrupted one."""
    began, draw = time.monotonic(), random.Random(seed)
    program = folder / "line.ngc"
    program.write_text(LINE, encoding="ascii")
    started = time.monotonic()
    _end(_start(partial(_cut, program, folder / "whole")))
    takes_s = time.monotonic() - started
    whole = _results(folder / "whole")
    killed = cuts = equal = with_checkpoint = 0
    while killed < count:
        out, done = folder / f"cut-{cuts}", False
        for _ in range(PER_CUT):
            if killed < count and not done:
                child = _start(partial(_cut, program, out))
                died = _kill_after(child, draw.uniform(0.0, takes_s))
                killed += died
                with_checkpoint += died and (out / CHECKPOINT).exists()
                done = not died
        if not done:
            _end(_start(partial(_cut, program, out)))
        equal += _results(out) == whole
        cuts += 1
    return {
        "killed": killed, "with_checkpoint": with_checkpoint, "cuts": cuts, "equal": equal,
        "wall_s": time.monotonic() - began,
    }  # fmt: skip


def _cut(program: Path, out: Path) -> None:
    """Cut, or take up the checkpoint there is; killed behind its results a cut has none, and is made again."""
    import_module("edmsim.job.cut").CHECKPOINT_EVERY_S = 0.02  # type: ignore[attr-defined]
    edmsim.cut(program, out=out, resume=(out / CHECKPOINT).exists(), watch=lambda _: None, **SETTINGS)


def _start(work: Callable[[], None]) -> int:
    """Do some work in a process of its own and return its number."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    return child


def _end(child: int) -> None:
    status = os.waitpid(child, 0)[1]
    if status:
        raise RuntimeError(f"a cut ended with status {status}")


def _kill_after(child: int, seconds: float) -> bool:
    """Kill a process after some time; return whether it still ran."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            if status:
                raise RuntimeError(f"a resumed cut ended with status {status}")
            return False
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def _results(out: Path) -> tuple[Any, ...]:
    """Return the results of a finished cut without its wall time."""
    report, windows, _ = read_cut(out)
    names = sorted(file.name for file in out.iterdir())
    timeless = {name: value for name, value in report.items() if name not in ("wall_time_s", "realtime_factor")}
    # as text: a number that is none equals itself
    return names, timeless, repr(windows.to_pydict()), (out / "part.npz").stat().st_size
