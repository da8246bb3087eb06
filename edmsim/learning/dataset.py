"""Records of controllers for offline learning, as data sets of Minari (extra ``offline``), for `edmsim dataset`.

Every controller cuts whole episodes of the environment; the action is the feed, with a decision in every window.
During the recording every episode is a separate file, so you can resume an interrupted recording; the data sets are
assembled from these files at the end.
"""

import json
import math
import re
import shutil
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import numpy as np

from edmsim import __version__, files, numeric, user_code
from edmsim.controllers import from_text
from edmsim.envs import registry
from edmsim.envs.episode import check_acts
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.evaluation import compare, episode

SAVED_INFOS = ("time_s", "dt_s", "path_um", "area_mm2", "cost", "error_um", "wires_lost")
"""Entries of ``info`` that a data set has, as float64."""
UNFINISHED = "unfinished"
MADE_WITH = "made_with.json"
"""File of a controller's unfinished episodes with everything that decides them."""


class Recorded(NamedTuple):
    """A recorded data set."""

    dataset_id: str
    episodes: int
    steps: int
    breaks: int  # number of episodes with a wire break
    mean_return: float


@refuses_wrong_types
def record(
    env_id: str, controllers: Sequence[str], steps: int, out: str | Path, *, seed: int = 0,
    watch: Callable[[str, int, int], None] | None = None,
) -> list[Recorded]:
    """Record whole episodes of controllers, at least `steps` steps of each.

    Parameters
    ----------
    env_id : str
    controllers : sequence of str
        See `edmsim.controllers.from_text`; each gets a data set ``edmsim/gapfeed/CONTROLLER-v0``, named
        after the environment.
    steps : int
        Least number of steps per controller; the last episode is complete.
    out : path
        Folder of the data sets; to read them, set ``MINARI_DATASETS_PATH`` to it. The same call resumes an
        interrupted recording.
    seed : int
        Seed of the first episode; the next episodes use the next seeds, below the held-back ones.
    watch : callable, optional
        Called with the controller, its steps and all steps after every episode.

    Returns
    -------
    list of Recorded

    Raises
    ------
    InputError
        If an environment or controller is unknown or missing, `steps` is below 1, the folder has such a data set or
        another recording of that name, or Minari is not installed.
    """
    minari = _minari()
    numeric.whole_from("steps", steps, 1)
    numeric.whole_within("seed", seed, 0, episode.HELD_BACK // 2 - 1)
    if episode.is_part(env_id):
        raise InputError(f"{env_id} is decided on pass by pass: no feed controller acts in it")
    feeds: dict[str, Any] = {"action": "speed", "decision_s": None}
    family, full_id = registry.make_family(env_id, **feeds), registry.env_id_of(env_id)
    compare.check_controllers(controllers, env_id)
    _check_names(controllers)
    for name in controllers:
        check_acts(family, name)
    env: Any = gym.make(full_id, **feeds, disable_env_checker=True)
    out = files.folder_of(out)
    namespace, task, _ = gym.envs.registration.parse_env_id(full_id)
    place = "/".join(filter(None, (namespace, task.lower())))
    ids = {name: f"{place}/{_plain(name)}-v0" for name in controllers}
    folders = {name: out / UNFINISHED / _plain(name) for name in controllers}
    of_controllers = {name: {**compare.made_with(env_id, name), "seed": seed} for name in controllers}
    with files.locked(out, "edmsim dataset"):
        for name, folder in folders.items():
            _refuse_others(folder / MADE_WITH, of_controllers[name], out / ids[name])
        made = []
        for name, folder in folders.items():
            folder.mkdir(parents=True, exist_ok=True)
            with files.replacing(folder / MADE_WITH) as partial:
                partial.write_text(json.dumps(of_controllers[name]), encoding="utf-8")
            episodes = _episodes(env, name, steps, seed, folder, watch)
            made.append(_assemble(minari, env, ids[name], name, episodes, out))
        for folder in folders.values():
            shutil.rmtree(folder)
        with suppress(OSError):  # if recordings of other controllers are unfinished
            (out / UNFINISHED).rmdir()
    return made


def _minari() -> Any:
    try:
        import h5py  # noqa: F401 - Minari stores its records with it
        import minari
    except ImportError as error:
        raise InputError(f"data sets need {error.name}: pip install 'edmsim[offline]'") from None
    return minari


def _refuse_others(file: Path, expected: dict[str, Any], dataset: Path) -> None:
    """Raise `InputError` if a controller's folder has episodes of another recording, or its data set is finished."""
    if not file.is_file():
        if dataset.exists():
            raise InputError("this data set would be replaced: record into another folder, or delete it", dataset)
    elif json.loads(file.read_text(encoding="utf-8")) != expected:
        raise InputError("an interrupted recording of something else is in this folder: give another", file.parent)


def _episodes(
    env: Any, name: str, steps: int, seed: int, folder: Path, watch: Callable[[str, int, int], None] | None
) -> list[Path]:
    """Return the files of a controller's episodes, and make missing ones."""
    episodes: list[Path] = []
    done = 0
    while done < steps:
        file = folder / f"{len(episodes):06d}.npz"
        if not file.is_file():
            with files.replacing(file) as partial, partial.open("wb") as opened:
                np.savez(opened, allow_pickle=False, **_episode(env, name, seed + len(episodes)))
        episodes.append(file)
        with np.load(file, allow_pickle=False) as archive:
            done += len(archive["rewards"])
        if watch is not None:
            watch(name, min(done, steps), steps)
    return episodes


def _episode(env: Any, name: str, seed: int) -> dict[str, Any]:
    """Return an episode, an array per entry; observations and infos have one row more than steps."""
    observation, info = env.reset(seed=seed)
    law = env.unwrapped.attach_controller(from_text(name))
    law.begin()
    observations, step_infos, actions, rewards = [observation], [info], [], []
    terminated = truncated = False
    while not (terminated or truncated):
        action = law.action()
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        step_infos.append(info)
        actions.append(action)
        rewards.append(reward)
        truncated = truncated or (law.command().alarm is not None and not terminated)
    law.stop()
    ends = np.zeros((2, len(rewards)), np.bool_)
    ends[:, -1] = terminated, truncated
    infos = {f"info_{key}": np.array([info[key] for info in step_infos], np.float64) for key in SAVED_INFOS}
    return {
        "observations": np.array(observations), "actions": np.array(actions), "rewards": np.array(rewards),
        "terminations": ends[0], "truncations": ends[1], "seed": np.array(seed), **infos,
    }


def _assemble(minari: Any, env: Any, dataset_id: str, name: str, episodes: list[Path], out: Path) -> Recorded:
    """Write a controller's data set; replace one that an interruption has left incomplete."""
    buffers, returns, breaks = [], [], 0
    for k, file in enumerate(episodes):
        with np.load(file, allow_pickle=False) as archive:
            infos = {key: archive[f"info_{key}"] for key in SAVED_INFOS}
            returns.append(float(archive["rewards"].sum()))
            breaks += bool(infos["wires_lost"][-1] > 0)
            buffers.append(minari.data_collector.EpisodeBuffer(
                id=k, seed=int(archive["seed"]),
                observations=list(archive["observations"]), actions=list(archive["actions"]),
                rewards=archive["rewards"].tolist(), terminations=archive["terminations"].tolist(),
                truncations=archive["truncations"].tolist(), infos=infos,
            ))  # fmt: skip
    shutil.rmtree(out / dataset_id, ignore_errors=True)
    place = str(out.resolve())  # Minari joins a relative path twice
    with patch.dict("os.environ", MINARI_DATASETS_PATH=place), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # author and code are missing; the publisher adds them
        minari.create_dataset_from_buffers(
            dataset_id=dataset_id, buffer=buffers, env=env, algorithm_name=name,
            requirements=[f"edmsim=={__version__}"],
            description=f"{len(episodes)} episodes of {env.unwrapped.spec.id} cut by the feed controller {name}.",
        )
    return Recorded(dataset_id, len(episodes), sum(map(len, buffers)), breaks, math.fsum(returns) / len(returns))


def _check_names(controllers: Sequence[str]) -> None:
    """Raise `InputError` if two controllers would share a data set."""
    taken: dict[str, str] = {}
    for name in controllers:
        first = taken.setdefault(_plain(name), name)
        if first != name:
            raise InputError(
                f"{first} and {name} would both be the data set {_plain(name)}: record them into two folders"
            )


def _plain(name: str) -> str:
    """Return a controller's name in the form for folders and data sets: lower case, with hyphens."""
    short = user_code.policy_of(name)
    short = Path(short).stem if short.endswith((".json", ".npz")) else short
    return re.sub(r"[^a-zA-Z0-9]+", "-", short).strip("-").lower()
