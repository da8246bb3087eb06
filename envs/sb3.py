"""The native vector environment as stable-baselines3's `VecEnv` (extra ``rl``)."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from edmsim.envs.lane_view import LaneView
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.numeric import whole, whole_from

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise InputError("stable-baselines3 is not installed: pip install 'edmsim[rl]'") from error

Lanes = int | Iterable[int] | None
"""Which lanes: one, some, or all."""


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
        self._start_s = time.perf_counter()
        self._actions: Any = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = dict(env.views[0].metadata)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset; lane i gets seed + i, of a seed of its own choice if none is given."""
        return super().seed(None if seed is None else whole_from("seed", seed, 0))

    def reset(self) -> Any:
        """Begin an episode in every lane, with the options of `set_options`."""
        lanes = range(self.num_envs)
        groups = [np.arange(self.num_envs) == lane for lane in lanes] if any(self._options) else [None]
        for mask in groups:
            own = {} if mask is None else {**self._options[int(np.argmax(mask))], "reset_mask": mask}
            observations, infos = self.env.reset(seed=self._seeds, options=own)
            for lane in lanes if mask is None else np.flatnonzero(mask).tolist():
                self.reset_infos[lane] = lane_info(infos, lane)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
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
        lane_dicts = lane_infos(infos, self.num_envs)
        for lane in np.flatnonzero(done):
            self.reset_infos[lane] = lane_dicts[lane]
            last = lane_info(infos["final_info"], int(lane))
            last["terminal_observation"] = infos["final_obs"][lane]
            last["TimeLimit.truncated"] = bool(truncated[lane] and not terminated[lane])
            last["episode"] = {
                "r": float(self._returns[lane]), "l": int(self._lengths[lane]),
                "t": round(time.perf_counter() - self._start_s, 6),
            }
            lane_dicts[lane] = last
        self._returns[done], self._lengths[done] = 0.0, 0
        return observations, rewards.astype(np.float32), done, lane_dicts

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Return a picture of every lane, or None for each without the render mode for pictures."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Lanes = None) -> list[Any]:
        """Return an attribute of lanes, of each what a single environment in its place has (see `LaneView`)."""
        return [getattr(view, attr_name) for view in self._views(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Lanes = None) -> None:
        """Set an attribute of lanes; what they share is refused (see `LaneView.take`)."""
        for view in self._views(indices):
            view.take(attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Lanes = None, **kwargs: Any) -> list[Any]:
        """Call a method of lanes; ``change`` is of all together, and called once.

        Raises
        ------
        InputError
            ``change`` of only some lanes.
        """
        views = self._views(indices)
        if method_name != "change":
            return [getattr(view, method_name)(*args, **kwargs) for view in views]
        if set(views) != set(self.env.views):
            raise InputError("change is called for all lanes or none: they share one environment")
        self.env.change(*args, **kwargs)
        return [None] * len(views)

    def env_is_wrapped(self, wrapper_class: Any, indices: Lanes = None) -> list[bool]:
        """No lane has a wrapper of its own; the `Monitor`'s figures are in the infos."""
        return [wrapper_class is Monitor for _ in self._views(indices)]

    def _views(self, indices: Lanes) -> list[LaneView]:
        """Return lanes by their numbers: of one, of some, or all."""
        if indices is None:
            return list(self.env.views)
        one = whole(indices)
        named = [one] if one is not None else list(indices)  # type: ignore[arg-type]
        try:
            return [self.env.views[whole_from("a lane", lane)] for lane in named]
        except IndexError:
            raise IndexError(f"there are {self.num_envs} lanes: number them from 0, not {indices!r}") from None


def lane_infos(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return the infos of all lanes out of a vector environment's, each with its own."""
    lane_dicts: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in infos.items():
        if name.startswith("_") or name in ("final_obs", "final_info"):
            continue
        inner = lane_infos(values, count) if isinstance(values, dict) else values.tolist()
        for info, value, there in zip(lane_dicts, inner, infos[f"_{name}"].tolist(), strict=True):
            if there:
                info[name] = value
    return lane_dicts


def lane_info(infos: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info of one lane out of a vector environment's."""
    lane_dicts = {name: values for name, values in infos.items() if not name.endswith(("final_obs", "final_info"))}
    return lane_infos(lane_slice(lane_dicts, lane), 1)[0]


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
        ``"edmsim/GapFeed-v2"`` and so on.
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
    >>> env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=0, resolution="fast")
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
    if seed is not None:
        env.seed(seed)
    return env
