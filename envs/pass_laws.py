"""Controllers for Part, which decide on passes: the technology's constants, other constants, a law, a policy.

They are named as on the command line: ``technology``, ``constant:pause=-0.5``, ``corrected``, ``policy:FILE``.
"""

from dataclasses import dataclass, fields
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from edmsim import user_code
from edmsim.envs.part_task import ACTIONS, ENTRIES, LEFT_UM
from edmsim.errors import InputError, one_of
from edmsim.numeric import named_numbers, within

Floats = NDArray[np.float64]
_AT = {entry.name: k for k, entry in enumerate(ENTRIES)}


class PassLaw(Protocol):
    """Decides on every pass of a part, given the environment's observation."""

    def begin(self) -> None:
        """Begin a part."""

    def act(self, observation: NDArray[np.float32]) -> Floats:
        """Return the action (4,), within -1..1, for an observation."""


@dataclass
class Constant:
    """The same action for every pass: its entries by name, from -1 to 1; 0 is the technology's setting."""

    set_point: float = 0.0
    pause: float = 0.0
    on_time: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Raise `InputError` for an entry beyond an action's range."""
        for name in ACTIONS:
            within(name, getattr(self, name), -1.0, 1.0)

    def begin(self) -> None:
        """Begin a part; there is no state to reset."""

    def act(self, _: NDArray[np.float32]) -> Floats:
        """Return the constants."""
        return np.array([self.set_point, self.pause, self.on_time, self.offset])


@dataclass
class Corrected(Constant):
    """The technology's constants, corrected by measurements of the pass before.

    Offsets: the excess of metal that a pass left, less the shift of its own path, predicts the excess of the next
    pass, whose path is shifted against it. The excess of the rough pass does not predict that of the first trim.
    Set-points: a trim is fast if few pulses of the pass before were shorts. Pauses: every wire that breaks lengthens
    them for the rest of the pass, and for the same pass along the tab. The numbers are ours: fits to some of the
    training machines (`edmsim.evaluation.episode`).
    """

    fast: float = 0.7  # set-point of a fast trim
    short_share: float = 0.05  # share of shorts from which a trim is not fast
    # predicted excess of metal of a pass: gain times that of the pass before, plus bias
    gain: float = 1.0
    bias_um: float = -4.0
    # the same for the last pass
    last_gain: float = 0.6
    last_bias_um: float = 2.5
    calm: float = 0.5  # added to the pause for every wire that broke in the pass
    offset_um: float = 20.0  # the environment's argument: reach of the offsets

    _number: int = 0
    _moved_um: float = 0.0

    def begin(self) -> None:
        """Begin a part."""
        self._number, self._moved_um = 0, 0.0
        self._last = np.zeros(4)

    def act(self, observation: NDArray[np.float32]) -> Floats:
        """Return the constants with the corrections."""
        entries = {name: float(observation[k]) for name, k in _AT.items()}
        action = super().act(observation)
        if entries["broke"]:
            action = self._last.copy()
            action[1] = min(action[1] + self.calm, 1.0)
        else:
            self._number += 1
            if self._number > 1 and entries["short"] < self.short_share:
                action[0] = self.fast
            if self._number > 2 and entries["gauged"]:
                last = entries["pass"] == 1.0
                gain, bias_um = (self.last_gain, self.last_bias_um) if last else (self.gain, self.bias_um)
                self._moved_um = -(gain * (entries["left"] * LEFT_UM - self._moved_um) + bias_um)
            action[3] = min(max(self.offset + self._moved_um / self.offset_um, -1.0), 1.0)
        self._last = action
        return action


LAWS: dict[str, type[Constant]] = {"technology": Constant, "constant": Constant, "corrected": Corrected}
"""Laws by name; ``technology`` has no parameters."""


def from_text(text: str) -> PassLaw:
    """Make a law from its text on the command line: with numbers, as ``corrected:gain=0.4``, or ``policy:FILE``.

    >>> from_text("constant:pause=-0.5").act(np.zeros(len(ENTRIES)))
    array([ 0. , -0.5,  0. ,  0. ])
    """
    name, _, rest = text.partition(":")
    if name in user_code.PASS_MAKERS:
        return cast(PassLaw, user_code.make(name, rest, user_code.PASS_MAKERS))
    if name not in LAWS:
        listed = one_of(name, LAWS, (*LAWS, *(f"{kind}:FILE" for kind in user_code.PASS_MAKERS)))
        raise InputError(f"there is no law of passes {name!r}; choose one of {listed}")
    kind = LAWS[name]
    known = [] if name == "technology" else [f.name for f in fields(kind) if not f.name.startswith("_")]
    numbers = named_numbers(rest, "law")
    for parameter in numbers:
        if parameter not in known:
            raise InputError(f"the law {name} has no number {parameter!r}; it has {', '.join(known) or 'none'}")
    return kind(**numbers)
