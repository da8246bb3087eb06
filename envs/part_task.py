"""Part: machine, draws and reward of a part; actions and observations of every pass."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np

from edmsim.envs.arguments import MOST_TIME_S, Range, argument, check_kinds, ends_of, shows_arguments
from edmsim.envs.observation import Entry
from edmsim.envs.part_cut import PartCut
from edmsim.envs.reward import WeightsOfTerms
from edmsim.envs.scenario import names_of
from edmsim.envs.task import EnvArguments
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import values_of
from edmsim.machine.setting import check_height
from edmsim.machine.technology import Technology, machine_of, read_technology
from edmsim.numeric import above_zero, whole_within, within
from edmsim.plant.resolution import resolution
from edmsim.program.outline import Program
from edmsim.program.path import load_program

ACTIONS = {
    "set_point": ("share of open pulses of the rough pass, or feed of a trim, log2", "``set_point_octaves``"),
    "pause": ("pause between two pulses, log2", "``pause_octaves``"),
    "on_time": ("on-time, log2", "``on_time_octaves``"),
    "offset": ("offset from the drawing, um; above 0 farther from the part", "``offset_um``"),
}
"""Entries of an action with their meaning and the unit of 1; 0 is what the technology has."""
LEFT_UM = 20.0
"""Metal left beyond what is wanted that its entry shows as 1 (ours: five times the error of a part)."""
ENTRIES = (
    Entry("short", 0.0, 1.0, "short pulses", "pulses of the step"),
    Entry("open", 0.0, 1.0, "open pulses", "pulses of the step"),
    Entry("spark", 0.0, 1.0, "pulses that ignited", "pulses of the step"),
    Entry("mean_voltage", 0.0, 1.0, "mean gap voltage, V", "open voltage, V"),
    Entry("feed", -4.0, 4.0, "log2 of the mean feed over the technology's", "1"),
    Entry("left", -4.0, 4.0, "metal left by the pass, less what it is to leave, um", f"{LEFT_UM:g} um"),
    Entry("gauged", 0.0, 1.0, "1 if that was measured, else 0", "1"),
    Entry("broke", 0.0, 1.0, "1 if the step ended by a broken wire, else 0", "1"),
    *(Entry(f"last_{name}", -1.0, 1.0, f"entry {k} of the last action", "1") for k, name in enumerate(ACTIONS)),
    Entry("pass", 0.0, 1.0, "number of the pass that is decided on", "``passes``"),
    Entry("rest", 0.0, 1.0, "share of it that is to be cut", "1"),
    Entry("wires_lost", 0.0, 1.0, "wires that broke in the episode", "``wires``"),
    Entry("spent", 0.0, 1.0, "time of cutting, s", "``episode_s``"),
    Entry("height", 0.0, 8.0, "height of the workpiece, mm", "50 mm"),
    Entry("tension", 0.0, 4.0, "tension of the wire", "the technology's"),
)
"""Entries of an observation; the first eight, and the last action, are of the last step, 0 before there is one."""
TERMS = ("time", "error", "roughness", "wire_break", "limit")
"""Names of the reward's terms, in order: those of `PartWeights`."""
MOST_OFFSET_UM = 50.0
"""Greatest change of an offset (ours: what a trim takes)."""
MOST_OCTAVES = 2.0
"""Greatest reach of a factor (ours: beyond it the generator refuses most settings)."""


@dataclass(frozen=True, kw_only=True)
class PartWeights(WeightsOfTerms):
    """Weights of the terms of Part's reward, 0 or more; all are costs. The values are ours."""

    time: float = 1.0  # cost of a minute of cutting
    error: float = 1.0  # cost per um of the finished part's error, root mean square over its contour and height
    roughness: float = 5.0  # cost per um of Ra of its face
    wire_break: float = 1.0  # cost of a minute of threading
    limit: float = 50.0  # cost of an unfinished part: its last wire broke, or a limit ended it


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class Part(EnvArguments):
    """Machine, draws and reward of a part; the fields are the environment's arguments.

    Parameters
    ----------
    {arguments}

    Raises
    ------
    InputError
        If a value cannot be used.

    Notes
    -----
    `only_pass`: a reset cuts the earlier passes with the technology's values, which takes as long as cutting them in
    steps. The episode is that pass; the error is that of its wall.

    `randomise`: sections or constants of `Machine.sample`; ``()`` draws all constants that have a published range
    and an effect and are no dial of the operator (see `draws`).
    """

    resolution: str = argument("fast", "", "resolution of the plant: fast, default, fine")
    program: str | Path | None = argument(None, "", "G-code or DXF of a contour; None: a punch of 1.6 x 0.4 mm")
    technology: str | Path = argument("tool-steel-brass-254", "", "a name under models/technologies, or a file")
    passes: int = argument(4, "", "number of passes, rough and trims, 2 or more")
    only_pass: int | None = argument(None, "", "pass that is the episode; None: all passes")
    tab_mm: float = argument(0.6, "mm", "length of the edge that holds the part; 0: none")
    # ours: about the height of the shop's table, within what the technology is interpolated for
    height_mm: Range = argument((18.0, 36.0), "mm", "height, or (low, high)")
    tension_share: Range = argument((0.85, 1.05), "", "tension over the technology's, or (low, high)")  # ours
    randomise: Sequence[str] | None = argument((), "", "constants to draw; ``()`` for all, None for none")
    set_point_octaves: float = argument(1.0, "octaves", "reach of the set-points either way")
    pause_octaves: float = argument(2.0, "octaves", "reach of the pauses")
    on_time_octaves: float = argument(0.5, "octaves", "reach of the on-times")
    offset_um: float = argument(20.0, "um", "reach of the offsets")
    gauge_um: float = argument(1.0, "um", "standard error of the measurement of a wall")  # ours: a touch probe's
    wires: int = argument(4, "", "wires before a break ends the episode")
    episode_s: float = argument(1800.0, "s", "time of cutting after which an episode is truncated")
    weights: PartWeights | None = argument(None, "", "`PartWeights`, or a mapping of weights to change")
    objectives: Sequence[str] = argument((), "", "terms of a vector reward; ``()``: a scalar")
    cost_limit: float = argument(0.1, "", "limit of an episode's mean cost")  # ours: a break in ten parts

    own_weights: ClassVar[PartWeights] = PartWeights()
    lasting: ClassVar[tuple[str, ...]] = ("objectives",)

    def __post_init__(self) -> None:
        """Refuse what cannot be used, before anything is built."""
        check_kinds(self)
        resolution(self.resolution)
        whole_within("passes", self.passes, 2, 100)
        whole_within("wires", self.wires, 1, 10**9)
        if self.only_pass is not None:
            whole_within("only_pass", self.only_pass, 1, self.passes)
        for height in ends_of("height_mm", self.height_mm):
            check_height(height)
            self.cut_with.table(height, self.passes)
        within("tab_mm", self.tab_mm, 0.0, 100.0)
        for name in ("set_point_octaves", "pause_octaves", "on_time_octaves"):
            above_zero(name, getattr(self, name), MOST_OCTAVES)
        above_zero("offset_um", self.offset_um, MOST_OFFSET_UM)
        within("gauge_um", self.gauge_um, 0.0, MOST_OFFSET_UM)
        above_zero("episode_s", self.episode_s, MOST_TIME_S)
        self._check_reward(TERMS)
        self.drawn_constants  # noqa: B018 - refuses unknown names
        # what is drawn at most is refused here, and not at a reset
        heights, shares = (ends_of(name, getattr(self, name)) for name in ("height_mm", "tension_share"))
        PartCut(self.read, self._settings(heights[1], seed=0), shares[1], self.only_pass)

    @cached_property
    def cut_with(self) -> Technology:
        """The technology."""
        return read_technology(self.technology)

    @cached_property
    def read(self) -> Program:
        """The program."""
        if self.program is not None:
            return load_program(self.program)
        with resources.as_file(resources.files(__package__) / "small_part.ngc") as file:
            return load_program(file)

    @cached_property
    def base(self) -> Machine:
        """The machine with the setting of its rough pass, before anything is drawn."""
        own = self.cut_with
        height_mm = ends_of("height_mm", self.height_mm)[0]
        return machine_of(own.table(height_mm, 1).settings[0], own.machine, own.material, own.wire, height_mm)

    @cached_property
    def drawn_constants(self) -> tuple[str, ...]:
        """Names of the constants that an episode draws."""
        return names_of(self.base, self.randomise, "modal")

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return tuple(ACTIONS)

    def entries(self) -> list[Entry]:
        """Return every entry of an observation, in order."""
        return list(ENTRIES)

    def draw(self, rng: np.random.Generator, drawn: dict[str, float | str]) -> CutSettings:
        """Draw a machine and the plant's seed; returns the settings of its cut.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same settings.
        drawn : dict
            The drawn values are added by name.
        """
        for name in ("height_mm", "tension_share"):
            drawn[name] = float(rng.uniform(*ends_of(name, getattr(self, name))))
        height_mm = float(drawn["height_mm"])
        names, constants = self.drawn_constants, tuple[tuple[str, float], ...]()
        if names:
            values = values_of(self.base.sample(rng, names), names)
            drawn |= values
            constants = tuple(values.items())
        return self._settings(height_mm, int(rng.integers(2**62)), constants)

    def _settings(self, height_mm: float, seed: int, constants: tuple[tuple[str, float], ...] = ()) -> CutSettings:
        return CutSettings(
            passes=self.passes, technology=str(self.technology), material=self.cut_with.material, tab_mm=self.tab_mm,
            height_mm=height_mm, constants=constants, resolution=self.resolution, seed=seed,
        )  # fmt: skip
