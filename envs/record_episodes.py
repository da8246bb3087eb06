"""`RecordEpisodes`: every n-th episode of a training with stable-baselines3 as a recording (extra ``rl``)."""

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.record import RecordedEpisodes
from edmsim.envs.reward import TERMS
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.errors import InputError

try:
    from stable_baselines3.common.callbacks import BaseCallback
except ImportError as error:
    raise InputError("stable-baselines3 is not installed: pip install 'edmsim[rl]'") from error

EVERY = 100  # ours: with episodes of a thousand steps recording then takes some per mille of the time


# untyped where the extra is missing
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
        """Note a step of the first sub-environment, before its next episode begins."""
        self._over = bool(ended[0])
        if self._recorded.recorder is None:
            return
        terms = {name: float(infos["reward_terms"][name][0]) for name in TERMS}
        figures = [float(infos[name][0]) for name in ("cost", "error_um", "area_mm2")]
        self._recorded.recorder.step(actions[0].clip(-1.0, 1.0).tolist(), terms, *figures)
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
        self._recorded.close()

    def _begin(self) -> None:
        if self._recorded.is_due(self._episode):
            self._recorded.recorder = self._envs.recorder(0)

    def _end(self, outcome: str | None) -> None:
        name, windows = self._envs.spec.id, self.num_timesteps
        settings = {"environment": name, "episode": self._episode, "windows trained with": windows}
        self._recorded.end(settings, outcome)
