"""The native vector environment as stable-baselines3's `VecEnv` (extra ``rl``)."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise InputError("stable-baselines3 is not installed: pip install 'edmsim[rl]'") from error


# untyped where the extra is missing
class EdmVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """An `EdmVectorEnv` in mode ``SAME_STEP`` for the learners of stable-baselines3.

    Normalise with stable-baselines3's own `VecNormalize`; Gymnasium's refuses this mode. The last info of an episode
    has its return, length and time as ``episode``, as of a `VecMonitor`, from which learners tell the mean return.
    """

    def __init__(self, env: EdmVectorEnv) -> None:
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise InputError("stable-baselines3 wants a vector environment with autoreset_mode SAME_STEP")
        if env.family.objectives:
            raise InputError("stable-baselines3 learns from one reward: make the environment without objectives")
        self.env = env
        self._returns, self._lengths = np.zeros(env.num_envs), np.zeros(env.num_envs, np.int64)
        self._begun_s = time.perf_counter()
        self.render_mode = env.render_mode
        self._seed: int | None = None
        self._actions: Any = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset; lane i gets seed + i."""
        self._seed = seed
        return [None if seed is None else seed + lane for lane in range(self.num_envs)]

    def reset(self) -> Any:
        """Begin an episode in every lane."""
        observations, infos = self.env.reset(seed=self._seed)
        self._seed = None
        self._returns[:], self._lengths[:] = 0.0, 0
        self.reset_infos = [lane_info(infos, lane) for lane in range(self.num_envs)]
        return observations

    def step_async(self, actions: Any) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Run a step; every lane's info tells all that `EdmVectorEnv` tells of it."""
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        told = lane_infos(infos, self.num_envs)
        for lane in np.flatnonzero(done):
            self.reset_infos[lane] = told[lane]
            last = lane_info(infos["final_info"], int(lane))
            last["terminal_observation"] = infos["final_obs"][lane]
            last["TimeLimit.truncated"] = bool(truncated[lane] and not terminated[lane])
            last["episode"] = {
                "r": float(self._returns[lane]), "l": int(self._lengths[lane]),
                "t": round(time.perf_counter() - self._begun_s, 6),
            }
            told[lane] = last
        self._returns[done], self._lengths[done] = 0.0, 0
        return observations, rewards.astype(np.float32), done, told

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Return a picture of every lane."""
        return self.env.render() or ()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for every lane."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the lanes share one environment."""
        raise InputError(
            f"{attr_name} cannot be set: the lanes share one environment; give it when making it, or change it for "
            f"the next episodes by env_method('change', {attr_name}=...)"
        )

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the environment that all lanes share, once; returns what it returned for every lane.

        Raises
        ------
        InputError
            Only some lanes are named.
        """
        lanes = list(self._get_indices(indices))
        if set(lanes) != set(range(self.num_envs)):
            raise InputError(f"{method_name} is called for all lanes or none: they share one environment")
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(lanes)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No lane has a wrapper of its own; what a `Monitor` tells is told."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _get_indices(self, indices: int | Iterable[int] | None) -> Iterable[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else indices


def lane_infos(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return the infos of all lanes out of a vector environment's, each with what is told of it."""
    told: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in infos.items():
        if name.startswith("_") or name in ("final_obs", "final_info"):
            continue
        inner = lane_infos(values, count) if isinstance(values, dict) else values.tolist()
        for info, value, there in zip(told, inner, infos[f"_{name}"].tolist(), strict=True):
            if there:
                info[name] = value
    return told


def lane_info(infos: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info of one lane out of a vector environment's."""
    told = {name: values for name, values in infos.items() if not name.endswith(("final_obs", "final_info"))}
    return lane_infos(lane_slice(told, lane), 1)[0]


def lane_slice(values: Any, lane: int) -> Any:
    """Return a vector environment's values of one lane, as those of a vector of one."""
    if isinstance(values, dict):
        return {name: lane_slice(inner, lane) for name, inner in values.items()}
    return values[lane : lane + 1]


def make_sb3_vec_env(env_id: str, num_envs: int = 1, seed: int | None = None, **options: Any) -> EdmVecEnv:
    """Make a vector environment for stable-baselines3, which learners show the returns of.

    Parameters
    ----------
    env_id : str
        ``"edmsim/GapFeed-v1"`` and so on.
    num_envs : int
    seed : int, optional
        Of the first reset; lane i gets seed + i.
    **options
        Arguments of the environment.

    Returns
    -------
    EdmVecEnv

    Raises
    ------
    InputError
        If stable-baselines3 is missing, or an option cannot be used.

    Examples
    --------
    >>> from edmsim.envs import make_sb3_vec_env
    >>> env = make_sb3_vec_env("edmsim/GapFeed-v1", 2, seed=0, resolution="fast")
    >>> env.reset().shape
    (2, 40)
    """
    made = gym.make_vec(
        env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP,
        **options,
    )
    if not isinstance(made, EdmVectorEnv):
        raise InputError(f"{env_id!r} is not an environment of edmsim")
    env = EdmVecEnv(made)
    env.seed(seed)
    return env
