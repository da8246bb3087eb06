"""Writes the gap as an FMU: ``edmsim gap --fmu``."""

import json
import tempfile
from pathlib import Path
from typing import Any

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import check_suffix, make_writable, replacing
from edmsim.hil.gap import check_gap
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import whole_from
from edmsim.plant.resolution import resolution as named_resolution
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM

_SCRIPT = Path(__file__).with_name("fmu_slave.py")


@refuses_wrong_types
def export_fmu(
    file: str | Path, *, seed: int = 0, resolution: str = "fast", gap_um: float = SLOT_GAP_UM, **machine: Any
) -> float:
    """Write an FMU, FMI 3.0 for co-simulation, of a wire at the end of a slot, with every constant of its set-up.

    Parameters
    ----------
    file : path
        ``.fmu``.
    seed : int
    resolution : {"fast", "default", "fine"}
    gap_um : float
        Gap round the wire at the start.
    **machine
        Arguments of `Machine.load`; seed, height and tension are the start values of the FMU's parameters.

    Returns
    -------
    float
        Its step in s: 255 periods of the generator's setting.

    Raises
    ------
    InputError
        If the set-up cannot run, the file cannot be written, or pythonfmu3 is not installed.
    """
    target = Path(file)
    check_suffix(target, "an FMU", ".fmu")
    set_up = Machine.load(**machine)
    named_resolution(resolution)
    check_gap(set_up, gap_um)
    try:
        from pythonfmu3 import FmuBuilder
    except ImportError as error:
        raise InputError(f"an FMU needs {error.name}: pip install 'edmsim[fmu]'") from None
    from edmsim.hil.fmu_slave import SETTINGS

    make_writable(target.parent)
    step_s = WINDOW_PULSES * set_up.t_period_us * 1e-6
    constants, mjcf = set_up.model_dump(mode="json"), Path(set_up.base.model)
    settings = {
        "machine": constants, "seed": whole_from("seed", seed, 0), "step_s": step_s, "resolution": resolution,
        "gap_um": gap_um,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        written = Path(name) / SETTINGS
        written.write_text(json.dumps(settings), encoding="utf-8")
        built = FmuBuilder.build_FMU(
            _SCRIPT, dest=name, project_files=[written, *([mjcf] if mjcf.is_absolute() else [])],
            needsExecutionTool=True, canGetAndSetFMUState=True, canSerializeFMUState=True,
            canHandleVariableCommunicationStepSize=False,
        )  # fmt: skip
        with replacing(target) as partial:
            partial.write_bytes(Path(built).read_bytes())
    return step_s
