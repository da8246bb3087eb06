"""Pages of the environments: docstrings of their classes, with tables made from the declarations in the code.

>>> print(table(("Name", "Unit"), [("feed", "um/s"), ("wires", "")]))
=====  ====
Name   Unit
=====  ====
feed   um/s
wires
=====  ====
"""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from textwrap import fill
from typing import Any, TypeVar

from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.envs import observation, path_follower, registry, reward, sub_envs
from edmsim.envs.arguments import arguments_of
from edmsim.envs.task import KNOBS, EnvArguments, Family
from edmsim.geometry import CORNER_DEG
from edmsim.plant.kernel.discharge import PLACE_SD_UM

_Class = TypeVar("_Class", bound=type)

WIDTH = 114  # characters of a line: those of a docstring in a class, without its indent
TARGET = "target of the servo: share of open less short pulses"
FIRST = {
    "change": ("change of the feed along the path", "``max_change_um_s``"),
    "speed": ("feed along the path", "``max_feed_um_s``"),
    "servo": (TARGET, "``servo_target_share``"),
}
"""Meaning and unit of entry 0 of an action, by the argument ``action``."""
DOES = {
    "change": "changes the feed by up to ``max_change_um_s``",
    "speed": "is the feed, in units of ``max_feed_um_s``",
    "servo": f"is the {TARGET}, from ``servo_target_share[0]`` at -1 to ``servo_target_share[1]`` at 1",
}
"""What entry 0 of an action does, by the argument ``action``."""
REFERENCE = f"{reward.REFERENCE_S * 1e3:g} ms"
VALUES = {
    "progress": "w P", "short": "-w s T", "open": "-w o T", "profile": f"-w (e / {reward.ERROR_UM:g} um) P",
    "roughness": "-w g P", "time": "-w T", "wire_break": "-w B H", "limit": "-w L H", "done": "w D",
}  # fmt: skip
"""Terms of the reward in the symbols of `symbols`."""
ENDS = {
    StopCause.FINISHED: "the end of the path is reached",
    StopCause.WIRE_BREAK: "the last wire breaks",
    StopCause.LIMIT_SWITCH: "an end switch of the table opens",
    StopCause.PERSISTENT_SHORT:
        f"{path_follower.SHORTED_S:g} s of windows with {path_follower.SHORTED_SHARE * 100:g} % shorts or more",
    StopCause.OUT_OF_RANGE: "the wire leaves the range of the model",
}
"""What terminates an episode."""
VERSIONS = (
    "v0: the first.",
    """\
v1: debris ignites the gap, jets bend the wire, and water carries heat and gas away behind it. v0 is withdrawn.""",
    """\
v1: a lost wire costs what the machine loses while another is threaded; episodes end by machine time; a settling
wire earns nothing; the operator's settings are observed and not drawn.
v2: debris ignites the gap, jets bend the wire, and water carries heat and gas away behind it. v0 and v1 are
withdrawn.""",
)
"""Default text about versions, by an environment's latest version: 0, 1 or 2."""


def page(env: _Class) -> _Class:
    """Complete the docstring of an environment's class, which has only what is particular to it, under headings."""
    return page_by(written)(env)


def page_by(write: Callable[[Any, str], str]) -> Callable[[_Class], _Class]:
    """Return a decorator that completes such a docstring by `write`, from the environment's default arguments."""

    def complete(env: _Class) -> _Class:
        if env.__doc__ is not None:  # it is None with python -OO
            env.__doc__ = _Page(env.task, env.__doc__, write)  # type: ignore[attr-defined, assignment]
        return env

    return complete


class _Page:
    """A docstring that is written at its first use, because it needs a machine, which an import should not load."""

    def __init__(self, kind: type[EnvArguments], particular: str, write: Callable[[Any, str], str]) -> None:
        self._kind, self._particular, self._write = kind, particular, write

    def __get__(self, env: object, kind: type) -> str:
        return self.text

    @cached_property
    def text(self) -> str:
        return self._write(self._kind(), inspect.cleandoc(self._particular))


def written(family: Family, particular: str) -> str:
    """Return the page of a family with default arguments, completed from the text that is particular to it."""
    summary, own = own_sections(particular)
    version = int(registry.env_id_of(type(family).__name__).rpartition("v")[2])
    sections = {
        "Description": own.pop("Description"),
        "Action space": actions(family, own.pop("Action space", "")),
        "Observation space": observations(family, own.pop("Observation space", "")),
        "Reward": rewards(family, own.pop("Reward", "")),
        "Starting state": start(family, own.pop("Starting state")),
        "End of the episode": ends(family),
        "Arguments": arguments(family),
        "Versions": own.pop("Versions", "") or VERSIONS[version],
    }
    assert not own, f"a page has no sections {', '.join(own)}"
    return joined(summary, sections)


def own_sections(particular: str) -> tuple[str, dict[str, str]]:
    """Return the summary of a docstring, and its sections by their titles."""
    summary, *found = re.split(r"^(\w[\w ]*)\n-+\n", particular, flags=re.MULTILINE)
    return summary.strip(), {title: text.strip() for title, text in zip(found[::2], found[1::2], strict=True)}


def joined(summary: str, sections: Mapping[str, str]) -> str:
    """Return a docstring of a summary and sections."""
    return "\n\n".join([summary, *(f"{name}\n{'-' * len(name)}\n{text}" for name, text in sections.items())])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of reStructuredText; the last cell of a row may have several lines."""
    lines = [list(head)]
    for *cells, last in rows:
        first_line, *further = last.split("\n")
        lines += [[*cells, first_line], *([*[""] * len(cells), line] for line in further)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    edge = "  ".join("=" * width for width in widths)
    first, *others = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    ]
    return "\n".join([edge, first, edge, *others, edge])


def paragraph(*sentences: str) -> str:
    """Return sentences as a paragraph; empty ones are left out."""
    text = " ".join(" ".join(sentence.split()) for sentence in sentences if sentence)
    return fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def parts(*paragraphs: str) -> str:
    """Return paragraphs and tables one below the other; empty ones are left out."""
    return "\n\n".join(text for text in paragraphs if text)


def limits(low: float, high: float) -> str:
    """Return a range as a table shows it."""
    return f"{low:g}..{high:g}"


def actions(family: Family, particular: str) -> str:
    """Return the section on actions."""
    known = {
        family.action_names[0]: FIRST[family.action],
        **{name: (f"{meaning}, log2", "``setting_octaves``") for name, meaning in KNOBS.items()},
        "offset": ("offset from the path, left positive", "``offset_um``"),
    }
    rows = [
        (str(k), name, limits(-1, 1), *known[name]) for k, name in enumerate(family.action_names)
    ]
    one, other = (name for name in DOES if name != family.action)
    on_us, period_us = family.detents_us
    return parts(
        f"``Box(-1, 1, ({len(rows)},), float32)``.",
        table(("Index", "Name", "Range", "Meaning", "Unit of 1"), rows),
        paragraph(
            "Entry 0 is ``servo_target_share[0]`` at -1 and ``servo_target_share[1]`` at 1; the servo sets the feed "
            "window by window." if family.action == "servo" else "",
            f'With ``action="{one}"`` entry 0 {DOES[one]}; with ``action="{other}"`` it {DOES[other]}.',
            "A negative feed runs back along the path, but not beyond its start.",
            "An action holds for ``decision_s``." if family.decision_s is not None else "",
            "Actions beyond the range are clipped; NaN raises `InvalidAction`.",
        ),
        paragraph(
            f"On-time and period are rounded to {on_us:g} us and {period_us:g} us. If the generator refuses a period "
            "(above its mean current, or no pause), the shortest one that it accepts for that on-time is set, and "
            '``info["refused"]`` has the reason.' if family.knobs else "",
            f"The guides move to the offset by one motor step of {family.base.base.table.step_um.value:g} um per "
            "axis and window." if family.offset_um is not None else "",
            particular,
        ),
    )  # fmt: skip


def observations(family: Family, particular: str) -> str:
    """Return the section on observations."""
    listed = family.entries()
    at = {entry.name: k for k, entry in enumerate(listed)}
    of_last = len(family.step_entries)
    of_steps = of_last * family.history

    def span(entries: Sequence[observation.Entry]) -> str:
        return f"Entries {at[entries[0].name]} to {at[entries[-1].name]}"

    return parts(
        f"``Box(({len(listed)},), float32)``: what a machine can measure and its operator knows. "
        "Every entry is clipped to its range.",
        table(("Index", "Name", "Range", "Quantity", "Divided by"), (
            (str(k), entry.name, limits(entry.low, entry.high), entry.quantity, entry.divisor)
            for k, entry in enumerate(listed) if not of_last <= k < of_steps
        )),
        paragraph(
            f"Entries 0 to {of_last - 1} are of the last step; {of_last} to {of_steps - 1} are the same of the "
            f"{family.history - 1} steps before, the latest first, and 0 before the first window. ``history`` sets "
            "the number of steps.",
            f"{span(observation.SETUP_ENTRIES)} are the operator's settings.",
            "Fifths are of the greatest height, and a discharge is located with an error of "
            f"{PLACE_SD_UM * 1e-3:g} mm (standard deviation)." if family.locates_discharges else "",
            f"{span(observation.CORNERS)} come from the program; a corner turns by {CORNER_DEG:g} degrees or more."
            if family.knows_corners else "",
            f"Entry {at['offset']} is that of the last action." if "offset" in at else "",
            f"{span(observation.WIRES)} are the history of the wires; the last is 0 before the first break."
            if family.knows_wires else "",
            particular,
        ),
    )  # fmt: skip


def symbols(family: Family) -> list[tuple[str, str]]:
    """Return the symbols in the reward's terms, each with its meaning."""
    error = "distance of the wire's true position from the path, um"
    if family.finishes_wall:
        error = (
            "distance of the finished wall from its target, um, root mean square over\n"
            f"the height and {sub_envs.STRETCH_UM:g} um of its length; 0 before there is any"
        )
    elif family.near_corner_um is not None:
        error += "; 0 if no corner is\nwithin ``near_corner_um`` of path"
    threading_s = family.base.base.table.threading_s.value
    return [
        ("P", f"area cut in the step / {reward.REFERENCE_MM2:g} mm2, which is {reward.REFERENCE_MM2_MIN:g} mm2/min "
              f"for {REFERENCE}"),
        ("T", f"duration of the step / {REFERENCE}, the window of 255 pulses of 100 us"),
        ("s, o", "shares of short and of open pulses"),
        ("e", error),
        ("g", "excess of a discharge's energy over ``energy_bound_mJ``, divided by it; else 0"),
        ("B", "wires that broke in the step, 0 or 1"),
        ("L", "1 in the step in which another limit ends the episode, else 0"),
        ("D", "1 in the step in which the end of the path is reached, else 0"),
        ("H", f"time to thread another wire / {REFERENCE}: {threading_s / reward.REFERENCE_S:,.0f} for "
              f"{threading_s:g} s"),
    ]  # fmt: skip


def rewards(family: Family, particular: str) -> str:
    """Return the section on the reward."""
    weights = family.reward_weights
    lost_mm2_min = weights.wire_break * reward.REFERENCE_MM2_MIN
    return parts(
        'The sum of the terms in ``info["reward_terms"]``, with weights w of `Weights`, where',
        table(("Symbol", "Meaning"), symbols(family)),
        "and",
        table(("Term", "Value", "Weight"), (
            (f.name, f"``{VALUES[f.name]}``", f"{getattr(weights, f.name):g}") for f in fields(weights)
        )),
        paragraph(
            "Area is length of path times local height. The length follows the wire's true position, weighted by the "
            "share of pulses that ignite. So pushing a bent wire into a short, moving back and forth, or cutting air "
            "earns nothing. "
            f"The first {path_follower.SETTLING_NS * 1e-9:g} s of a wire do not count, as the field then pulls it "
            "towards the metal.",
            f"A lost wire costs the area that {lost_mm2_min:g} mm2/min would cut while another is threaded."
            if lost_mm2_min > 0.0 else "A lost wire costs only the time in which another is threaded.",
            '``info["cost"]`` is 1 for a lost wire or an end by a limit, and grows by 1 for every second beyond a '
            "bound.",
            "The error e is that of the table's true position plus the wire's mean deflection over height and "
            "window. It leaves out changes of the side gap, as it takes too long to measure the kerf's edge."
            if weights.profile > 0.0 and not family.finishes_wall else "",
            particular,
        ),
    )  # fmt: skip


def start(family: Family, particular: str) -> str:
    """Return the section on the starting state."""
    feed = {
        "change": 'The feed is ``start_feed_um_s``, or 0 with ``action="speed"``, and the observation 0.',
        "speed": "The wire rests, and the observation is 0.",
        "servo": "The feed is ``start_feed_um_s``, and the observation 0.",
    }
    base = family.base
    return paragraph(
        particular,
        f"The generator has the machine's setting, {base.t_on_us:g} us in {base.t_period_us:g} us."
        if family.knobs else "",
        "Machine, height, tension and material are drawn from the ranges in the arguments, and so is the "
        "plant's seed.",
        feed[family.action],
        '``info["drawn"]`` has the drawn values.',
    )  # fmt: skip


def ends(family: Family) -> str:
    """Return the section on what ends an episode."""
    causes = "; ".join(f"{when} (``{WORDS[cause].info}``)" for cause, when in ENDS.items())
    return parts(
        paragraph(
            "A broken wire is replaced where it broke; the servo starts again, and the generator returns to its "
            f"first setting. There are {family.wires} wires in all (``wires``)."
        ) if family.wires > 1 else "",
        paragraph(f'Terminated, with the reason in ``info["cause"]``: {causes}.'),
        paragraph(
            f"Truncated after {family.episode_s:g} s of {'machine time' if family.counts_threading else 'cutting'} "
            '(``episode_s``); ``info["dt_s"]`` is the machine time of a step.'
        ),
    )  # fmt: skip


def arguments(family: EnvArguments) -> str:
    """Return the section on arguments: the family's own before the common ones."""
    common = [f.name for f in fields(Family)]
    listed = sorted(arguments_of(type(family)), key=lambda f: f.name in common)  # sorted() keeps the order of equals
    rows = [(f.name, f"``{f.default!r}``".replace("'", '"'), f.unit, f.meaning) for f in listed]
    rows.append(("render_mode", "``None``", "", '``"rgb_array"`` or ``"human"``'))
    return table(("Name", "Default", "Unit", "Meaning"), rows)
