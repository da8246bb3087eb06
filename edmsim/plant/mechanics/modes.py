"""A MuJoCo model as a linear system at rest: mass, damping, stiffness, and the modes of its blocks."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

if TYPE_CHECKING:
    import mujoco

Array = NDArray[np.float64]

_DIFFERENCE = 1e-6  # m, rad, m/s or rad/s: far below a node's spacing, far above the rounding of a force
_COUPLING_MAX = 1e-6  # share of the diagonal up to which two blocks count as independent
_REST_MAX = 1e-6  # m/s2 or rad/s2 at which a machine counts as at rest
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
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if data.nefc:
        raise InputError(f"the machine at rest touches {data.nefc} limits or contacts; it must be free")
    if np.abs(data.qacc).max() > _REST_MAX:
        raise InputError(f"the machine at its reference accelerates by {np.abs(data.qacc).max():g} m/s2 or rad/s2; "
                         "it must be in equilibrium there")
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return Linear(
        mass=mass,
        damping=-_force_slope(model, data, data.qvel),
        stiffness=-_force_slope(model, data, data.qpos),
        input=_force_slope(model, data, data.ctrl),
    )


def _force_slope(model: mujoco.MjModel, data: mujoco.MjData, of: Array) -> Array:
    """Return d force / d `of` (nv, len(of)) by central differences; `of` is a view into `data`."""
    import mujoco

    def force(i: int, change: float) -> Array:
        rest = of[i]
        of[i] = rest + change
        mujoco.mj_forward(model, data)
        of[i] = rest
        return np.asarray(data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)

    columns = [(force(i, _DIFFERENCE) - force(i, -_DIFFERENCE)) / (2 * _DIFFERENCE) for i in range(len(of))]
    return np.stack(columns, axis=1)


def check_independent(linear: Linear, blocks: list[list[int]]) -> None:
    """Refuse a machine whose blocks of degrees of freedom pull on each other: it would have other modes."""
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
    """Return what scipy.linalg.eigh calls, without its checks, as draws need it often."""
    # its module is loaded without the package around it, whose arrays of other libraries take a tenth of a second
    name = "scipy.linalg._flapack"
    lapack: Any = sys.modules.get(name)
    if lapack is None:
        package = find_spec("scipy.linalg")
        spec = PathFinder.find_spec(name, package.submodule_search_locations if package else None)
        if spec is None or spec.loader is None:  # another scipy has it elsewhere
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
    across = np.abs(modal_damping - np.diag(diagonal))
    scale = np.sqrt(np.outer(diagonal, diagonal))
    neglected = float(np.max(across / np.maximum(scale, _TINY)))
    return Modes(omega, diagonal / (2 * omega), shape, shape.T @ mass, neglected)
