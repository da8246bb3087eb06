"""Recordings of episodes: that of a cut, and the actions, rewards and costs of the steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim import __version__
from edmsim.cosim.observers import Turn
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.path_follower import RUNNING, SUB_ENV
from edmsim.envs.reward import TERMS
from edmsim.envs.sub_envs import SubEnvs
from edmsim.files import make_writable
from edmsim.numeric import whole_from
from edmsim.plant.kernel.state import STATE
from edmsim.plant.window import read_window
from edmsim.plant.workpiece.height_steps import middle_slice
from edmsim.recording.cut_folder import RECORDING
from edmsim.recording.report import ProfileErrors, Report
from edmsim.recording.windows import PULSES, Closeups, Frames, WindowTable, row_of

CLOSEUP_EVERY = 12
"""Windows per window that is recorded pulse by pulse, with the wire's shape (ours: three a second of machine time, as
playback shows a cut some times faster than it was; and a twelfth of the time they take)."""
EVERY = 100  # ours: with episodes of a thousand steps recording then takes some per mille of the time
_NAME = "episode-"  # of a recording's folder, before its number


class EpisodeRecorder:
    """Records the episode that a sub-environment has just begun, until `stop`, and changes nothing of it."""

    def __init__(self, sub_envs: SubEnvs, index: int, actions: Sequence[str]) -> None:
        plant = sub_envs.fleet.plants[index]
        size = plant.resolution
        self._sub_envs, self._index, self._actions = sub_envs, index, list(actions)
        self._windows: list[tuple[bytes, bytes, bytes]] = []
        records = sub_envs.fleet.windows, sub_envs.rows, sub_envs.fleet.states
        self._records = [array[index : index + 1].view(np.uint8) for array in records]
        self._causes = sub_envs.rows["cause"]
        self._closeups = Closeups(size.slices, size.rays, _scene_slice(sub_envs, index))
        self._steps: list[tuple[float, ...]] = []
        self._rows: list[int] = []
        self._leg = -1
        self._closeups.begin(plant)
        sub_envs.watchers.append((index, self._window))

    def __len__(self) -> int:
        """Return the number of windows recorded."""
        return len(self._windows)

    def stop(self) -> None:
        """Watch no more."""
        watchers, own = self._sub_envs.watchers, (self._index, self._window)
        if own in watchers:  # not in a copy's: see `SubEnvs.watchers`
            watchers.remove(own)

    def _window(self) -> None:
        """See a window of the sub-environment."""
        here, fleet, rows = self._index, self._sub_envs.fleet, self._sub_envs.rows
        leg, plant = self._sub_envs.leg[here], fleet.plants[here]
        # as bytes: to read the records takes a tenth of a step, and can wait until the recording is written
        window, row, state = (record.tobytes() for record in self._records)
        self._windows.append((window, row, state))
        if self._leg != leg:
            self._leg, points_um = leg, self._sub_envs.scenario(here).legs_um[leg]
            self._closeups.leg(np.rint(points_um).astype(np.int64), float(rows[here]["before_um"]))
        if len(self._windows) % CLOSEUP_EVERY == 1 or self._causes[here] != RUNNING:
            turn = _turn(window, row)[0]._replace(opposite=plant.opposite_pulses())
            self._closeups.window(turn, plant)

    def _table(self) -> WindowTable:
        table = WindowTable()
        plant = self._sub_envs.fleet.plants[self._index]
        for window_bytes, row_bytes, state_bytes in self._windows:
            state = np.frombuffer(state_bytes, STATE)[0]
            turn, setting_us = _turn(window_bytes, row_bytes)
            commanded_um, following_um = state["commanded_um"][:2].tolist(), plant.following_error_in_um(state)
            table.append(row_of(turn, commanded_um, following_um, setting_us))
        return table

    def step(
        self, action: Sequence[float], terms: Mapping[str, float], cost: float, error_um: float, area_mm2: float
    ) -> None:
        """Note a step that is just over; cost, error and area as in ``info``."""
        self._steps.append((*action, *(terms[name] for name in TERMS), cost, error_um, area_mm2))
        self._rows.append(len(self._windows) - 1)

    def write(self, file: Path, title: str, settings: Mapping[str, Any], outcome: str | None = None) -> None:
        """Write the recording of the episode so far, before another begins; `settings` are for the text about it."""
        from edmsim.envs.pictures import scene_of
        from edmsim.recording.rerun.write import COST, RETURN, TOTAL, steps_of, write_recording

        file.parent.mkdir(parents=True, exist_ok=True)
        machine, plant = self._sub_envs.scenario(self._index).machine, self._sub_envs.fleet.plants[self._index]
        scene, table = scene_of(self._sub_envs, self._index), self._table()
        rows, widths = table.rows, (len(self._actions), len(TERMS), 1, 1, 1)
        steps = np.array(self._steps, np.float64).reshape(len(self._steps), sum(widths))
        actions, rewards, cost, error_um, _ = np.split(steps, np.cumsum(widths)[:-1], axis=1)
        groups = [
            ("action", "actions, as given", self._actions, actions),
            ("reward", "terms of the reward, per step", TERMS, rewards),
            (RETURN, "return so far", (TOTAL,), np.cumsum(rewards.sum(axis=1))[:, None]),
            (COST, "cost per step, and so far", ("step", TOTAL), np.column_stack([cost, np.cumsum(cost)])),
            ("way", "distance of the wire from the path, um", ("error_um",), error_um),
        ]
        note = (
            f"Discharges, top view, oscilloscope, the wire's shape and its gas: one window of "
            f"{CLOSEUP_EVERY * self._closeups.stride}, around retracts and corners one of {CLOSEUP_EVERY}, and the "
            f"last. Of such a window its last {PULSES} pulses are kept."
        )
        write_recording(
            file, scene, table.to_arrow(), Frames(plant.resolution.slices), self._closeups, machine,
            self._report(settings, outcome or self._outcome(), scene.known_errors(), rows), title,
            steps_of(groups, rows[self._rows, 0], rows[self._rows, -1], [note]),
        )

    def _outcome(self) -> str:
        cause = StopCause(int(self._sub_envs.rows[self._index]["cause"]))
        late = cause is StopCause.RUNNING and bool(self._sub_envs.out_of_time[self._index])
        return WORDS[StopCause.TIME_LIMIT if late else cause].report

    def _report(
        self, settings: Mapping[str, Any], outcome: str, known: NDArray[np.float64], values: NDArray[Any]
    ) -> Report:
        """Return of a cut's report what its recording tells, with the errors `known` of the part, in um."""
        row, scenario = self._sub_envs.rows[self._index], self._sub_envs.scenario(self._index)
        cutting_s = float(row["elapsed_ns"]) * 1e-9
        area_mm2 = sum(step[-1] for step in self._steps)
        return Report(
            outcome=outcome, machining_time_s=float(values[-1, 0]) if len(values) else 0.0,
            path_length_mm=float(values[:, -1].max()) * 1e-3 if len(values) else 0.0,
            cutting_rate_mm2_min=60.0 * area_mm2 / cutting_s if cutting_s else None,
            profile_error_um=ProfileErrors(
                float(np.abs(known).max()) if len(known) else None,
                float(np.sqrt(np.mean(known**2))) if len(known) else None,
            ),
            seed=scenario.plant_seed, edmsim_version=__version__,
            settings={**settings, **{f"drawn {name}": value for name, value in scenario.drawn.items()}},
        )  # fmt: skip


def _turn(window_bytes: bytes, row_bytes: bytes) -> tuple[Turn, tuple[float, float]]:
    """Return the turn that was kept of a window, and the generator's on-time and period in us."""
    window, row = read_window(memoryview(window_bytes)), np.frombuffer(row_bytes, SUB_ENV)[0]
    on_us, period_us = row["setting_us"].tolist()
    path_um = float(row["before_um"] + row["path_um"])
    return Turn(window, window.start_ns + window.duration_ns, float(row["feed_um_s"]), path_um), (on_us, period_us)


def _scene_slice(sub_envs: SubEnvs, index: int) -> int:
    """Return the slice at mid height of the lowest place, as `Scene.middle_slice`: it has metal everywhere."""
    scenario, slices = sub_envs.scenario(index), sub_envs.fleet.plants[index].resolution.slices
    machine = scenario.machine
    lowest_mm = min([step.height_mm for step in scenario.stock.steps], default=machine.height_mm)
    return middle_slice(lowest_mm, machine.height_mm, slices)


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
