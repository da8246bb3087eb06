"""Learning feed controllers: training with stable-baselines3, and policies as plain arrays."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from edmsim.learning.sb3 import export_sb3, start_sb3

__all__ = ["export_sb3", "start_sb3"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: both need the extra ``rl``."""
    if name not in __all__:
        raise AttributeError(f"module 'edmsim.learning' has no attribute '{name}'")
    try:
        from edmsim.learning import sb3
    except ImportError as error:
        from edmsim.errors import InputError

        raise InputError(f"{name} needs {error.name}: pip install 'edmsim[rl]'") from error
    return getattr(sb3, name)
