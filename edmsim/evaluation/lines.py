"""Reference lines of a task: the controllers of the scores 0 and 1, and those that the oracle tries.

Controllers have their names of the command line (`edmsim.controllers.from_text`). Those of score 0, and settings of
references, were chosen on machines drawn with seeds below the held-back ones:

- ThinWire: the fastest of seven periods at which no wire broke on 24 machines (100 to 123), and of five settings of
  `climb` the one that earned most on them.
- MaxRate: the law's default of 40 us, at which no wire broke on 24 (1 to 24), as at 35, 45, 50 and 60 us.
- MaxRateShift: 0 is the return of MaxRate's best law, `heat-flux`, and 1 that of the best law that finds the wires'
  limits, `adaptive-hold`.
- ThinWireShift: 0 is the return of ThinWire's constant, and 1 that of its best law, `climb`. Some of the wires of
  shifts break before they boil, hence `heat-oracle` is not an upper bound.
- Corner: of eight pairs of on-time and period the one that earned most on 48 (200 to 247), and at this pair six
  tenths of the pulses open: of five targets it earned as much as half (487 and 492), and more than the others. The
  reference cuts with that constant's setting, and averages the bend it sees over 0.02 s; three longer times, up to
  0.25 s, earned the same within 0.5 % on the same 48.
- Trim: the constant that earned most on 48 (100 to 147), of 18 pairs of feed and offset.
- Part: the technology's settings, and as reference a law, as rehearsals of parts take long. The other constant earned
  most on three (100 to 102), of three; the numbers of the law are fits by hand to six (100 to 105).

`docs/make/lines.py` makes these cuts.
"""

from typing import NamedTuple

from edmsim.controllers import OF_A_TASK, SAME_LAW, names
from edmsim.envs.registry import base_of, find

ORACLE_GAPS_UM = (6.0, 10.0, 13.0, 16.0, 20.0, 26.0)
"""Gaps the oracle rehearses a cut with (ours: from shorts all the time to a wide gap)."""


class Lines(NamedTuple):
    """Reference lines of a task."""

    blind: str  # blind, reference: the controllers whose returns are scores of 0 and of 1
    reference: str
    rehearsed: tuple[str, ...]  # `oracle` makes every cut with each of these, and the one that earns most counts
    compared: tuple[str, ...]  # controllers compared where none is named


USUAL = Lines(
    "fixed", "oracle", tuple(f"oracle:gap_target_um={gap:g}" for gap in ORACLE_GAPS_UM),
    tuple(name for name in names() if name not in (*SAME_LAW, *OF_A_TASK)),
)  # fmt: skip
_GAP = "set-point:open_target_share=0.05"
_THIN_ADAPTIVE = (
    "adaptive-hold:open_target_share=0.05,proportional_um_s=10,integral_um_s2=30,period_us=100,shortest_us=12,"
    "longest_us=300,limit_share=0.27,limit_spread=0.6,recovery_s=0,retract_feed_um_s=20"
)
_CLIMB = "climb:open_target_share=0.05"
_PULSES = "on_factor=1,period_factor=0.7"
_STEADY = f"open_target_share=0.6,{_PULSES}"
_AT_CORNERS = f"open_target_share=0.4,{_PULSES},before_um=20,behind_um=100,corner_factor=2"
OF_TASK = {
    "ThinWire": Lines(
        f"{_GAP},period_factor=1.4", "oracle",
        tuple(f"{_GAP},period_factor={factor:g}" for factor in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)),
        (*(f"{_GAP},period_factor={factor:g}" for factor in (0.7, 0.35)), f"{_CLIMB},climb_s=2.5"),
    ),
    "MaxRate": Lines(
        "fixed-period", "heat-oracle", USUAL.rehearsed, ("fixed-period", "sato", "heat-flux", "heat-oracle"),
    ),
    "MaxRateShift": Lines("heat-flux", "adaptive-hold", USUAL.rehearsed, ("heat-flux", "adaptive-hold")),
    "ThinWireShift": Lines(
        f"{_GAP},period_factor=1.4", _CLIMB, USUAL.rehearsed,
        (f"{_GAP},period_factor=1.4", _CLIMB, _THIN_ADAPTIVE),
    ),
    "Corner": Lines(
        f"set-point:{_STEADY}", f"lead-oracle:{_STEADY},average_s=0.02",
        USUAL.rehearsed,
        (
            "voltage", f"set-point:open_target_share=0.3,{_PULSES}", f"set-point:{_AT_CORNERS}",
            f"set-point:{_STEADY},pull_N_m=-0.5,fade_um=50",
        ),
    ),
    "Trim": Lines(
        "fixed:feed_um_s=200,offset_um=-2", "oracle",
        tuple(f"fixed:feed_um_s={feed},offset_um={off}" for feed in (50, 100, 200) for off in (-8, -4, 0, 4)),
        (
            "fixed:feed_um_s=100", "fixed:feed_um_s=200",
            "set-point:open_target_share=0.4,proportional_um_s=200,integral_um_s2=400,offset_um=-2",
        ),
    ),
    "Part": Lines(
        "technology", "corrected",
        ("corrected", "corrected:offset=0.2", "corrected:offset=-0.2", "corrected:fast=0"),
        ("constant:set_point=0.7",),
    ),
}
"""Lines of the tasks that have other ones than `USUAL`."""


def lines_of(env_id: str) -> Lines:
    """Return the lines of an environment; a user's has those of the one of edmsim that it derives from."""
    return OF_TASK.get(base_of(find(env_id)[0]), USUAL)
