"""Episodes: `Task` runs one for a controller; attached controllers and recorders receive every window."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from edmsim import __version__
from edmsim.closed_loop.cycle import CycleResult
from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.controllers import FeedController, SeesTruth, WindowObservation, from_text
from edmsim.controllers.protocols import FeedCommand, check_command, next_wire, set_up_controller
from edmsim.controllers.user_controllers import check_is_controller, rehearsed
from edmsim.envs import path_follower, reward
from edmsim.envs.arguments import checked_options
from edmsim.envs.registry import make_family
from edmsim.envs.sub_envs import SubEnvs
from edmsim.envs.task import Family, Scenario
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import finite, whole_from
from edmsim.plant.kernel.state import STATE
from edmsim.plant.plant import Plant
from edmsim.plant.window import read_window
from edmsim.plant.workpiece.height_steps import middle_slice
from edmsim.recording.report import RECORDING, ProfileErrors, Report
from edmsim.recording.windows import PULSES, Closeups, Frames, WindowTable, row_of

CLOSEUP_EVERY = 12
"""Every `CLOSEUP_EVERY`-th window is recorded pulse by pulse, with the wire's shape (ours: three a second of machine
time suffice, because playback is several times faster than the cut; and all would take twelve times as long)."""
EVERY = 100  # ours: recording then takes a few per mille of the time, with episodes of a thousand steps
_NAME = "episode-"  # of a recording's folder, before the number of its episode
_ONLY = np.zeros(1, np.int64)


def as_action(
    family: Family, controller: FeedController, command: FeedCommand, first_us: Sequence[float],
    now_us: Sequence[float], feed_um_s: float,
) -> NDArray[np.float32]:
    """Return the action, within -1..1, of a controller's command; raises `InputError` if there is no such action."""
    if family.action == "servo":
        low, high = family.servo_target_share
        entries = [2.0 * (target_share(controller) - low) / (high - low) - 1.0]
    elif family.action == "speed":
        entries = [command.feed_um_s / family.max_feed_um_s]
    else:
        entries = [(command.feed_um_s - feed_um_s) / family.max_change_um_s]
    on_us, period_us = (
        now if chosen is None else chosen
        for chosen, now in zip((command.t_on_us, command.t_period_us), now_us, strict=True)
    )
    octaves = {"on_time": math.log2(on_us / first_us[0]), "period": math.log2(period_us / first_us[1])}
    octaves["period_ratio"] = octaves["period"] - octaves["on_time"]
    if not family.knobs and any(octaves.values()):
        raise _has_no(controller, "turns the generator's knobs")
    entries += [octaves[name] / family.setting_octaves for name in family.knobs]
    if family.offset_um is not None:
        entries.append(command.offset_um / family.offset_um)
    elif command.offset_um:
        raise _has_no(controller, "commands an offset")
    return np.clip(np.array(entries, np.float32), -1.0, 1.0)


def check_acts(family: Family, name: str) -> None:
    """Raise `InputError`, before a controller acts, if its commands are not actions of the environment."""
    controller = from_text(name)
    if family.action == "servo":
        target_share(controller)
    usual, commands = Machine.load(), rehearsed(lambda: from_text(name), family.greatest_feed_um_s)
    settings_us = {each_us for command in commands for each_us in (command.t_on_us, command.t_period_us)}
    if not family.knobs and not settings_us <= {None, usual.t_on_us, usual.t_period_us}:
        raise _has_no(controller, "turns the generator's knobs")
    if family.offset_um is None and any(command.offset_um for command in commands):
        raise _has_no(controller, "commands an offset")


def _has_no(controller: FeedController, what: str) -> InputError:
    return InputError(f"{controller.name} {what}, and this environment has none: leave it out")


def target_share(controller: FeedController) -> float:
    """Return a controller's target share of open pulses; raises `InputError` if it has none."""
    target: float | None = getattr(controller, "open_target_share", None)
    if target is None:
        raise InputError(f"{controller.name} holds no share of open pulses: the environment's servo asks for one")
    return target


class AttachedController:
    """A feed controller that receives every window until `stop`; the caller decides whether to run its commands."""

    def __init__(self, sub_envs: SubEnvs, index: int, controller: FeedController) -> None:
        self._sub_envs, self._index, self._controller = sub_envs, index, check_is_controller(controller)
        # checked once, because the check takes a tenth of a window's time
        self._seer = controller if isinstance(controller, SeesTruth) else None
        self._leg = self._lost = 0
        self.latest = FeedCommand(0.0)  # its command after the last window, for that leg and wire
        sub_envs.watchers.append((index, self._see))

    def stop(self) -> None:
        """Detach the controller."""
        self._sub_envs.watchers.remove((self._index, self._see))

    @property
    def _family(self) -> Family:
        return self._sub_envs.families[self._index]

    def begin(self) -> FeedCommand:
        """Begin the leg that the sub-environment is on; returns the command for its first window."""
        sub_envs, index = self._sub_envs, self._index
        scenario = sub_envs.scenario(index)
        self._leg, self._lost = sub_envs.leg[index], int(sub_envs.rows[index]["wires_lost"])
        start_um = float(sub_envs.rows[index]["before_um"])
        set_up_controller(self._controller, scenario.machine, scenario.legs_um[self._leg], start_um)
        self._take(self._controller.reset(self._family.greatest_feed_um_s))
        return self.latest

    def command(self) -> FeedCommand:
        """Return its command for the next window, which may be the first of a leg or wire."""
        sub_envs, index = self._sub_envs, self._index
        if self._leg != sub_envs.leg[index]:
            return self.begin()
        if self._lost != sub_envs.rows[index]["wires_lost"]:
            self._lost = int(sub_envs.rows[index]["wires_lost"])
            self._take(next_wire(self._controller, self._family.greatest_feed_um_s))
        return self.latest

    def action(self) -> NDArray[np.float32]:
        """Return the environment's action with the same command: see `as_action`."""
        row, machine = self._sub_envs.rows[self._index], self._sub_envs.scenario(self._index).machine
        first_us = machine.t_on_us, machine.t_period_us
        now_us, feed_um_s = row["setting_us"].tolist(), float(row["feed_um_s"])
        return as_action(self._family, self._controller, self.command(), first_us, now_us, feed_um_s)

    def _see(self) -> None:
        """Pass the sub-environment's last window to the controller."""
        self.command()  # the window before may have ended a leg or wire
        window = self._sub_envs.fleet.plants[self._index].window()
        if window.pulses != WINDOW_PULSES:
            return
        if self._seer is not None:
            self._seer.see(window)
        self._take(self._controller.update(self._sub_envs.observation(self._index)))

    def _take(self, command: FeedCommand) -> None:
        self.latest = check_command(self._controller.name, command)


class EpisodeRecorder:
    """Records the episode that a sub-environment has just begun, until `stop`, without changing it."""

    def __init__(self, sub_envs: SubEnvs, index: int, actions: Sequence[str] | None) -> None:
        plant, own = sub_envs.fleet.plants[index], sub_envs.families[index].action_names
        size = plant.resolution
        self._sub_envs, self._index, self._actions = sub_envs, index, tuple(own if actions is None else actions)
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
        """Stop recording."""
        watchers, own = self._sub_envs.watchers, (self._index, self._window)
        if own in watchers:  # a copy has none: see `SubEnvs.watchers`
            watchers.remove(own)

    def _window(self) -> None:
        """Record the sub-environment's last window."""
        here, fleet, rows = self._index, self._sub_envs.fleet, self._sub_envs.rows
        leg, plant = self._sub_envs.leg[here], fleet.plants[here]
        # as bytes, because reading the records takes a tenth of a step's time; `write` reads them
        window, row, state = (record.tobytes() for record in self._records)
        self._windows.append((window, row, state))
        if self._leg != leg:
            self._leg, points_um = leg, self._sub_envs.scenario(here).legs_um[leg]
            self._closeups.leg(np.rint(points_um).astype(np.int64), float(rows[here]["before_um"]))
        if len(self._windows) % CLOSEUP_EVERY == 1 or self._causes[here] != path_follower.RUNNING:
            result = _cycle_result(window, row)[0]._replace(opposite=plant.opposite_pulses())
            self._closeups.window(result, plant)

    def _table(self) -> WindowTable:
        table = WindowTable()
        plant = self._sub_envs.fleet.plants[self._index]
        for window_bytes, row_bytes, state_bytes in self._windows:
            state = np.frombuffer(state_bytes, STATE)[0]
            result, setting_us = _cycle_result(window_bytes, row_bytes)
            commanded_um, following_um = state["commanded_um"][:2].tolist(), plant.following_error_in_um(state)
            table.append(row_of(result, commanded_um, following_um, setting_us))
        return table

    def step(
        self, action: Sequence[float], terms: Mapping[str, float], cost: float, error_um: float, area_mm2: float
    ) -> None:
        """Record a step that has just ended; cost, error and area as in ``info``."""
        self._steps.append((*action, *(terms[name] for name in reward.TERMS), cost, error_um, area_mm2))
        self._rows.append(len(self._windows) - 1)

    def write(self, file: Path, title: str, settings: Mapping[str, Any], outcome: str | None = None) -> None:
        """Write the recording of the episode so far, before another begins; its report has the `settings`."""
        from edmsim.envs.render import scene_of
        from edmsim.metrology.profile import error_stats
        from edmsim.recording.rerun.write import COST, RETURN, TOTAL, steps_of, write_recording

        file.parent.mkdir(parents=True, exist_ok=True)
        machine, plant = self._sub_envs.scenario(self._index).machine, self._sub_envs.fleet.plants[self._index]
        scene, table = scene_of(self._sub_envs, self._index), self._table()
        rows, widths = table.rows, (len(self._actions), len(reward.TERMS), 1, 1, 1)
        steps = np.array(self._steps, np.float64).reshape(len(self._steps), sum(widths))
        actions, rewards, cost, error_um, _ = np.split(steps, np.cumsum(widths)[:-1], axis=1)
        groups = [
            ("action", "actions, as given", self._actions, actions),
            ("reward", "terms of the reward, per step", reward.TERMS, rewards),
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
            self._report(settings, outcome or self._outcome(), error_stats(scene.known_errors()), rows), title,
            steps_of(groups, rows[self._rows, 0], rows[self._rows, -1], [note]),
        )

    def _outcome(self) -> str:
        cause = StopCause(int(self._sub_envs.rows[self._index]["cause"]))
        late = cause is StopCause.RUNNING and bool(self._sub_envs.out_of_time[self._index])
        return WORDS[StopCause.TIME_LIMIT if late else cause].report

    def _report(
        self, settings: Mapping[str, Any], outcome: str, errors: Mapping[str, Any], values: NDArray[Any]
    ) -> Report:
        """Return a report with those figures of a cut that an episode has."""
        row, scenario = self._sub_envs.rows[self._index], self._sub_envs.scenario(self._index)
        cutting_s = float(row["elapsed_ns"]) * 1e-9
        area_mm2 = sum(step[-1] for step in self._steps)
        return Report(
            outcome=outcome, machining_time_s=float(values[-1, 0]) if len(values) else 0.0,
            path_length_mm=float(values[:, -1].max()) * 1e-3 if len(values) else 0.0,
            cutting_rate_mm2_min=60.0 * area_mm2 / cutting_s if cutting_s else None,
            profile_error_um=ProfileErrors(**errors), seed=scenario.plant_seed, edmsim_version=__version__,
            settings={**settings, **{f"drawn {name}": value for name, value in scenario.drawn.items()}},
        )  # fmt: skip


def _cycle_result(window_bytes: bytes, row_bytes: bytes) -> tuple[CycleResult, tuple[float, float]]:
    """Return the cycle of a recorded window, and the generator's on-time and period in us."""
    window, row = read_window(memoryview(window_bytes)), np.frombuffer(row_bytes, path_follower.SUB_ENV)[0]
    on_us, period_us = row["setting_us"].tolist()
    path_um = float(row["before_um"] + row["path_um"])
    result = CycleResult(window, window.start_ns + window.duration_ns, float(row["feed_um_s"]), path_um)
    return result, (on_us, period_us)


def _scene_slice(sub_envs: SubEnvs, index: int) -> int:
    """Return the slice at half the least height, as `Scene.middle_slice` does: it has metal everywhere."""
    scenario, slices = sub_envs.scenario(index), sub_envs.fleet.plants[index].resolution.slices
    machine = scenario.machine
    lowest_mm = min([region.height_mm for region in scenario.stock.lower_regions], default=machine.height_mm)
    return middle_slice(lowest_mm, machine.height_mm, slices)


class RecordedEpisodes:
    """Every n-th episode in its own folder, shown at its end if live; `hint` says what to do without a viewer."""

    def __init__(self, folder: str | Path, every: int, hint: str | None) -> None:
        self._every = whole_from("every", every, 1)
        self.folders: list[Path] = []  # written so far
        self.recorder: EpisodeRecorder | None = None  # of the running episode, if it is recorded
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

    def end(self, settings: dict[str, Any]) -> None:
        """Stop recording, and write the recording if there is one."""
        recorder, self.recorder = self.recorder, None
        if recorder is None:
            return
        recorder.stop()
        if len(recorder) == 0:
            return
        name, episode = settings["environment"], settings["episode"]
        folder = self._folder / f"{_NAME}{episode:06d}"
        recorder.write(folder / RECORDING, f"{name}, episode {episode}", settings)
        self.folders.append(folder)
        if self._viewer is not None:
            self._viewer.show(folder / RECORDING)

    def close(self) -> None:
        """End a viewer in a page; the window of a viewer stays open."""
        if self._viewer is not None:
            self._viewer.close()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state of a copy, which has neither the running recording nor the viewer."""
        return {**self.__dict__, "recorder": None, "_viewer": None}


class StepResult(NamedTuple):
    """Result of a window."""

    observation: WindowObservation  # observation for the controller
    truth: PulseWindow  # true state of the gap, beyond what a real machine measures
    progress_um: float  # length of path cut in the window (see `path_follower.SUB_ENV`)
    area_mm2: float  # this length times the local height
    error_um: float  # distance of the wire's true position from the path
    near: bool  # whether the error counts: with ``near_corner_um`` only near corners
    cause: StopCause  # reason for the episode's end; `StopCause.RUNNING` if it has not ended
    refused: str | None  # reason why the generator refused the setting
    reward: float  # reward, cost: the environment's reward and cost for the window
    cost: float
    late: bool  # whether the episode's time is over

    @property
    def done(self) -> bool:
        """Whether the path's end was reached."""
        return self.cause is StopCause.FINISHED

    @property
    def broken(self) -> bool:
        """Whether the wire broke."""
        return self.cause is StopCause.WIRE_BREAK

    @property
    def limit(self) -> str | None:
        """Another reason for the stop, as in an environment's ``info``."""
        ended = self.over and not (self.done or self.broken)
        return WORDS[self.cause].info if ended else None

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.cause is not StopCause.RUNNING


class Task:
    """Run one episode at a time of an environment, bit for bit the same as with Gymnasium's API.

    Parameters
    ----------
    name : str or type
        ``"GapFeed"`` or ``"edmsim/GapFeed-v2"``, and so on; or your own family.
    **options
        Arguments of the environment (see `Family`). Those of action, decision and observation have no effect: a
        controller commands window by window, from a `WindowObservation`.

    Raises
    ------
    InputError
        If a name is unknown or a value cannot be used.

    Examples
    --------
    >>> import edmsim
    >>> task = Task("GapFeed", resolution="fast")
    >>> controller = edmsim.controllers.make("fixed", feed_um_s=20.0)
    >>> seen, command = task.reset(seed=1), controller.reset(task.max_feed_um_s)
    >>> result = task.advance(command.feed_um_s)
    >>> command = controller.update(result.observation)
    """

    def __init__(self, name: str | type[Family], **options: Any) -> None:
        self.family = make_family(name, **options)
        self.max_feed_um_s = self.family.greatest_feed_um_s
        self._sub_envs = SubEnvs(self.family, 1)
        family, self._account = self.family, reward.StepRewards(1)
        self._account.weigh(0, family.reward_weights, family.error_bound_um, family.energy_bound_mJ)
        self._random = np.random.Generator(np.random.PCG64())

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> WindowObservation:
        """Begin the episode of an environment reset with this seed and these options.

        Returns
        -------
        WindowObservation
            An empty one, without pulses.
        """
        checked = checked_options(options, ("machine",))
        if seed is not None:
            self._random = seeding.np_random(whole_from("seed", seed, 0))[0]
        self._sub_envs.begin(0, self.family.draw(self._random, checked.get("machine")))
        return WindowObservation(0.0, 0.0, 0, 0, 0.0, 0.0, math.nan, 0.0, 0.0)

    @property
    def scenario(self) -> Scenario:
        """The present episode: machine, stock, path, what was drawn.

        Raises
        ------
        InputError
            Before the first `reset`.
        """
        return self._sub_envs.scenario(0)

    @property
    def wires_lost(self) -> int:
        """Number of lost wires in the present episode."""
        return int(self._sub_envs.rows[0]["wires_lost"])

    @property
    def machine(self) -> Machine:
        """The set-up, with the generator's setting in force."""
        return self._sub_envs.fleet.plants[0].machine

    @property
    def plant(self) -> Plant:
        """The plant with the remaining metal; a controller must not read it."""
        return self._sub_envs.fleet.plants[0]

    @property
    def total_um(self) -> float:
        """Length of the whole path."""
        return float(self._sub_envs.rows[0]["total_um"])

    @property
    def path_um(self) -> float:
        """Path length the wire has travelled."""
        row = self._sub_envs.rows[0]
        return float(row["before_um"] + row["path_um"])

    @property
    def leg(self) -> tuple[int, float]:
        """Number of the leg the wire is on, from 0, and the length of the legs before it."""
        return self._sub_envs.leg[0], float(self._sub_envs.rows[0]["before_um"])

    @property
    def reward_terms(self) -> dict[str, float]:
        """Terms of the last window's reward by name."""
        return {name: float(values[0]) for name, values in self._account.terms.items()}

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Attach a feed controller to the episodes: see `AttachedController`."""
        return AttachedController(self._sub_envs, 0, controller)

    def recorder(self) -> EpisodeRecorder:
        """Return a recorder of the episode that has just begun; actions are the commands."""
        return EpisodeRecorder(self._sub_envs, 0, ("feed_um_s", "t_on_us", "t_period_us", "offset_um"))

    def advance(
        self, feed_um_s: float, t_on_us: float | None = None, t_period_us: float | None = None, offset_um: float = 0.0
    ) -> StepResult:
        """Run one window.

        Parameters
        ----------
        feed_um_s : float
            Speed along the path, negative backwards; clamped to `max_feed_um_s` in both directions.
        t_on_us, t_period_us : float, optional
            New setting of the generator, rounded to the knobs' detents; a refused setting has no effect.
        offset_um : float
            Offset of the guides to the left of the path.

        Raises
        ------
        InputError
            If a feed, setting or offset is not a finite number, before `reset`, or after the episode's end.
        """
        self.scenario  # noqa: B018 - refuses to go on before the first reset
        sub_envs = self._sub_envs
        cause = StopCause(sub_envs.rows[0]["cause"])
        if cause is not StopCause.RUNNING:
            raise InputError(f"the episode has ended ({WORDS[cause].info}): call reset() first")
        feed_um_s, offset_um = finite("feed_um_s", feed_um_s), finite("offset_um", offset_um)
        t_on_us = None if t_on_us is None else finite("t_on_us", t_on_us)
        t_period_us = None if t_period_us is None else finite("t_period_us", t_period_us)
        sub_envs.refused[0] = ""
        if t_on_us is not None or t_period_us is not None:
            now = sub_envs.fleet.plants[0].machine
            on, period = (old if new is None else new
                          for new, old in ((t_on_us, now.t_on_us), (t_period_us, now.t_period_us)))
            sub_envs.set_generator(0, on, period)
        feed = min(max(feed_um_s, -self.max_feed_um_s), self.max_feed_um_s)
        sub_envs.rows[0]["offset_um"] = offset_um
        sub_envs.advance(_ONLY, np.array([feed]))
        return self._result()

    def _result(self) -> StepResult:
        sub_envs, plant = self._sub_envs, self._sub_envs.fleet.plants[0]
        window, row = plant.window(), sub_envs.rows[0]
        self._account.begin()
        self._account.add(_ONLY, sub_envs.rows, sub_envs.fleet.windows)
        account = self._account.rows[0]
        return StepResult(
            sub_envs.observation(0), window, float(row["progress_um"]), float(row["area_mm2"]),
            float(row["error_um"]), bool(row["near"]), StopCause(row["cause"]), sub_envs.refused[0] or None,
            float(account["total"]), float(account["cost"]), bool(sub_envs.out_of_time[0]),
        )
