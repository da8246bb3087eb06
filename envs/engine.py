"""What runs an environment's episodes: sub-environments that step window by window, or parts that step pass by pass.

Parts are loaded where they are made: what cuts programs takes longer to load than sub-environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.batch import Batch
from edmsim.envs.render import Renderer
from edmsim.envs.sub_envs import SubEnvs
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.envs.parts import Parts

    Engine = Batch | Parts  # both have the members that Gymnasium's environments need


def engine_of(family: EnvArguments, count: int, threads: int) -> Engine:
    """Return what runs `count` episodes side by side."""
    if isinstance(family, Family):
        return Batch(family, count, threads)
    from edmsim.envs.part_task import Part
    from edmsim.envs.parts import Parts

    assert isinstance(family, Part)
    return Parts(family, count, threads)


def sub_envs_of(engine: Engine) -> SubEnvs:
    """Return the sub-environments that step window by window; raises `InputError` where there are none."""
    if isinstance(engine, Batch):
        return engine.sub_envs
    raise InputError(
        "Part is decided on pass by pass: no feed controller can look on, and no recorder; edmsim cut --passes "
        "records the same part"
    )


def picture_of(engine: Engine, renderer: Renderer, index: int) -> NDArray[np.uint8]:
    """Return a sub-environment's picture, uint8 (480, 640, 3)."""
    if isinstance(engine, Batch):
        return renderer.picture(engine, index)
    from edmsim.envs.part_picture import picture

    return picture(engine.episode(index))
