"""Everything that commands the machine; feed controllers by name.

A controller observes only what a real machine measures: counts, mean voltage, current and ignition delay, and the
position counters.
"""

import tomllib
from dataclasses import fields
from functools import cache
from importlib import resources
from typing import Any, TypeAlias, cast

from edmsim import user_code
from edmsim.controllers.feed import laws
from edmsim.controllers.feed.counts import CountsController, McuController
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.feed.laws import FixedController
from edmsim.controllers.protocols import FeedCommand, FeedController, SeesTruth, WindowObservation
from edmsim.controllers.user_controllers import check_controller, from_file
from edmsim.errors import InputError, one_of, refuses_wrong_types
from edmsim.numeric import named_numbers

__all__ = [
    "OF_A_TASK", "SAME_LAW", "FeedCommand", "FeedController", "SeesTruth", "WindowObservation", "check_controller",
    "choices", "found_gains", "from_text", "make", "names",
]

_Kind: TypeAlias = "type[CountsController] | type[FixedController] | type[ServoLaw]"
_GENERAL: tuple[_Kind, ...] = (
    CountsController, FixedController, laws.VoltageController, laws.DelayController, laws.FuzzyController,
    laws.AdaptiveOffTimeController, laws.OracleController, McuController,
)
_OF_A_TASK: tuple[_Kind, ...] = (
    laws.FixedPeriodController, laws.SatoController, laws.HeatFluxController, laws.HeatOracleController,
    laws.SetPointController, laws.ClimbController, laws.LeadOracleController, laws.TrimController,
    laws.ClimbingHoldController, laws.AdaptiveHoldController, laws.GuardedHoldController,
)
_CONTROLLERS: dict[str, _Kind] = {kind.name: kind for kind in (*_GENERAL, *_OF_A_TASK)}
SAME_LAW = {McuController.name: CountsController.name}
"""Controllers that command exactly the same feeds as another one: comparisons leave them out."""
OF_A_TASK = tuple(kind.name for kind in _OF_A_TASK)
"""Controllers whose constants are for one task: compared only in that task."""


def names() -> tuple[str, ...]:
    """Names of the feed controllers."""
    return tuple(_CONTROLLERS)


def choices(*, cutting: bool = False) -> tuple[str, ...]:
    """Return the choices of `from_text`, for messages and help.

    Parameters
    ----------
    cutting : bool
        Whether to list only the controllers of ``edmsim cut``, without those that read the true state.

    Examples
    --------
    >>> choices(cutting=True)[-3:]
    ('guarded-hold', 'policy:FILE', 'own.py:Own')
    """
    kinds = [name for name, kind in _CONTROLLERS.items() if not (cutting and issubclass(kind, SeesTruth))]
    return (*kinds, *(f"{kind}:FILE" for kind in user_code.MAKERS), "own.py:Own")


@refuses_wrong_types
def found_gains(name: str) -> dict[str, float]:
    """Return the gains found by a search for a controller or its law, ``models/gains/NAME.toml``; may be empty.

    Raises
    ------
    InputError
        If there is no such controller.

    Examples
    --------
    >>> found_gains("voltage")["reference_V"]
    7.99
    """
    _kind(name)
    return {**_gains_file(SAME_LAW.get(name, name))}


def _kind(name: str) -> _Kind:
    if name not in _CONTROLLERS:
        raise InputError(f"there is no feed controller {name!r}; choose one of {one_of(name, names())}")
    return _CONTROLLERS[name]


@cache
def _gains_file(name: str) -> dict[str, float]:
    file = resources.files("edmsim.models") / "gains" / f"{name}.toml"
    if not file.is_file():
        return {}
    return {key: float(value) for key, value in tomllib.loads(file.read_text(encoding="utf-8"))["gains"].items()}


@refuses_wrong_types
def make(name: str, **parameters: float) -> FeedController:
    """Make a feed controller.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters : float
        Its constants by name; others have the values of `found_gains`, or else their defaults.

    Raises
    ------
    InputError
        If there is no such controller, it has no such parameter, or the value cannot be used.

    Examples
    --------
    >>> make("fixed", feed_um_s=20.0).name
    'fixed'
    """
    kind = _kind(name)
    known = [field.name for field in fields(kind) if field.init]
    for parameter in parameters:
        if parameter not in known:
            raise InputError(
                f"the {name} controller has no parameter {parameter!r}; it has {one_of(parameter, known)}"
            )
    return kind(**cast(dict[str, Any], {**found_gains(name), **parameters}))


@refuses_wrong_types
def from_text(text: str, *, cutting: bool = False) -> FeedController:
    """Make a feed controller from its text on the command line.

    Parameters
    ----------
    text : str
        A name, optionally with parameters: ``fixed:feed_um_s=20,...``; a trained policy: ``policy:`` and its file or
        its name under ``models/policies``; or a class in your own Python file, which is run, optionally with
        parameters: ``FILE.py:CLASS:name=number,...``.
    cutting : bool
        Whether the message for an unknown name lists only the controllers of ``edmsim cut``.

    Raises
    ------
    InputError
        See `make`; if a parameter does not read ``name=number``, or the policy or the file cannot be used.
    """
    own = user_code.named(text)
    if own is not None:
        return from_file(own, named_numbers(own.rest, "controller"))
    name, _, rest = text.partition(":")
    if name in user_code.MAKERS:
        return cast(FeedController, user_code.make(name, rest))
    if text.endswith((".json", ".npz")):
        raise InputError(f"there is no feed controller {text!r}; did you mean 'policy:{text}'?")
    if name not in _CONTROLLERS:
        listed = one_of(name, names(), choices(cutting=cutting))
        raise InputError(f"there is no feed controller {name!r}; choose one of {listed}")
    return make(name, **named_numbers(rest, "controller"))
