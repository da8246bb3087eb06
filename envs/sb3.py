"""The native vector environment as stable-baselines3's `VecEnv`, and recordings of its episodes (extra ``rl``)."""

import time
from collections.abc import Iterable, Iterator, MutableMapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.envs.arguments import checked_options, one_each
from edmsim.envs.environment import EdmVectorEnv, SubEnvView
from edmsim.envs.episode import EVERY, RecordedEpisodes
from edmsim.envs.registry import env_id_of, find
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.numeric import whole, whole_from

try:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise InputError("stable-baselines3 is not installed: pip install 'edmsim[rl]'") from error

Indices = int | Iterable[int] | None  # which sub-environments: one, some, or all


# untyped if the extra is not installed
class EdmVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """An `EdmVectorEnv` in mode ``SAME_STEP`` for the learners of stable-baselines3.

    Normalise with stable-baselines3's own `VecNormalize`; Gymnasium's refuses this mode. The last info of an episode
    has its return, length and time as ``episode``, as with a `VecMonitor`.
    """

    def __init__(self, env: EdmVectorEnv) -> None:
        if env.autoreset_mode is not gym.vector.AutoresetMode.SAME_STEP:
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
        """Seed the next reset; sub-environment i gets seed + i. Without a seed, one is drawn."""
        return super().seed(None if seed is None else whole_from("seed", seed, 0))

    def set_options(self, options: Any = None) -> None:
        """Set options of the next reset, those of `EdmEnv.reset`: for all sub-environments, or in a list one each."""
        each = one_each("options", options, self.num_envs)
        super().set_options([checked_options(one, ("machine",)) for one in each])

    def reset(self) -> Any:
        """Begin an episode in every sub-environment, with the options of `set_options`."""
        indices = range(self.num_envs)
        groups = [np.arange(self.num_envs) == index for index in indices] if any(self._options) else [None]
        for mask in groups:
            own = {} if mask is None else {**self._options[int(np.argmax(mask))], "reset_mask": mask}
            observations, infos = self.env.reset(seed=self._seeds, options=own)
            for index in indices if mask is None else np.flatnonzero(mask).tolist():
                self.reset_infos[index] = StepInfo(infos, index).copy()
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations

    def step_async(self, actions: Any) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Run a step; every sub-environment's info has all entries of `EdmVectorEnv`, computed when they are read."""
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        final_obs, final_info = infos.pop("final_obs", None), infos.pop("final_info", None)
        each: list[Any] = [StepInfo(infos, index) for index in range(self.num_envs)]
        for index in np.flatnonzero(done).tolist():
            self.reset_infos[index] = each[index].copy()
            last = StepInfo(final_info, index).copy()
            last["terminal_observation"] = final_obs[index]
            last["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
            last["episode"] = {
                "r": float(self._returns[index]), "l": int(self._lengths[index]),
                "t": round(time.perf_counter() - self._start_s, 6),
            }
            each[index] = last
            self._returns[index], self._lengths[index] = 0.0, 0
        return observations, rewards.astype(np.float32), done, each

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Return a picture of every sub-environment; None for each without render mode ``"rgb_array"``."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of sub-environments, the same as a single environment's (`SubEnvView`)."""
        return [getattr(view, attr_name) for view in self._views(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of sub-environments; shared attributes are refused (see `SubEnvView.take`)."""
        for view in self._views(indices):
            view.take(attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of sub-environments; ``change`` affects all and is called once."""
        views = self._views(indices)
        if method_name != "change":
            return [getattr(view, method_name)(*args, **kwargs) for view in views]
        if set(views) != set(self.env.views):
            raise InputError("change is called for all sub-environments or none: they share one environment")
        self.env.change(*args, **kwargs)
        return [None] * len(views)

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Return True for `Monitor`, whose figures are in the infos; sub-environments have no other wrappers."""
        return [wrapper_class is Monitor for _ in self._views(indices)]

    def _views(self, indices: Indices) -> list[SubEnvView]:
        """Return the sub-environments with these numbers, or all for None."""
        if indices is None:
            return list(self.env.views)
        one = whole(indices)
        named = [one] if one is not None else list(indices)  # type: ignore[arg-type]
        try:
            return [self.env.views[whole_from("a sub-environment", index)] for index in named]
        except IndexError:
            many = f"there are {self.num_envs} sub-environments: number them from 0, not {indices!r}"
            raise IndexError(many) from None


class StepInfo(MutableMapping[str, Any]):
    """The info of one sub-environment, read from a vector environment's: an entry is computed when it is read.

    Training reads few entries, and computing all takes longer than all other Python code. A changed info becomes a
    dictionary.
    """

    __slots__ = ("_changed", "_index", "_infos")

    def __init__(self, infos: dict[str, Any], index: int) -> None:
        self._infos, self._index = infos, index
        self._changed: dict[str, Any] | None = None

    def get(self, name: str, default: Any = None) -> Any:
        """Return an entry, or the default."""
        if self._changed is not None:
            return self._changed.get(name, default)
        there = self._infos.get(f"_{name}")
        return default if there is None or not there[self._index] else self._value(name)

    def __getitem__(self, name: str) -> Any:
        value = self.get(name, self)  # no entry has the info itself as value
        if value is self:
            raise KeyError(name)
        return value

    def _value(self, name: str) -> Any:
        values = self._infos[name]
        return StepInfo(values, self._index).copy() if isinstance(values, dict) else values.item(self._index)

    def copy(self) -> dict[str, Any]:
        """Return a dictionary of all entries."""
        if self._changed is not None:
            return self._changed.copy()
        index, infos = self._index, self._infos
        return {name: self._value(name) for name in infos if name[0] != "_" and infos[f"_{name}"][index]}

    def _dictionary(self) -> dict[str, Any]:
        if self._changed is None:
            self._changed = self.copy()
        return self._changed

    def __setitem__(self, name: str, value: Any) -> None:
        self._dictionary()[name] = value

    def __delitem__(self, name: str) -> None:
        del self._dictionary()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.copy())

    def __len__(self) -> int:
        return len(self.copy())

    def __repr__(self) -> str:
        return repr(self.copy())


@refuses_wrong_types
def make_sb3_vec_env(env_id: str, num_envs: int = 1, seed: int | None = None, **options: Any) -> EdmVecEnv:
    """Make a vector environment for stable-baselines3 that logs the episodes' returns.

    Parameters
    ----------
    env_id : str
        ``"edmsim/GapFeed-v2"`` and so on.
    num_envs : int
    seed : int, optional
        Seed of the first reset; sub-environment i gets seed + i.
    **options
        Arguments of the environment.

    Returns
    -------
    EdmVecEnv

    Raises
    ------
    InputError
        If stable-baselines3 is missing, the environment is not one of edmsim, or an option cannot be used.

    Examples
    --------
    >>> from edmsim.envs import make_sb3_vec_env
    >>> env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=0, resolution="fast")
    >>> env.reset().shape
    (2, 46)
    """
    find(env_id)
    made = gym.make_vec(
        env_id_of(env_id), num_envs=num_envs, vectorization_mode="vector_entry_point",
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP, **options,
    )
    assert isinstance(made, EdmVectorEnv)  # `find` accepts no other environments
    env = EdmVecEnv(made)
    if seed is not None:
        env.seed(seed)
    return env


# untyped if the extra is not installed
class RecordEpisodes(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Record every n-th episode of the first sub-environment; the training stays the same, bit for bit.

    Folders and files are those of `RecordRerun`. The recorded actions are those of the sub-environment, clamped to
    -1..1.

    Parameters
    ----------
    folder : path
        Created if it is missing. A new training overwrites recordings in it; one that continues adds to them.
    every : int
        1 records all of the first sub-environment's episodes.
    live : bool
        Whether to show each in rerun's viewer when it ends.

    Attributes
    ----------
    recordings : list of pathlib.Path
        Folders written so far.

    Raises
    ------
    InputError
        If the folder cannot be written to or ``every`` is below 1; when training begins, if the sub-environments are
        not edmsim's.

    Examples
    --------
    >>> from edmsim.envs import RecordEpisodes
    >>> model.learn(100_000, callback=RecordEpisodes("runs/gap", every=50))  # doctest: +SKIP
    """

    def __init__(self, folder: str | Path, every: int = EVERY, live: bool = False) -> None:
        super().__init__()
        hint = f"recordings come into {folder} without --live" if live else None
        self._recorded = RecordedEpisodes(folder, every, hint)
        self.recordings: list[Path] = self._recorded.folders
        self._episode = 0
        self._over = False
        self._envs: Any = None

    def _on_training_start(self) -> None:
        vec_env = self.training_env.unwrapped
        if not isinstance(vec_env, EdmVecEnv):
            raise InputError("RecordEpisodes records sub-environments of edmsim.envs.make_sb3_vec_env only")
        self._envs = vec_env.env
        self._envs.watch = self._see
        if self.model.num_timesteps:
            self._episode = max(self._episode, self._recorded.following())
        self._begin()

    def _see(self, actions: NDArray[Any], infos: dict[str, Any], ended: NDArray[Any]) -> None:
        """Record a step of the first sub-environment, before its next episode begins."""
        self._over = bool(ended[0])
        if self._recorded.recorder is None:
            return
        terms = {name: values[0] for name, values in infos["reward_terms"].items()}
        figures = [float(infos[name][0]) for name in ("cost", "error_um", "area_mm2")]
        self._recorded.recorder.step(actions[0].clip(-1.0, 1.0).tolist(), terms, *figures)
        if self._over:
            self._end()

    def _on_step(self) -> bool:
        if self._over:
            self._over = False
            self._episode += 1
            self._begin()
        return True

    def _on_training_end(self) -> None:
        self._end()
        self._envs.watch = None
        self._recorded.close()

    def _begin(self) -> None:
        if self._recorded.is_due(self._episode):
            self._recorded.recorder = self._envs.recorder(0)

    def _end(self) -> None:
        name, windows = self._envs.spec.id, self.num_timesteps
        settings = {"environment": name, "episode": self._episode, "windows trained with": windows}
        self._recorded.end(settings)
