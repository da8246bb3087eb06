"""Modes of a machine for one wire after another: what the file has is worked out once, and each wire by one solve."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.files import mjcf_version
from edmsim.plant.mechanics.model import (
    ModalModel,
    WireSetup,
    build_model,
    machine_at_rest,
    node_damping_N_s_m,
    node_mass_kg,
    wire_heights,
)
from edmsim.plant.mechanics.modes import Linear
from edmsim.plant.mechanics.strung import strung

Floats = NDArray[np.float64]

_REFERENCE = WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)
"""Any wire would do: what depends on it is taken out again."""


class _Wire(NamedTuple):
    """One direction of the reference wire in a file's machine, and what of it follows from its set-up."""

    linear: Linear
    mass_kg: Floats
    damping_N_s_m: Floats
    segment_N_m: float


def modes_with(wire: WireSetup, model_file: str, n_modes: int, slice_heights_m: tuple[float, ...]) -> ModalModel:
    """Return what `strung` returns, to the bit, in a tenth of the time: the table's modes are those of any wire.

    Parameters
    ----------
    wire, model_file, n_modes, slice_heights_m
        As for `strung`; the heights lie between the guides.

    Raises
    ------
    InputError
        As `strung`.
    """
    version = mjcf_version(model_file)
    table, known = _table(model_file, version, n_modes), _reference(model_file, version)
    count = len(known.mass_kg)
    spacing_m = wire.guide_distance_m / (count + 1)
    heights_m = np.asarray(spacing_m * np.arange(1, count + 1), np.float64)
    mass_kg = node_mass_kg(wire, heights_m, spacing_m)
    mass, damping = known.linear.mass.copy(), known.linear.damping.copy()
    mass.flat[:: count + 1] += mass_kg - known.mass_kg
    damping.flat[:: count + 1] += node_damping_N_s_m(wire, mass_kg) - known.damping_N_s_m
    stiffness = known.linear.stiffness * (wire.tension / spacing_m / known.segment_N_m)
    omega, zeta, node_shape, neglected = _solved(mass, damping, stiffness)
    node_shape = node_shape[:, :n_modes]
    shape = _at(np.array(slice_heights_m), np.concatenate([[0.0], heights_m, [wire.guide_distance_m]]), node_shape)
    return replace(
        table, wire_omega=omega[:n_modes], wire_zeta=zeta[:n_modes], wire_shape=shape, node_heights_m=heights_m,
        node_shape=node_shape, slice_mass_kg=1 / (shape**2).sum(axis=1), mobility=(shape**2).sum(axis=0),
        inertia=(shape**2).mean(axis=0), neglected_damping=max(neglected, table.neglected_damping),
    )  # fmt: skip


def _solved(mass: Floats, damping: Floats, stiffness: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Return omega, zeta, shape and neglected damping as `block_modes` does, without scipy's checks and the rest."""
    from scipy.linalg.lapack import dsygvd  # what scipy.linalg.eigh calls

    squares, shape, _ = dsygvd((stiffness + stiffness.T) / 2, mass)
    omega = np.sqrt(squares)
    shape = shape * np.where(shape[0] < 0, -1.0, 1.0)
    modal_damping = shape.T @ damping @ shape
    diagonal = modal_damping.diagonal()
    across = np.abs(modal_damping)
    across.flat[:: len(omega) + 1] = 0.0
    scale = np.maximum(np.sqrt(np.outer(diagonal, diagonal)), np.finfo(float).tiny)
    return omega, diagonal / (2 * omega), shape, float((across / scale).max())


def _at(slices_m: Floats, nodes_m: Floats, node_shape: Floats) -> Floats:
    """Deflections at some heights, as `at_heights`, without a padded copy for every mode."""
    bent = np.zeros((node_shape.shape[1], len(nodes_m)))
    bent[:, 1:-1] = node_shape.T
    return np.stack([np.interp(slices_m, nodes_m, mode) for mode in bent], axis=1)


@functools.lru_cache(maxsize=16)
def _table(model_file: str, _version: int, n_modes: int) -> ModalModel:
    """Modes of a file's machine with the reference wire, which `strung` checks."""
    return strung(_REFERENCE, model_file, n_modes, [_REFERENCE.guide_distance_m / 2])


@functools.lru_cache(maxsize=8)
def _reference(model_file: str, _version: int) -> _Wire:
    model = build_model(_REFERENCE, model_file)
    heights_m, guide_distance_m = wire_heights(model)
    linear, blocks = machine_at_rest(model, len(heights_m))
    inside, spacing_m = np.ix_(blocks[0], blocks[0]), guide_distance_m / (len(heights_m) + 1)
    mass_kg = node_mass_kg(_REFERENCE, heights_m, spacing_m)
    own = Linear(linear.mass[inside], linear.damping[inside], linear.stiffness[inside], linear.input[blocks[0]])
    return _Wire(own, mass_kg, node_damping_N_s_m(_REFERENCE, mass_kg), _REFERENCE.tension / spacing_m)
