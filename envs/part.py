"""Part: a whole part, cut rough and trimmed, where every pass is decided on once; and its page."""

from __future__ import annotations

from dataclasses import fields

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.batch import action_space_of, observation_space_of
from edmsim.envs.environment import EdmEnv
from edmsim.envs.page import arguments, joined, limits, own_sections, page_by, paragraph, parts, table
from edmsim.envs.part_task import ACTIONS, ENTRIES, Part

ENDS = {
    StopCause.FINISHED: "the part is cut",
    StopCause.WIRE_BREAK: "the last wire breaks",
    StopCause.LIMIT_SWITCH: "an end switch of the table opens",
    StopCause.PERSISTENT_SHORT: "the feed of a pass reports a persistent short",
    StopCause.OUT_OF_RANGE: "the wire leaves the range of the model",
}
"""What terminates an episode."""
_VALUES = {"time": "-w T / 1 min", "error": "-w e / 1 um", "roughness": "-w Ra / 1 um",
           "wire_break": "-w B H / 1 min", "limit": "-w L"}  # fmt: skip
_SYMBOLS = (
    ("T", "time of cutting in the step, without threading"),
    ("e", "error of the finished part, um: root mean square of the distance from the drawing\nto the wall, over the "
          "whole contour with its corners and over the height"),
    ("Ra", "roughness of its face, um, as in the report of a cut"),
    ("B, H", "wires that broke in the step, 0 or 1; time to thread another"),
    ("L", "1 in the step in which the last wire breaks or a limit ends the episode, else 0"),
)  # fmt: skip


def written(family: Part, particular: str) -> str:
    """Return the page of Part at its defaults, given what is particular to it."""
    summary, own = own_sections(particular)
    return joined(summary, {
        "Description": own["Description"],
        "Action space": _actions(family),
        "Observation space": _observations(family),
        "Reward": _rewards(family),
        "Starting state": own["Starting state"],
        "End of the episode": _ends(family),
        "Arguments": arguments(family),
        "Versions": own["Versions"],
    })  # fmt: skip


def _actions(family: Part) -> str:
    space = action_space_of(family)
    rows = (
        (str(k), name, limits(-1, 1), meaning, unit) for k, (name, (meaning, unit)) in enumerate(ACTIONS.items())
    )
    return parts(
        f"``Box(-1, 1, {space.shape}, float32)``: the settings of a pass relative to the technology, which is 0.",
        table(("Index", "Name", "Range", "Meaning", "Unit of 1"), rows),
        paragraph(
            "Actions beyond the range are clipped; NaN raises `InvalidAction`. A step is a pass. The passes of the "
            "tab belong to the last step and repeat the settings and offsets of the profile's passes. If a wire "
            "breaks, the step ends, and the next action applies to the rest of the pass: to set-point, pause and "
            "on-time, but not to the offset.",
        ),
        paragraph(
            "The offset is rounded to 1 um and clamped to that of the pass before: a trim runs nearer to the part. "
            "If the generator refuses a setting, the technology's pause replaces it, or else its pulses, and "
            '``info["refused"]`` has the reason.',
        ),
    )


def _observations(family: Part) -> str:
    rows = (
        (str(k), one.name, limits(one.low, one.high), one.quantity, one.divisor) for k, one in enumerate(ENTRIES)
    )
    return parts(
        f"``Box({observation_space_of(family).shape}, float32)``: what a machine and a gauge can measure and an "
        "operator knows. Every entry is clipped to its range.",
        table(("Index", "Name", "Range", "Quantity", "Divided by"), rows),
        paragraph(
            "The entries up to the last action's are of the last step, and 0 before the first. After a pass of the "
            "profile its wall is measured on straight stretches 0.4 mm from corners and ends, with an error of "
            "``gauge_um``. The target for the metal left follows from the technology's offsets.",
        ),
    )


def _rewards(family: Part) -> str:
    weights = family.reward_weights
    rows = ((f.name, f"``{_VALUES[f.name]}``", f"{getattr(weights, f.name):g}") for f in fields(weights))
    return parts(
        'The sum of the terms in ``info["reward_terms"]``, with weights w of `PartWeights`, where',
        table(("Symbol", "Meaning"), _SYMBOLS),
        "and",
        table(("Term", "Value", "Weight"), rows),
        paragraph(
            "Error and roughness cost in the step that finishes the part. "
            '``info["cost"]`` is 1 for a lost wire and for an end by a limit.',
        ),
    )


def _ends(family: Part) -> str:
    causes = "; ".join(f"{when} (``{WORDS[cause].info}``)" for cause, when in ENDS.items())
    return parts(
        paragraph(
            f"A broken wire is replaced where it broke; there are {family.wires} wires in all (``wires``)."
        ),
        paragraph(f'Terminated, with the reason in ``info["cause"]``: {causes}.'),
        paragraph(
            f"Truncated after {family.episode_s:g} s of cutting (``episode_s``), even within a pass; "
            '``info["dt_s"]`` is the machine time of a step.'
        ),
    )


@page_by(written)
class PartEnv(EdmEnv):
    """A whole part, cut rough and trimmed: decide on every pass, to save time, error and roughness.

    Description
    -----------
    A shop cuts a contour rough and then trims it in the same kerf, with settings from a technology that is the same
    for every machine. But machines differ, and so does the metal that a pass leaves. Here an action decides on one
    pass, after the wall of the pass before was measured: it changes set-point, pause, on-time and offset relative to
    the technology. With actions of 0 the cut equals ``edmsim cut --passes`` bit for bit, if tension and constants
    are not drawn.

    Starting state
    --------------
    The wire is in the start hole. Height, tension and constants of the machine are drawn uniformly within their
    ranges, and so is the plant's seed; the program has no random draws.

    Versions
    --------
    v0: the first.
    """

    task = Part
