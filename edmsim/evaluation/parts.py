"""One part of `edmsim.envs.part_task.Part`, decided on by a law or a policy, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

import edmsim  # noqa: F401 - registers the environments
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs import pass_laws
from edmsim.envs.part_task import Part
from edmsim.envs.registry import find
from edmsim.errors import InputError
from edmsim.evaluation.episode import ORACLE, Result
from edmsim.evaluation.lines import lines_of

_OUTCOMES = {words.info: words.episode for words in WORDS.values()}


def is_part(env_id: str) -> bool:
    """Say whether an environment is decided on pass by pass."""
    return issubclass(find(env_id)[0], Part)


def check_laws(laws: Sequence[str]) -> None:
    """Raise `InputError` where none is named, or one cannot be made."""
    for name in laws:
        if name != ORACLE:
            pass_laws.from_text(name)
    if not laws:
        raise InputError(f"no law is named; choose from {', '.join(pass_laws.names())}")


def cut_part(env_id: str, seed: int, law: str, resolution: str | None = None, **options: Any) -> Result:
    """Cut a part; the reference rehearses it with several constants, and the cut that earns most counts."""
    if resolution is not None:
        options["resolution"] = resolution
    if law != ORACLE:
        return _cut(env_id, seed, law, law, options)
    tried = [_cut(env_id, seed, name, ORACLE, options) for name in lines_of(env_id).rehearsed]
    return max(tried, key=lambda result: result.total_return)


def _cut(env_id: str, seed: int, law: str, name: str, options: dict[str, Any]) -> Result:
    env, decides = gym.make(env_id, **options), pass_laws.from_text(law)
    observation, info = env.reset(seed=seed)
    decides.begin()
    gained = cost = seconds = area_mm2 = 0.0
    counts = dict.fromkeys(("short", "open", "spark", "arc"), 0)
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(decides.act(observation).astype(np.float32))
        over = terminated or truncated
        gained, cost, seconds = gained + float(reward), cost + info["cost"], seconds + info["dt_s"]
        area_mm2 += info["area_mm2"]
        counts = {kind: count + info[kind] for kind, count in counts.items()}
    env.close()
    pulses = max(sum(counts.values()), 1)
    known = {key: info[key] if info[key] >= 0.0 else math.nan for key in ("error_um", "ra_um")}
    outcome = _OUTCOMES[info["cause"]] if info["cause"] else WORDS[StopCause.TIME_LIMIT].episode
    return Result(
        seed, name, outcome, seconds, info["path_um"] * 1e-3, area_mm2, 60.0 * area_mm2 / info["time_s"], gained,
        info["wires_lost"], cost, counts["short"] / pulses, counts["open"] / pulses, math.nan, known["error_um"],
        math.nan, known["ra_um"],
    )  # fmt: skip
