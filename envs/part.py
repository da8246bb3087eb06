"""Part: a whole part, cut rough and trimmed, with a decision on every pass; and its page."""

from dataclasses import fields

from edmsim.envs.environment import EdmEnv
from edmsim.envs.page import arguments, limits, page_by, table
from edmsim.envs.part_task import ACTIONS, ENTRIES, Part

_VALUES = {"time": "-w T / 1 min", "error": "-w e / 1 um", "roughness": "-w Ra / 1 um",
           "wire_break": "-w B H / 1 min", "limit": "-w L"}  # fmt: skip


def written(family: Part, page: str) -> str:
    """Return the page of Part with its tables."""
    actions = ((str(k), name, limits(-1, 1), *ACTIONS[name]) for k, name in enumerate(ACTIONS))
    observations = (
        (str(k), one.name, limits(one.low, one.high), one.quantity, one.divisor) for k, one in enumerate(ENTRIES)
    )
    weights = family.reward_weights
    terms = ((f.name, f"``{_VALUES[f.name]}``", f"{getattr(weights, f.name):g}") for f in fields(weights))
    return page.format(
        actions=table(("Index", "Name", "Range", "Meaning", "Unit of 1"), actions),
        observations=table(("Index", "Name", "Range", "Quantity", "Divided by"), observations),
        terms=table(("Term", "Value", "Weight"), terms), arguments=arguments(family),
    )  # fmt: skip


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

    Action space
    ------------
    ``Box(-1, 1, (4,), float32)``: the settings of a pass relative to the technology, which is 0.

    {actions}

    Actions beyond the range are clipped; NaN raises `InvalidAction`. A step is a pass. The passes of the tab belong
    to the last step and repeat the settings and offsets of the profile's passes. If a wire breaks, the step ends, and
    the next action applies to the rest of the pass: to set-point, pause and on-time, but not to the offset.

    The offset is rounded to 1 um and clamped to that of the pass before: a trim runs nearer to the part. If the
    generator refuses a setting, the technology's pause replaces it, or else its pulses, and ``info["refused"]`` has
    the reason.

    Observation space
    -----------------
    ``Box((18,), float32)``: what a machine and a gauge can measure and an operator knows. Every entry is clipped to
    its range.

    {observations}

    The entries up to the last action's are of the last step, and 0 before the first. After a pass of the profile its
    wall is measured on straight stretches 0.4 mm from corners and ends, with an error of ``gauge_um``. The target for
    the metal left follows from the technology's offsets.

    Reward
    ------
    The sum of the terms in ``info["reward_terms"]``, with weights w of `PartWeights`, where

    ======  =================================================================================
    Symbol  Meaning
    ======  =================================================================================
    T       time of cutting in the step, without threading
    e       error of the finished part, um: root mean square of the distance from the drawing
            to the wall, over the whole contour with its corners and over the height
    Ra      roughness of its face, um, as in the report of a cut
    B, H    wires that broke in the step, 0 or 1; time to thread another
    L       1 in the step in which the last wire breaks or a limit ends the episode, else 0
    ======  =================================================================================

    and

    {terms}

    Error and roughness cost in the step that finishes the part. ``info["cost"]`` is 1 for a lost wire and for an end
    by a limit.

    Starting state
    --------------
    The wire is in the start hole. Height, tension and constants of the machine are drawn uniformly within their
    ranges, and so is the plant's seed; the program has no random draws.

    End of the episode
    ------------------
    A broken wire is replaced where it broke; there are 4 wires in all (``wires``).

    Terminated, with the reason in ``info["cause"]``: the part is cut (``done``); the last wire breaks
    (``wire-break``); an end switch of the table opens (``limit-switch``); the feed of a pass reports a persistent
    short (``persistent-short``); the wire leaves the range of the model (``out-of-range``).

    Truncated after 1800 s of cutting (``episode_s``), even within a pass; ``info["dt_s"]`` is the machine time of a
    step.

    Arguments
    ---------
    {arguments}

    Versions
    --------
    v0: the first.
    """

    task = Part
