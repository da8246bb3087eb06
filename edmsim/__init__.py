"""edmsim: a wire-EDM machine, simulated discharge by discharge.

>>> import edmsim
>>> edmsim.Machine.load(material="tool-steel", height_mm=20).guide_distance_mm
40.0
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmsim.signals import ending_at_once

if TYPE_CHECKING:
    from edmsim import controllers, envs
    from edmsim.errors import EdmsimError, InputError
    from edmsim.evaluation.stable_rate import StableRate, highest_stable_rate
    from edmsim.job.cut import cut
    from edmsim.job.result import CutResult
    from edmsim.machine.machine import Machine
    from edmsim.machine.pulse_window import PulseWindow
    from edmsim.plant.plant import Plant

__version__ = "0.1.0"

__all__ = [
    "CutResult", "EdmsimError", "InputError", "Machine", "Plant", "PulseWindow", "StableRate", "controllers", "cut",
    "envs", "highest_stable_rate",
]

_HOMES = {
    "CutResult": "edmsim.job.result",
    "EdmsimError": "edmsim.errors",
    "InputError": "edmsim.errors",
    "Machine": "edmsim.machine.machine",
    "Plant": "edmsim.plant.plant",
    "PulseWindow": "edmsim.machine.pulse_window",
    "StableRate": "edmsim.evaluation.stable_rate",
    "cut": "edmsim.job.cut",
    "highest_stable_rate": "edmsim.evaluation.stable_rate",
}


if not (Path(__file__).parent / "controllers").is_dir():
    # in a checkout without symbolic links the folders are next to the package
    __path__.append(str(Path(__file__).parents[1]))


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted([*__all__, "__version__", "__doc__"])


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so ``import edmsim`` stays fast."""
    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    elif name in ("controllers", "envs"):
        value = import_module(f"edmsim.{name}")
    else:
        raise AttributeError(f"module 'edmsim' has no attribute '{name}'")
    globals()[name] = value
    return value


def _register() -> None:
    """Register the environments by name; they are imported when one is made."""
    from edmsim.envs.registry import register_all

    register_all()


with ending_at_once():
    _register()
