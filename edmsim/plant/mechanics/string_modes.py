"""Modes of a machine with any wire: the file is linearised once, and the modes of other wires follow by formula."""

import functools
import hashlib
import pickle
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from edmsim import models
from edmsim.compiled import cache
from edmsim.errors import InputError
from edmsim.machine.machine import mjcf_version
from edmsim.plant.mechanics.model import (
    Array,
    ModalModel,
    WireSetup,
    build_model,
    machine_at_rest,
    node_damping_N_s_m,
    node_mass_kg,
    of_wire,
    reduced,
    wire_heights,
)
from edmsim.plant.mechanics.modes import Linear, block_modes


def string_modes(wire: WireSetup, model_file: str, n_modes: int, slice_heights_m: ArrayLike) -> ModalModel:
    """Return the modes of ``reduce_model(build_model(wire, model_file), ...)`` without building that model."""
    # the file's machine is linearised once. Of another wire only the nodes' masses and dampings differ, and the
    # segments' stiffness, by one factor: their rest length is 0, so a node feels T/a times its neighbour's offset
    known = _reference(model_file, mjcf_version(model_file))
    linear, nodes = known.linear, np.concatenate(known.blocks[:2])
    new = _nodes_of(wire, known)
    mass, damping, stiffness = linear.mass.copy(), linear.damping.copy(), linear.stiffness.copy()
    mass[nodes, nodes] += np.tile(new.mass_kg - known.nodes.mass_kg, 2)
    damping[nodes, nodes] += np.tile(new.damping_N_s_m - known.nodes.damping_N_s_m, 2)
    stiffness[np.ix_(nodes, nodes)] *= new.segment_N_m / known.nodes.segment_N_m
    fitted = Linear(mass, damping, stiffness, linear.input)
    return reduced(fitted, known.blocks, new.heights_m, wire.guide_distance_m, n_modes, slice_heights_m)


def modes_with(wire: WireSetup, model_file: str, n_modes: int, slice_heights_m: tuple[float, ...]) -> ModalModel:
    """Return the bits of `string_modes` in a tenth of the time: the table's modes are those of any wire."""
    as_of = mjcf_version(model_file)
    table, known = _table(model_file, as_of, n_modes), _reference(model_file, as_of)
    new, across = _nodes_of(wire, known), known.across
    mass, damping, diagonal = across.mass.copy(), across.damping.copy(), np.arange(len(new.mass_kg))
    mass[diagonal, diagonal] += new.mass_kg - known.nodes.mass_kg
    damping[diagonal, diagonal] += new.damping_N_s_m - known.nodes.damping_N_s_m
    stiffness = across.stiffness * (new.segment_N_m / known.nodes.segment_N_m)
    modes = block_modes(Linear(mass, damping, stiffness, across.input), list(diagonal))
    own = of_wire(modes, new.heights_m, wire.guide_distance_m, n_modes, np.array(slice_heights_m))
    return replace(table, **own, neglected_damping=max(modes.neglected_damping, table.neglected_damping))


_REFERENCE_WIRE = WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)
"""Any wire would do: what depends on it is taken out again."""
_ANCHORED = 1e-6  # share of a node's stiffness that may hold it where its neighbours are not


class _Nodes(NamedTuple):
    """A wire's nodes: heights, masses, dampings, and the stiffness of the segments between them."""

    heights_m: Array
    mass_kg: Array
    damping_N_s_m: Array
    segment_N_m: float


class _Reference(NamedTuple):
    """A file's machine at rest with the reference wire, one direction of that wire alone, and its nodes."""

    linear: Linear
    blocks: list[list[int]]
    across: Linear
    nodes: _Nodes


def _nodes_at(wire: WireSetup, heights_m: Array, spacing_m: float) -> _Nodes:
    mass_kg = node_mass_kg(wire, heights_m, spacing_m)
    return _Nodes(heights_m, mass_kg, node_damping_N_s_m(wire, mass_kg), wire.tension / spacing_m)


def _nodes_of(wire: WireSetup, known: _Reference) -> _Nodes:
    """Return the nodes of another wire, of which there are as many."""
    count = len(known.blocks[0])
    spacing_m = wire.guide_distance_m / (count + 1)
    return _nodes_at(wire, np.asarray(spacing_m * np.arange(1, count + 1), np.float64), spacing_m)


@functools.lru_cache(maxsize=16)
def _table(model_file: str, _version: int, n_modes: int) -> ModalModel:
    """Modes of a file's machine with the reference wire."""
    return string_modes(_REFERENCE_WIRE, model_file, n_modes, [_REFERENCE_WIRE.guide_distance_m / 2])


@functools.lru_cache(maxsize=8)
def _reference(model_file: str, _version: int) -> _Reference:
    """Return a file's machine; ours is cached between runs, as MuJoCo takes a quarter of a second to load."""
    if Path(model_file).is_absolute():
        return _read_machine(model_file)
    source = models.path(model_file).read_bytes() + version("mujoco").encode()
    file = cache.folder / f"machine-{hashlib.sha256(source).hexdigest()[:16]}.pickle"
    content = cache.read_signed(file)
    if content is None:
        content = pickle.dumps(_read_machine(model_file))
        with suppress(OSError):  # what cannot be stored is read again the next time
            cache.write_signed(file, content)
    return cast("_Reference", pickle.loads(content))


def _read_machine(model_file: str) -> _Reference:
    wire, model = _REFERENCE_WIRE, build_model(_REFERENCE_WIRE, model_file)
    heights_m, guide_distance_m = wire_heights(model)
    linear, blocks = machine_at_rest(model, len(heights_m))
    inside = np.ix_(blocks[0], blocks[0])
    across = Linear(linear.mass[inside], linear.damping[inside], linear.stiffness[inside], linear.input[blocks[0]])
    if np.abs(across.stiffness[1:-1].sum(axis=1)).max() > _ANCHORED * across.stiffness.max():
        raise InputError("the wire's nodes are held by more than the segments between them", model_file)
    nodes = _nodes_at(wire, heights_m, guide_distance_m / (len(heights_m) + 1))
    return _Reference(linear, blocks, across, nodes)
