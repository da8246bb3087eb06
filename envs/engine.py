"""What runs the episodes of an environment, one or many, under Gymnasium's interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from edmsim.controllers import FeedController
    from edmsim.envs.lane_law import LaneLaw
    from edmsim.envs.recorder import EpisodeRecorder
    from edmsim.envs.render import Renderer
    from edmsim.machine.machine import Machine

Floats = NDArray[np.float64]


class Engine(Protocol):
    """Episodes side by side, each with a number, its lane: `edmsim.envs.batch.Batch` and `edmsim.envs.part.Parts`."""

    def begin(
        self, lane: int, rng: np.random.Generator, machine: Machine | None, *, anew: bool
    ) -> dict[str, Any]:
        """Begin an episode; returns the info of the reset. `anew` draws a machine whatever the arguments say."""

    def clear(self) -> None:
        """Forget what the last step earned and cost."""

    def step(self, active: NDArray[np.int64], actions: NDArray[np.float32]) -> Floats:
        """Run a step in the active lanes; returns the rewards (n,), or (n, objectives), 0 in the others."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which lanes (n,) have cut for as long as an episode lasts."""

    def observations(self) -> NDArray[np.float32]:
        """Return every lane's observation, in a fresh array."""

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the numbers of `info`, in fresh arrays (n,)."""

    def reward_terms(self) -> dict[str, Floats]:
        """Return the terms of the last rewards by name, in fresh arrays (n,)."""

    def words(self) -> dict[str, NDArray[Any]]:
        """Return the texts of `info` (n,)."""

    def change(self, family: Any) -> None:
        """Let episodes begun from now on have other arguments."""

    def picture(self, renderer: Renderer, lane: int) -> NDArray[np.uint8]:
        """Return a lane's picture, uint8 (480, 640, 3)."""

    def lane_law(self, lane: int, controller: FeedController) -> LaneLaw:
        """Return a feed controller's place at a lane."""

    def recorder(self, lane: int, actions: Sequence[str]) -> EpisodeRecorder:
        """Return a recorder of the episode that a lane has just begun."""

    def close(self) -> None:
        """Shut down what runs beside the caller."""
