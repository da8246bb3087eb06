"""`RecordEpisodes`: every n-th episode of a training with stable-baselines3 as a recording (extra ``rl``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.recorder import EpisodeRecorder
from edmsim.envs.reward import TERMS
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.numeric import whole_from
from edmsim.recording.rerun.playback import RECORDING
from edmsim.recording.rerun.viewer import LiveViewer, show

try:
    from stable_baselines3.common.callbacks import BaseCallback
except ImportError as error:
    raise InputError("stable-baselines3 is not installed: pip install 'edmsim[rl]'") from error

EVERY = 100  # ours: with episodes of a thousand steps recording then takes some per mille of the time


# untyped where the extra is missing
class RecordEpisodes(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Record every n-th episode of the first sub-environment; the training stays the same to the bit.

    Folders and files are those of `RecordRerun`. What is recorded as actions is what the sub-environment was given,
    at most 1 either way.

    Parameters
    ----------
    folder : path
        Is made if it is missing; recordings in it are replaced.
    every : int
        1 records all of the first sub-environment's episodes.
    live : bool
        Whether each is shown in rerun's viewer as it ends.

    Attributes
    ----------
    recordings : list of pathlib.Path
        Folders written so far.

    Raises
    ------
    InputError
        A folder that cannot be written to, or ``every`` below 1; when training begins, sub-environments that are not
        edmsim's.

    Examples
    --------
    >>> from edmsim.envs import RecordEpisodes
    >>> model.learn(100_000, callback=RecordEpisodes("runs/gap", every=50))  # doctest: +SKIP
    """

    def __init__(self, folder: str | Path, every: int = EVERY, live: bool = False) -> None:
        super().__init__()
        make_writable(Path(folder))
        self.recordings: list[Path] = []
        self._folder, self._every = Path(folder), whole_from("every", every, 1)
        self._viewer = LiveViewer("the episodes", f"recordings come into {folder} without --live") if live else None
        self._episode = 0
        self._over = False
        self._recorder: EpisodeRecorder | None = None
        self._envs: Any = None

    def _on_training_start(self) -> None:
        vec_env = self.training_env.unwrapped
        if not isinstance(vec_env, EdmVecEnv):
            raise InputError("RecordEpisodes records sub-environments of edmsim.envs.make_sb3_vec_env only")
        self._envs = vec_env.env
        self._envs.watch = self._see
        self._begin()

    def _see(self, actions: NDArray[Any], infos: dict[str, Any], ended: NDArray[Any]) -> None:
        """Note a step of the first sub-environment, before its next episode begins."""
        self._over = bool(ended[0])
        if self._recorder is None:
            return
        terms = {name: float(infos["reward_terms"][name][0]) for name in TERMS}
        figures = [float(infos[name][0]) for name in ("cost", "error_um", "area_mm2")]
        self._recorder.step(actions[0].clip(-1.0, 1.0).tolist(), terms, *figures)
        if self._over:
            self._end(None)

    def _on_step(self) -> bool:
        if self._over:
            self._over = False
            self._episode += 1
            self._begin()
        return True

    def _on_training_end(self) -> None:
        self._end(WORDS[StopCause.RUNNING].report)
        self._envs.watch = None
        if self._viewer is not None:
            self._viewer.close()

    def _begin(self) -> None:
        if self._episode % self._every == 0:
            self._recorder = self._envs.recorder(0)

    def _end(self, outcome: str | None) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        recorder.stop()
        if len(recorder) == 0:
            return
        folder, name = self._folder / f"episode-{self._episode:06d}", self._envs.spec.id
        settings = {"environment": name, "episode": self._episode, "windows trained with": self.num_timesteps}
        recorder.write(folder / RECORDING, f"{name}, episode {self._episode}", settings, outcome)
        self.recordings.append(folder)
        if self._viewer is not None:
            show(folder / RECORDING, self._viewer)
