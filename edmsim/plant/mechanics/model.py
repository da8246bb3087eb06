"""The machine's mechanics: the MuJoCo model of table and wire, and its exact modal reduction.

A machine's MJCF is read once, and the names that the plant needs are checked. `build_model` adapts it to a wire;
`reduce_model` linearises this model at its tensioned equilibrium and returns its modes. All numbers of the modal
plant are read from the model.
"""

from __future__ import annotations

import functools
import hashlib
import math
import pickle
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.metadata import version
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim import models
from edmsim.compiled import cache
from edmsim.errors import InputError
from edmsim.machine.machine import mjcf_version
from edmsim.machine.setting import TENSION_N

if TYPE_CHECKING:
    import mujoco

Array = NDArray[np.float64]

NEEDED: dict[str, tuple[str, ...]] = {
    "body": ("x_carriage", "y_carriage", "upper_arm"),
    "joint": ("x", "y", "x_rotor", "y_rotor"),
    "site": ("lower_guide", "upper_guide"),
    "geom": ("workpiece", "clamp_left", "clamp_right"),
    "tendon": ("x_screw", "y_screw"),
    "actuator": ("x_stepper", "y_stepper"),
    "numeric": ("rotor_teeth",),
    "camera": ("overview",),
}
"""Names that plant, playback and pictures need, by kind, without those of the wire's nodes."""
N_NODES = 25
"""Nodes of the wire: the least number with the first four modes within 1 % of the string's. Fewer nodes make time
steps faster, and allow longer ones."""


def read_mjcf(model_file: str) -> mujoco.MjSpec:
    """Return a machine's MJCF after a check of its names; copy it before changing it."""
    return _read_mjcf(model_file, mjcf_version(model_file))


@functools.lru_cache(maxsize=8)  # reading takes four times as long as adapting to a wire and compiling
def _read_mjcf(model_file: str, _version: int) -> mujoco.MjSpec:
    from edmsim.plant.mechanics.engine import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(models.path(model_file)))
        spec.copy().compile()
    except ValueError as error:
        raise InputError(f"MuJoCo cannot use this MJCF: {' '.join(str(error).split())}", model_file) from None
    try:
        missing = _lacking(spec)
    except UnicodeDecodeError:
        raise InputError("this MJCF has names that are not UTF-8: save it as UTF-8", model_file) from None
    if missing:
        raise InputError(f"this MJCF has no {', no '.join(missing)}", model_file)
    if not min(spec.numeric("rotor_teeth").data, default=0) > 0:
        raise InputError("numeric rotor_teeth must be above 0", model_file)
    return spec


def _lacking(spec: mujoco.MjSpec) -> list[str]:
    """Return the missing elements of an MJCF, as kind and name."""
    listed: dict[str, Any] = {
        "body": spec.bodies, "joint": spec.joints, "site": spec.sites, "geom": spec.geoms, "tendon": spec.tendons,
        "actuator": spec.actuators, "numeric": spec.numerics, "camera": spec.cameras,
    }  # fmt: skip
    there = {kind: {item.name for item in items} for kind, items in listed.items()}
    missing = [f"{kind} {name}" for kind, names in NEEDED.items() for name in names if name not in there[kind]]
    nodes = max(N_NODES, sum(name.startswith("wire_") for name in there["body"]))
    wire = {
        "body": [f"wire_{i:02d}" for i in range(nodes)],
        "joint": [f"wire_{axis}{i:02d}" for i in range(nodes) for axis in "xy"],
        "tendon": [f"segment_{i:02d}" for i in range(nodes + 1)],
    }
    return missing + [f"{kind} {name}" for kind, names in wire.items() for name in names if name not in there[kind]]


def screw_constants(model: mujoco.MjModel) -> tuple[dict[str, float], dict[str, float]]:
    """Return the constants of the screws and tables of x and y, as fields of `edmsim.compiled.axis_rows.MOTOR`."""
    found = []
    for axis in "xy":
        carriage, screw = model.joint(axis), model.tendon(f"{axis}_screw").id
        first = int(model.tendon_adr[screw])
        coefficients = model.wrap_prm[first : first + int(model.tendon_num[screw])]
        found.append({
            "um_per_rad": float(-coefficients.min() / coefficients.max()) * 1e6,
            "screw_N_m": float(model.tendon_stiffness[screw].flat[0]),
            "screw_N_s_m": float(model.tendon_damping[screw].flat[0]),
            "table_kg": float(model.body_subtreemass[carriage.bodyid[0]]),
            "way_N_s_m": float(model.dof_damping[carriage.dofadr[0]]),
        })
    return found[0], found[1]


# A MuJoCo model as a linear system at rest: mass, damping, stiffness, and the modes of its blocks.

_DIFFERENCE = 1e-6  # m, rad, m/s or rad/s: far below a node's spacing, far above the rounding of a force
_COUPLING_MAX = 1e-6  # share of the diagonal up to which two blocks count as independent
_REST_MAX = 1e-6  # m/s2 or rad/s2 at which a machine counts as at rest
_UNDAMPED_MAX = 1e-6  # noise of a damping of 0, as a damping ratio
_TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Linear:
    """A machine at rest: ``mass a + damping v + stiffness q = input ctrl``."""

    # (nv, nv): over MuJoCo's degrees of freedom, SI
    mass: Array
    damping: Array
    stiffness: Array
    input: Array  # (nv, nu): generalised force per unit of each actuator's ctrl


@dataclass(frozen=True)
class Modes:
    """Mass-normalised modes of one block of n degrees of freedom, lowest first."""

    # (n,): undamped angular frequency in rad/s and damping ratio
    omega: Array
    zeta: Array
    shape: Array  # (n, n): displacement ``[coordinate, mode]`` per unit of modal coordinate
    momenta: Array  # (n, n): ``shape.T @ mass``: turns displacements into modal coordinates
    # largest ``|c_ij| / sqrt(c_ii c_jj)`` of the modal damping matrix, of which only the diagonal is kept
    neglected_damping: float


def linearise(model: mujoco.MjModel) -> Linear:
    """Return mass, damping, stiffness and input matrix of slide and hinge joints at rest, all at their reference."""
    from edmsim.plant.mechanics.engine import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if data.nefc:
        raise InputError(f"the machine at rest touches {data.nefc} limits or contacts; it must be free")
    if np.abs(data.qacc).max() > _REST_MAX:
        raise InputError(f"the machine at its reference accelerates by {np.abs(data.qacc).max():g} m/s2 or rad/s2; "
                         "it must be in equilibrium there")
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)

    def force(of: Array, i: int, change: float) -> Array:
        rest = of[i]
        of[i] = rest + change
        mujoco.mj_forward(model, data)
        of[i] = rest
        return np.asarray(data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)

    def slope(of: Array) -> Array:
        """Return d force / d `of` (nv, len(of)) by central differences; `of` is a view into `data`."""
        ends = [(force(of, i, _DIFFERENCE), force(of, i, -_DIFFERENCE)) for i in range(len(of))]
        return np.stack([(up - down) / (2 * _DIFFERENCE) for up, down in ends], axis=1)

    return Linear(mass, damping=-slope(data.qvel), stiffness=-slope(data.qpos), input=slope(data.ctrl))


def check_independent(linear: Linear, blocks: list[list[int]]) -> None:
    """Refuse a machine whose blocks of degrees of freedom are coupled, because its modes would differ."""
    inside = np.zeros(linear.mass.shape, bool)
    for block in blocks:
        inside[np.ix_(block, block)] = True
    for name, matrix in (("mass", linear.mass), ("damping", linear.damping), ("stiffness", linear.stiffness)):
        scale = np.sqrt(np.abs(np.diag(matrix)))
        across = np.where(inside, 0.0, np.abs(matrix)) / np.maximum(np.outer(scale, scale), _TINY)
        if across.max() > _COUPLING_MAX:
            raise InputError(f"{name} couples wire and table or x and y by {across.max():.1e} of the diagonal; at "
                             f"most {_COUPLING_MAX:g} is independent")


@functools.cache
def _dsygvd() -> Callable[[Array, Array], tuple[Array, Array, int]]:
    """Return LAPACK's eigensolver, which scipy.linalg.eigh calls after checks that would be slow here."""
    # only its module is imported: the import of the scipy.linalg package takes a tenth of a second more
    name = "scipy.linalg._flapack"
    lapack: Any = sys.modules.get(name)
    if lapack is None:
        package = find_spec("scipy.linalg")
        spec = PathFinder.find_spec(name, package.submodule_search_locations if package else None)
        if spec is None or spec.loader is None:  # in another version of scipy it may be elsewhere
            from scipy.linalg import lapack as public

            return public.dsygvd
        lapack = module_from_spec(spec)
        spec.loader.exec_module(lapack)
    return lapack.dsygvd  # type: ignore[no-any-return]


def block_modes(linear: Linear, block: list[int]) -> Modes:
    """Return the modes of a block: ``K phi = omega^2 M phi``, each mode's first coordinate positive."""
    inside = np.ix_(block, block)
    mass, damping, stiffness = linear.mass[inside], linear.damping[inside], linear.stiffness[inside]
    squares, shape, failed = _dsygvd()((stiffness + stiffness.T) / 2, mass)
    if failed:
        raise InputError("the machine at rest has no modes: its mass is not positive")
    if squares[0] <= 0:
        raise InputError(f"the machine at rest is not stable: a mode has omega^2 {squares[0]:g}, not above 0")
    omega = np.sqrt(squares)
    shape = shape * np.where(shape[0] < 0, -1.0, 1.0)
    modal_damping = shape.T @ damping @ shape
    diagonal = np.diag(modal_damping)
    if np.any(diagonal < -_UNDAMPED_MAX * omega):
        raise InputError("the machine at rest is not stable: a joint or tendon has a damping below 0")
    across = np.abs(modal_damping - np.diag(diagonal))
    scale = np.sqrt(np.outer(diagonal, diagonal))
    neglected = float(np.max(across / np.maximum(scale, _TINY)))
    return Modes(omega, diagonal / (2 * omega), shape, shape.T @ mass, neglected)


_ALIKE = 1e-8  # tolerance of the wire's matrices between x and y, relative to the greatest entry: noise
MODEL_FILE = "agiecut_dem15.xml"  # the machine in `edmsim.models`

_ALLOWED: dict[str, tuple[float, float, str]] = {
    "diameter_m": (20e-6, 400e-6, "m (20 to 400 um)"),  # T-13
    "density_kg_m3": (1e3, 25e3, "kg/m3"),  # from magnesium to above tungsten
    "tension": (*TENSION_N, "N"),
    "guide_distance_m": (1e-3, 0.5, "m (1 to 500 mm)"),  # ours
    "damping_ratio": (0.0, 5.0, "of critical"),  # ours
    "slot_m": (0.0, 0.5, "m (0 to 500 mm)"),
    "slot_mass_kg_m": (0.0, 0.1, "kg/m"),  # ours: some ten times the mass of the thickest wire
}


def check_allowed(parts: object, of: str, allowed: Mapping[str, tuple[float, float, str]]) -> None:
    """Refuse attributes outside their allowed range; the most frequent cause is a wrong unit."""
    for name, (low, high, unit) in allowed.items():
        value = getattr(parts, name)
        if not low <= value <= high:  # also refuses nan
            raise InputError(f"{of} {name} is {value!r}; it must be {low:g} to {high:g} {unit}")


@dataclass(frozen=True)
class WireSetup:
    """The wire between its two guides."""

    diameter_m: float  # wire diameter in m, 20e-6 to 400e-6 (T-13)
    density_kg_m3: float  # density of the wire in kg/m3 (brass 8400 to 8500)
    tension: float  # axial force the brake holds, in N
    guide_distance_m: float  # distance between the guides in m; the workpiece's height plus the clearances
    # damping ratio of the wire's first mode in air; this damping is uniform along the wire
    damping_ratio: float
    # height of the workpiece in m, centred between the guides; in its slot the wire moves water
    slot_m: float = 0.0
    slot_mass_kg_m: float = 0.0  # added mass of this water per metre of the slot

    def __post_init__(self) -> None:
        check_allowed(self, "wire", _ALLOWED)

    @property
    def line_density(self) -> float:
        """Mass per length in kg/m."""
        return self.density_kg_m3 * math.pi / 4 * self.diameter_m**2

    @property
    def wave_speed(self) -> float:
        """Speed of a transverse wave in m/s."""
        return math.sqrt(self.tension / self.line_density)


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Table and wire as independent damped oscillators, mass-normalised."""

    # The coordinate of a wire mode obeys ``q'' + 2 zeta omega q' + omega^2 q = wire_shape.T @ F`` for forces F (N) on
    # the slices, whose displacement is ``wire_shape @ q`` (m). Modes in x and y are equal. The coordinate of a table
    # mode obeys the same equation about ``table_participation * travel``, its equilibrium for a commanded travel (m);
    # the displacement of the axis is ``table_slide_shape @ q`` (m).
    # (n_modes,): undamped angular frequency in rad/s, rising, and damping ratio
    wire_omega: Array
    wire_zeta: Array
    # (n_slices, n_modes): displacement of the wire at a slice's mid-height per unit of modal coordinate (kg^-1/2)
    wire_shape: Array
    node_heights_m: Array  # (n_nodes,): height of the wire's nodes above the lower guide in m, upwards
    # (n_nodes, n_modes): as `wire_shape`, at the nodes; the wire is straight between them and fixed at the guides
    node_shape: Array
    # (2, 2): as for the wire, indexed ``[axis, mode]``, x before y
    table_omega: Array
    table_zeta: Array
    # (2, 2): displacement of the axis per unit of modal coordinate (kg^-1/2), ``[axis, mode]``
    table_slide_shape: Array
    # (2, 2): modal coordinate at rest per metre of commanded travel (kg^1/2), ``[axis, mode]``
    table_participation: Array
    # (2,): rotor angle per metre of travel for each axis, for `ctrl` of the full model
    rotor_rad_per_m: Array
    slice_mass_kg: Array  # (n_slices,): effective mass for an impulse on a slice
    mobility: Array  # (n_modes,): damping rate of every mode by a resistance of 1 kg/s on every slice, in 1/kg
    inertia: Array  # (n_modes,): mean square speed of the slices per squared speed of a mode, in 1/kg
    # largest coupling of two modes by damping, ``|c_ij| / sqrt(c_ii c_jj)``, which modal damping neglects: 0 for the
    # wire, whose damping is proportional to mass; 0.02 for the table
    neglected_damping: float


def build_model(wire: WireSetup, model_file: str = MODEL_FILE) -> mujoco.MjModel:
    """Return the machine's MuJoCo model with this wire in it."""
    # Nodes, segments, upper arm, the drawn workpiece and the time step (half the limit of stability) are adapted to
    # the wire. Joints are ``x y x_rotor y_rotor`` and ``wire_x00 wire_y00 ..``, bodies ``wire_00 ..`` from the lower
    # guide up, actuators ``x_stepper y_stepper`` (ctrl: rotor angle in rad).
    return cast("mujoco.MjModel", machine_spec(wire, model_file).compile())


def machine_spec(wire: WireSetup, model_file: str = MODEL_FILE, n_nodes: int | None = None) -> mujoco.MjSpec:
    """Return what `build_model` compiles, optionally with fewer nodes of the wire than the file has."""
    spec = read_mjcf(model_file).copy()
    if n_nodes is not None:
        _thin_out(spec, n_nodes)
    nodes = [body for body in spec.bodies if body.name.startswith("wire_")]
    _fit_wire(wire, nodes, [tendon for tendon in spec.tendons if tendon.name.startswith("segment_")])
    spec.body("upper_arm").pos = [0.0, 0.0, wire.guide_distance_m]
    _draw_workpiece(spec, wire.guide_distance_m)
    spec.option.timestep = wire.guide_distance_m / (len(nodes) + 1) / (2 * wire.wave_speed)
    return spec


def _thin_out(spec: mujoco.MjSpec, n_nodes: int) -> None:
    """Remove all but the lowest nodes of the wire, and connect the last of them to the upper guide."""
    for part in (list(spec.tendons), list(spec.bodies)):
        for item in part:
            kind, _, number = item.name.partition("_")
            if kind in ("wire", "segment") and int(number) >= n_nodes:
                spec.delete(item)
    last = spec.add_tendon(spec.find_default("wire"), name=f"segment_{n_nodes:02d}")
    last.wrap_site(f"wire_{n_nodes - 1:02d}")
    last.wrap_site("upper_guide")


class _Nodes(NamedTuple):
    """A wire's nodes: heights, masses, damping, and the stiffness of the segments between them."""

    heights_m: Array
    mass_kg: Array
    damping_N_s_m: Array
    segment_N_m: float


def _nodes_of(wire: WireSetup, count: int) -> _Nodes:
    """Return the chain of a wire with a number of nodes."""
    spacing_m = wire.guide_distance_m / (count + 1)
    return _nodes_at(wire, np.asarray(spacing_m * np.arange(1, count + 1), np.float64), spacing_m)


def _nodes_at(wire: WireSetup, heights_m: Array, spacing_m: float) -> _Nodes:
    # a node has the mass of its length of wire, and the added mass of the part that is in the slot
    low, high = (wire.guide_distance_m - wire.slot_m) / 2, (wire.guide_distance_m + wire.slot_m) / 2
    slot_m = np.minimum(heights_m + spacing_m / 2, high) - np.maximum(heights_m - spacing_m / 2, low)
    mass_kg = wire.line_density * spacing_m + np.maximum(slot_m, 0.0) * wire.slot_mass_kg_m
    # damping proportional to mass gives the wire's first mode its damping ratio
    count = len(heights_m)
    omega_1 = 2 / (wire.guide_distance_m / (count + 1)) * wire.wave_speed * math.sin(math.pi / (2 * (count + 1)))
    return _Nodes(heights_m, mass_kg, 2 * wire.damping_ratio * omega_1 * mass_kg, wire.tension / spacing_m)


def _fit_wire(wire: WireSetup, nodes: list[Any], segments: list[Any]) -> None:
    """Set mass, damping and tension of the chain's nodes and segments."""
    fitted = _nodes_of(wire, len(nodes))
    for node, height, mass_kg, damping in zip(nodes, *fitted[:3], strict=True):
        node.frame.pos = [0.0, 0.0, 0.0]
        node.pos = [0.0, 0.0, height]
        node.mass = mass_kg
        for joint in node.joints:
            joint.damping = [damping, 0.0, 0.0]
    for segment in segments:
        segment.stiffness = [fitted.segment_N_m, 0.0, 0.0]  # its rest length is 0
        segment.width = wire.diameter_m / 2


def _draw_workpiece(spec: mujoco.MjSpec, guide_distance_m: float) -> None:
    """Draw the workpiece as high as fits between the guides, with its clamps; both have no mass."""
    workpiece = spec.geom("workpiece")
    below = workpiece.pos[2] - workpiece.size[2]
    clearance = min(below, guide_distance_m / 4)
    workpiece.size[2] = guide_distance_m / 2 - clearance
    workpiece.pos[2] = below + workpiece.size[2]
    for clamp in (spec.geom("clamp_left"), spec.geom("clamp_right")):
        clamp.pos[2] = guide_distance_m - clearance + clamp.size[2]


def reduce_model(model: mujoco.MjModel, n_modes: int, slice_heights_m: ArrayLike) -> ModalModel:
    """Linearise a machine at its tensioned equilibrium and return its modes."""
    # The modes of a block (wire x, wire y, table x, table y) solve ``K phi = omega^2 M phi``. Of the damping in modal
    # coordinates only the diagonal is kept; `ModalModel.neglected_damping` is the largest part neglected.
    node_heights, guide_distance = wire_heights(model)
    slices = _checked_heights(slice_heights_m, guide_distance)
    linear, blocks = machine_at_rest(model, len(node_heights))
    wire, table = block_modes(linear, blocks[0]), _of_table(linear, blocks[2:])
    return _with_wire(table, wire, node_heights, guide_distance, n_modes, slices)


def machine_at_rest(model: mujoco.MjModel, n_nodes: int) -> tuple[Linear, list[list[int]]]:
    """Return a model as a linear system, and the degrees of freedom of its four blocks, which must be independent."""
    linear, blocks = linearise(model), _blocks(model, n_nodes)
    check_independent(linear, blocks)
    _check_alike(linear, *blocks[:2])
    return linear, blocks


def _of_table(linear: Linear, blocks: list[list[int]]) -> dict[str, Any]:
    """Return the table's fields of a `ModalModel` from its blocks in x and y."""
    tables = [block_modes(linear, block) for block in blocks]
    travels = [_unit_travel(linear, block, axis) for axis, block in enumerate(blocks)]
    return {
        "table_omega": np.stack([table.omega for table in tables]),
        "table_zeta": np.stack([table.zeta for table in tables]),
        "table_slide_shape": np.stack([table.shape[0] for table in tables]),
        "table_participation": np.stack(
            [table.momenta @ travel for table, (travel, _) in zip(tables, travels, strict=True)]
        ),
        "rotor_rad_per_m": np.array([ctrl for _, ctrl in travels]),
        "neglected_damping": max(table.neglected_damping for table in tables),
    }


def _with_wire(
    table: dict[str, Any], modes: Modes, node_heights: Array, guide_distance: float, n_modes: int, slices: Array
) -> ModalModel:
    """Return the model of a table and of the modes of a wire in one direction."""
    if not 1 <= n_modes <= len(node_heights):
        raise InputError(f"n_modes is {n_modes}; this wire has 1 to {len(node_heights)} modes")
    node_shape = modes.shape[:, :n_modes]
    shape = at_heights(node_shape, node_heights, guide_distance, slices)
    neglected = max(modes.neglected_damping, table["neglected_damping"])
    return ModalModel(**{
        **table,
        "wire_omega": modes.omega[:n_modes],
        "wire_zeta": modes.zeta[:n_modes],
        "wire_shape": shape,
        "node_heights_m": node_heights,
        "node_shape": node_shape,
        "slice_mass_kg": 1 / (shape**2).sum(axis=1),
        "mobility": (shape**2).sum(axis=0),
        "inertia": (shape**2).mean(axis=0),
        "neglected_damping": neglected,
    })


def _check_alike(linear: Linear, wire_x: list[int], wire_y: list[int]) -> None:
    """Refuse a wire that differs between x and y."""
    for name in ("mass", "damping", "stiffness"):
        x, y = (getattr(linear, name)[np.ix_(block, block)] for block in (wire_x, wire_y))
        if np.abs(x - y).max() > _ALIKE * np.abs(x).max():
            raise InputError(f"the wire's {name} differs between x and y; one set of modes must serve both")


def wire_heights(model: mujoco.MjModel) -> tuple[Array, float]:
    """Return the nodes' heights above the lower guide and the distance of the guides, in m."""
    from edmsim.plant.mechanics.engine import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = (float(data.site(f"{end}_guide").xpos[2]) for end in ("lower", "upper"))
    names = (model.body(i).name for i in range(model.nbody))
    nodes = [name for name in names if name.startswith("wire_")]
    return np.array([data.body(name).xpos[2] for name in nodes]) - low, high - low


def _checked_heights(slice_heights_m: ArrayLike, guide_distance: float) -> Array:
    heights = np.asarray(slice_heights_m, float)
    if heights.ndim != 1 or not np.all((heights > 0) & (heights < guide_distance)):
        raise InputError(f"slice heights are {heights.tolist()} m; they must be a list of heights between the "
                         f"guides, above 0 and below {guide_distance:g} m")
    return heights


def _blocks(model: mujoco.MjModel, n_nodes: int) -> list[list[int]]:
    """Return the degrees of freedom of wire x, wire y, table x (carriage, rotor), table y."""
    wires = [[f"wire_{axis}{i:02d}" for i in range(n_nodes)] for axis in "xy"]
    tables = [[axis, f"{axis}_rotor"] for axis in "xy"]
    return [[int(model.joint(name).dofadr[0]) for name in names] for names in (*wires, *tables)]


def _unit_travel(linear: Linear, block: list[int], axis: int) -> tuple[Array, float]:
    """Return carriage and rotor at rest after one commanded metre, and the ctrl (rad) that commands it."""
    per_ctrl = np.linalg.solve(linear.stiffness[np.ix_(block, block)], linear.input[block, axis])
    return per_ctrl / per_ctrl[0], float(1 / per_ctrl[0])


def at_heights(shape: Array, node_heights: Array, guide_distance: float, heights: Array) -> Array:
    """Interpolate deflections of nodes, `shape` (n_nodes, n), linearly at `heights`."""
    known = np.concatenate([[0.0], node_heights, [guide_distance]])
    bent = np.zeros((shape.shape[1], len(known)))
    bent[:, 1:-1] = shape.T
    return np.stack([np.interp(heights, known, mode) for mode in bent], axis=1)


# Modes of a machine with any wire: the file is linearised once; the modes of other wires follow from formulas.

def modes_with(wire: WireSetup, model_file: str, n_modes: int, slice_heights_m: tuple[float, ...]) -> ModalModel:
    """Return the modes of ``reduce_model(build_model(wire, model_file), ...)`` without building that model."""
    # The file's machine is linearised once. Another wire has other masses and damping of the nodes, and another
    # stiffness of all segments: their rest length is 0, so the force on a node is T/a times its neighbour's offset.
    known = _reference(model_file, mjcf_version(model_file))
    new, across = _nodes_of(wire, len(known.nodes.mass_kg)), known.across
    mass, damping, diagonal = across.mass.copy(), across.damping.copy(), np.arange(len(new.mass_kg))
    mass[diagonal, diagonal] += new.mass_kg - known.nodes.mass_kg
    damping[diagonal, diagonal] += new.damping_N_s_m - known.nodes.damping_N_s_m
    stiffness = across.stiffness * (new.segment_N_m / known.nodes.segment_N_m)
    modes = block_modes(Linear(mass, damping, stiffness, across.input), list(diagonal))
    return _with_wire(
        known.table, modes, new.heights_m, wire.guide_distance_m, n_modes, np.array(slice_heights_m)
    )


_REFERENCE_WIRE = WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)
"""Any wire would do: what depends on it is removed again."""
_ANCHORED = 1e-6  # greatest stiffness to ground of a node, as a share of its stiffness


class _Reference(NamedTuple):
    """A file's table, as fields of a `ModalModel`; the reference wire at rest in one direction, and its nodes."""

    table: dict[str, Any]
    across: Linear
    nodes: _Nodes


@functools.lru_cache(maxsize=8)
def _reference(model_file: str, _version: int) -> _Reference:
    """Return a file's machine. Ours is cached between runs, because importing MuJoCo takes a quarter of a second."""
    if Path(model_file).is_absolute():
        return _read_machine(model_file)
    source = models.path(model_file).read_bytes() + version("mujoco").encode()
    file = cache.folder / f"machine-{hashlib.sha256(source).hexdigest()[:16]}.pickle"
    content = cache.read_signed(file)
    if content is None:
        content = pickle.dumps(_read_machine(model_file))
        with suppress(OSError):  # if it cannot be written, the machine is read again the next time
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
    return _Reference(_of_table(linear, blocks[2:]), across, nodes)
