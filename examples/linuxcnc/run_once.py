#!/usr/bin/env python3
"""A display without a screen, for DISPLAY in the INI: switches LinuxCNC on, runs the program once and exits."""

import importlib
import subprocess
import sys
import time

WAIT_S = 600.0


def is_cutting() -> bool:
    """Return whether the gap is still cutting or writing its results."""
    answer = subprocess.run(["halcmd", "getp", "edm-gap.cutting"], capture_output=True, text=True, check=True)
    return answer.stdout.strip() == "TRUE"


def main() -> int:
    """Run the program of the INI; return 0 if it reached its end."""
    linuxcnc = importlib.import_module("linuxcnc")
    ini = linuxcnc.ini(sys.argv[sys.argv.index("-ini") + 1])
    command, status = linuxcnc.command(), linuxcnc.stat()
    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    command.home(-1)
    command.wait_complete()
    time.sleep(1.0)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(ini.find("EDM", "PROGRAM"))
    command.auto(linuxcnc.AUTO_RUN, 0)
    time.sleep(1.0)
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        status.poll()
        if status.interp_state == linuxcnc.INTERP_IDLE and status.inpos and not is_cutting():
            return 0
        time.sleep(0.05)
    return 1


if __name__ == "__main__":
    sys.exit(main())
