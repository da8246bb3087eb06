"""Why rows of the validation fail, in a sentence each: what a theory page explains at length."""

from __future__ import annotations

from edmsim.validation.rows import Row

REASONS = {
    ("ignition", "two-regimes"):
        "Two studies of one group disagree below 12 um. The model follows the later one, in which narrow gaps ignite "
        "much faster.",
    ("ignition", "flow"):
        "Where two jets meet at mid-height the water of the model does not move, and the slices there ignite as "
        "before.",
    ("crater", "shape-of-a-crater"):
        "The published depth contradicts the area and volume published with it, which imply 8.3 um. It is probably a "
        "misprint.",
    ("film", "the-film-of-water"):
        "To save time, a slice's own film is followed only where its front gap is under 12 um. This is what that "
        "costs.",
    ("pulse ratios", "classes-of-pulses"):
        "Most shorts of these cuts come from the wire's swing. A shorter on-time closes the gap, but its weaker "
        "pulses also swing the wire less.",
    ("shorts", "classes-of-pulses"):
        "A short carries a fifth of a discharge's current on that generator and warms the wire little, so that many "
        "shorts cost less than practice says.",
    ("debris", "debris-and-flushing"):
        "In the model bubbles clear the gap of debris. So little of it is left that none bridges the gap, and more "
        "discharges clear it faster.",
    ("lag", "lag"):
        "In tool steel the magnetic pull of the current nearly cancels the push of the discharges, so the wire lags "
        "less than practice reports.",
    ("rupture", "wire-rupture"):
        "The wire's vibration decides when it breaks here, and scatters more than a nozzle or the tension changes.",
    ("vibration", "vibration"):
        "Flowing water puts no mean force on the wire of the model, and the terms of a running string are left out "
        "as negligible.",
}  # fmt: skip
"""One sentence or two by topic and by the heading of the page that a row's `note` leads to."""


def reason(row: Row) -> str:
    """Return why a row fails, as short as can be; empty where nobody knows."""
    return REASONS.get((row.topic, row.note.partition("#")[2]), "")
