"""Modes of a machine for one wire after another: the file is linearised once, and wires are strung by formula."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from edmsim.errors import InputError
from edmsim.machine.files import mjcf_version
from edmsim.plant.mechanics.model import (
    Array,
    ModalModel,
    WireSetup,
    build_model,
    machine_at_rest,
    node_damping_N_s_m,
    node_mass_kg,
    reduced,
    wire_heights,
)
from edmsim.plant.mechanics.modes import Linear


def strung(wire: WireSetup, model_file: str, n_modes: int, slice_heights_m: ArrayLike) -> ModalModel:
    """Return the modes of ``reduce_model(build_model(wire, model_file), ...)`` without building that model.

    The file's machine is linearised once, with the wire that stands in it. Of another wire only the nodes' masses
    and dampings differ, and the segments' stiffness, by one factor: the rest length is 0, so a node feels T/a times
    its offset from its neighbour whatever the length a of a segment.

    Parameters
    ----------
    wire, model_file
        As for `build_model`.
    n_modes, slice_heights_m
        As for `reduce_model`.

    Raises
    ------
    InputError
        As `reduce_model`.
    """
    known = _reference(model_file, mjcf_version(model_file))
    linear, nodes = known.linear, np.concatenate(known.blocks[:2])
    count = len(known.blocks[0])
    spacing = wire.guide_distance_m / (count + 1)
    heights = np.asarray(spacing * np.arange(1, count + 1), np.float64)
    mass_kg = node_mass_kg(wire, heights, spacing)
    mass, damping, stiffness = linear.mass.copy(), linear.damping.copy(), linear.stiffness.copy()
    mass[nodes, nodes] += np.tile(mass_kg - known.node_mass_kg, 2)
    damping[nodes, nodes] += np.tile(node_damping_N_s_m(wire, mass_kg) - known.node_damping_N_s_m, 2)
    stiffness[np.ix_(nodes, nodes)] *= wire.tension / spacing / known.segment_N_m
    strung_linear = Linear(mass, damping, stiffness, linear.input)
    return reduced(strung_linear, known.blocks, heights, wire.guide_distance_m, n_modes, slice_heights_m)


_REFERENCE_WIRE = WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)
"""Any wire would do: what depends on it is taken out again."""
_HELD = 1e-6
"""Share of a node's stiffness that may hold it where its neighbours are not."""


class _Reference(NamedTuple):
    """A file's machine at rest with the reference wire, and what of it is that wire's."""

    linear: Linear
    blocks: list[list[int]]
    node_mass_kg: Array
    node_damping_N_s_m: Array
    segment_N_m: float


@functools.lru_cache(maxsize=8)
def _reference(model_file: str, _version: int) -> _Reference:
    wire, model = _REFERENCE_WIRE, build_model(_REFERENCE_WIRE, model_file)
    heights, guide_distance = wire_heights(model)
    linear, blocks = machine_at_rest(model, len(heights))
    pulls = linear.stiffness[np.ix_(blocks[0], blocks[0])]
    if np.abs(pulls[1:-1].sum(axis=1)).max() > _HELD * pulls.max():
        raise InputError("the wire's nodes are held by more than the segments between them", model_file)
    spacing = guide_distance / (len(heights) + 1)
    mass_kg = node_mass_kg(wire, heights, spacing)
    return _Reference(linear, blocks, mass_kg, node_damping_N_s_m(wire, mass_kg), wire.tension / spacing)
