#!/usr/bin/env python3
"""HAL component (userspace): the gap of edmsim behind LinuxCNC's axes.

    loadusr -W python3 gap.py part.ngc --out out/linuxcnc

While ``enable`` is high, one cut is simulated: the axes follow ``x`` and ``y``, in mm, and the pins have the gap's
measurements. When ``enable`` falls, the cut ends, and its folder has the files of ``edmsim cut``: report, windows,
recording.
"""

import argparse
import importlib
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import edmsim
from edmsim.controllers.protocols import WindowObservation
from edmsim.errors import EdmsimError
from edmsim.files import read_text
from edmsim.hil.external import ExternalMotion

DEBIAN = "/usr/lib/python3/dist-packages"
"""Where Debian's package has the module hal; a virtual environment does not look there."""
WORDS = re.compile(r"(?<![A-Z_])M(5[0-3]|6[2-8])(?!\d)([ \t]*[PELQ][ \t]*[-+.\d]+)*", re.IGNORECASE)
"""Words of a program that are LinuxCNC's affair, with their P: adaptive feed, digital and analogue outputs."""
PINS_IN = {"x": "FLOAT", "y": "FLOAT", "u": "FLOAT", "v": "FLOAT", "enable": "BIT"}
PINS_OUT = {
    "gap-voltage": "FLOAT", "gap-current": "FLOAT", "short-ratio": "FLOAT", "open-ratio": "FLOAT",
    "spark-ratio": "FLOAT", "wire-broken": "BIT", "cutting": "BIT", "path": "FLOAT",
}  # fmt: skip
POLL_S = 0.005


class Pins:
    """The component's pins as the link of an `ExternalMotion`."""

    def __init__(self, component: Any) -> None:
        self.component = component

    def place_um(self) -> tuple[float, float]:
        """Return LinuxCNC's target of the axes; after the first call it may move them."""
        place = 1e3 * self.component["x"], 1e3 * self.component["y"]
        self.component["cutting"] = True
        return place

    def finished(self) -> bool:
        """Return whether the program has switched the gap off."""
        return not self.component["enable"]

    def show(self, observation: WindowObservation) -> None:
        """Set the pins to the measurements of a window."""
        pins = self.component
        pins["short-ratio"], pins["open-ratio"] = observation.short / 255, observation.open / 255
        pins["spark-ratio"] = 1.0 - (observation.short + observation.open) / 255
        pins["gap-voltage"], pins["gap-current"] = observation.mean_voltage_V, observation.mean_current_A
        pins["path"] = observation.path_um * 1e-3

    def rest(self, broken: bool) -> None:
        """Set the pins for a gap without a cut: all pulses open, and the feed is free."""
        pins = self.component
        pins["short-ratio"], pins["spark-ratio"], pins["open-ratio"] = 0.0, 0.0, 1.0
        pins["gap-voltage"] = pins["gap-current"] = 0.0
        pins["cutting"], pins["wire-broken"] = False, broken


def import_hal() -> Any:
    """Return LinuxCNC's module hal."""
    sys.path.append(DEBIAN)
    try:
        return importlib.import_module("hal")
    except ImportError as error:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        sys.exit(f"edmsim: Python {version} cannot load LinuxCNC's module hal, of linuxcnc-uspace, which is made for "
                 f"the system's Python: {error}")  # fmt: skip


def make_component(hal: Any, name: str) -> Any:
    """Make the HAL component with its pins."""
    component = hal.component(name)
    for pins, direction in ((PINS_IN, hal.HAL_IN), (PINS_OUT, hal.HAL_OUT)):
        for pin, kind in pins.items():
            component.newpin(pin, getattr(hal, f"HAL_{kind}"), direction)
    component.newparam("time-scale", hal.HAL_FLOAT, hal.HAL_RW)
    component["time-scale"] = 1.0
    return component


def without_words(program: str, folder: str) -> Path:
    """Write the program without LinuxCNC's own words, from which edmsim reads the contour; return its path."""
    file = Path(folder) / Path(program).name
    file.write_text(WORDS.sub("", read_text(program)), encoding="utf-8")
    return file


def serve(component: Any, chosen: argparse.Namespace, program: Path, cuts: int | None = None) -> None:
    """Cut whenever ``enable`` rises, until the component is unloaded, or for a number of cuts."""
    pins, made = Pins(component), 0
    pins.rest(False)
    while cuts is None or made < cuts:
        if not component["enable"]:
            time.sleep(POLL_S)
            continue
        component["wire-broken"] = broken = False
        try:
            result = edmsim.cut(
                program, out=chosen.out, overwrite=True, resolution="fast",
                machine=chosen.machine, material=chosen.material, height_mm=chosen.height, generator=chosen.generator,
                controller=ExternalMotion(pins, component["time-scale"]), seed=chosen.seed,
            )  # fmt: skip
            print(f"edmsim: {result.report['outcome']}; {chosen.out}", file=sys.stderr)
            broken = result.report["outcome"] == "wire-break"
        except EdmsimError as error:
            print(f"edmsim: {error}", file=sys.stderr)
        made += 1
        pins.rest(broken)
        while component["enable"]:
            time.sleep(POLL_S)


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="The gap of edmsim as a HAL component.")
    parser.add_argument("program", help="the program that LinuxCNC runs, for the workpiece and the measurements")
    parser.add_argument("--out", default="out/linuxcnc", help="folder for the cut")
    parser.add_argument("--name", default="edm-gap", help="of the component")
    parser.add_argument("--machine", default="agiecut-dem15")
    parser.add_argument("--material", default="tool-steel")
    parser.add_argument("--generator", default="iso-pulse")
    parser.add_argument("--height", type=float, default=10.0, help="of the workpiece in mm")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args(words)


def main() -> None:
    """Start in the order of ``loadusr -W``: read the program, compile, make the pins, report ready, serve."""
    chosen = arguments()
    try:
        with tempfile.TemporaryDirectory() as folder:
            program = without_words(chosen.program, folder)
            hal = import_hal()
            edmsim.Plant(edmsim.Machine.load(), resolution="fast").advance()  # compiles everything in advance
            component = make_component(hal, chosen.name)
            component.ready()
            serve(component, chosen, program)
    except KeyboardInterrupt:
        return
    except EdmsimError as error:
        sys.exit(f"edmsim: {error}")


if __name__ == "__main__":
    main()
