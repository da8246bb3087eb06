"""`RecordRerun`: every n-th episode of an environment as a recording for `edmsim view`."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.environment import EdmEnv
from edmsim.envs.recorder import EpisodeRecorder
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.numeric import whole_from
from edmsim.recording.report import RECORDING

EVERY = 100  # ours: with episodes of a thousand steps recording then takes some per mille of the time
_NAME = "episode-"  # of a recording's folder, before its number


class RecordedEpisodes:
    """Every n-th episode in its own folder, shown at its end if live; `hint` says what to do without a viewer."""

    def __init__(self, folder: str | Path, every: int, hint: str | None) -> None:
        self._every = whole_from("every", every, 1)
        self.folders: list[Path] = []  # written so far
        self.recorder: EpisodeRecorder | None = None  # of the episode under way, if it is recorded
        self._folder = make_writable(folder)
        self._viewer: Any = None
        if hint is not None:
            from edmsim.recording.rerun.viewer import LiveViewer

            self._viewer = LiveViewer("the episodes", hint)

    def is_due(self, episode: int) -> bool:
        """Whether an episode is recorded."""
        return episode % self._every == 0

    def following(self) -> int:
        """Return the number after the last recording in the folder."""
        numbers = (folder.name.removeprefix(_NAME) for folder in self._folder.glob(f"{_NAME}*"))
        return max((int(number) + 1 for number in numbers if number.isdecimal()), default=0)

    def end(self, settings: dict[str, Any], outcome: str | None) -> None:
        """Write the recording, if there is one, and watch no more."""
        recorder, self.recorder = self.recorder, None
        if recorder is None:
            return
        recorder.stop()
        if len(recorder) == 0:
            return
        name, episode = settings["environment"], settings["episode"]
        folder = self._folder / f"{_NAME}{episode:06d}"
        recorder.write(folder / RECORDING, f"{name}, episode {episode}", settings, outcome)
        self.folders.append(folder)
        if self._viewer is not None:
            self._viewer.show(folder / RECORDING)

    def close(self) -> None:
        """Let the viewer go."""
        if self._viewer is not None:
            self._viewer.close()

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs; the recording under way and the viewer stay with the original."""
        return {**self.__dict__, "recorder": None, "_viewer": None}


class RecordRerun(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Record every n-th episode: wire, gap and kerf as of a cut, with actions, terms of the reward, costs and counts.

    The first episode is recorded, then every `every`-th. Each has a folder, ``episode-000000`` and so on, with a file
    ``cut.rrd`` for `edmsim view`, written at the episode's end. A recording that a reset or `close` ends early has
    the result "running". Recording changes no episode.

    Parameters
    ----------
    env : gymnasium.Env
        An environment of edmsim, with any wrappers; the recorded actions are those given to this wrapper.
    folder : path
        Created if it is missing; recordings in it are overwritten.
    every : int
        1 records all.
    live : bool
        Whether to show each in rerun's viewer when it ends.

    Attributes
    ----------
    recordings : list of pathlib.Path
        Folders written so far.

    Raises
    ------
    InputError
        If the environment is not edmsim's, the folder cannot be written to, or ``every`` is below 1.

    Examples
    --------
    >>> import gymnasium, edmsim
    >>> env = edmsim.envs.RecordRerun(gymnasium.make("edmsim/GapFeed-v2"), "runs/gap", every=100)  # doctest: +SKIP
    """

    def __init__(self, env: gym.Env[Any, Any], folder: str | Path, every: int = EVERY, live: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, folder=str(folder), every=every, live=live)
        gym.Wrapper.__init__(self, env)
        if not isinstance(env.unwrapped, EdmEnv):
            raise InputError(f"RecordRerun records environments of edmsim, and this is {env.unwrapped!r}")
        hint = "without live they are recorded all the same" if live else None
        self._recorded = RecordedEpisodes(folder, every, hint)
        self.recordings: list[Path] = self._recorded.folders
        self._edm: EdmEnv = env.unwrapped
        self._episode = -1
        self._made_with: dict[str, Any] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and its recording if it is an `every`-th one."""
        self._recorded.end(self._made_with, WORDS[StopCause.RUNNING].report)
        observation, info = self.env.reset(seed=seed, options=options)
        self._episode += 1
        if self._recorded.is_due(self._episode):
            self._recorded.recorder = self._edm.recorder(self._action_names())
            spec = self._edm.spec
            self._made_with = {"environment": "own" if spec is None else spec.id, "episode": self._episode}
            self._made_with |= {} if seed is None else {"seed of the reset": seed}
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Run and record a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if (recorder := self._recorded.recorder) is not None:
            action_list = np.ravel(action).tolist()
            recorder.step(action_list, info["reward_terms"], info["cost"], info["error_um"], info["area_mm2"])
            if terminated or truncated:
                self._recorded.end(self._made_with, None)
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the recording of a running episode, and close the environment."""
        self._recorded.end(self._made_with, WORDS[StopCause.RUNNING].report)
        self._recorded.close()
        self.env.close()

    def _action_names(self) -> list[str]:
        space, names = self.env.action_space, list(self._edm.family.action_names)
        width = int(np.prod(space.shape or ()))
        return names if width == len(names) and space == self._edm.action_space else (
            [f"action_{k}" for k in range(width)]
        )
