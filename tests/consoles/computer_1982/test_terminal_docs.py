"""Every session shown in docs/terminal.md and docs/controller-1982.md runs as shown."""

import re
from pathlib import Path

import pytest

import edmsim
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import Session
from edmsim.consoles.computer_1982.words import JOB
from edmsim.consoles.devices import Interrupts

from .conftest import Script

DOCS = Path(__file__).parents[3] / "docs"
PAGE, WALK = ((DOCS / name).read_text(encoding="utf-8") for name in ("terminal.md", "controller-1982.md"))
SESSIONS, WALKS = (re.findall(r"```session\n(.*?)```", page, re.DOTALL) for page in (PAGE, WALK))
(PROGRAM,) = re.findall(r"```program\n(.*?)```", PAGE, re.DOTALL)
(TAPE,) = re.findall(r"```tape\n(.*?)```", WALK, re.DOTALL)
DEPENDS_ON_SPARKS = ("CUTTING", "SPEED", "GENERATOR", "EMERGENCY", "2000  ")
"""Figures in these lines differ between processors, whose sums round differently."""


def comparable(text):
    lines = [line.rstrip() for line in text.strip().splitlines()]
    return [re.sub(r"[\dA-F.]+", "#", line) if line.startswith(DEPENDS_ON_SPARKS) else line for line in lines]


def typed(session):
    """What was typed behind the prompts: not the bytes that the monitor shows before a new one."""
    lines = re.findall(r"^(?!MONITOR)(?:>|\.|.* \?)(?:$| (.*)$)", session, re.MULTILINE)
    return "".join(f"{re.sub('[0-9A-F]{2}-', '', line)}\n" for line in lines)


@pytest.mark.parametrize("session", [*SESSIONS, *WALKS])
def test_every_session_of_the_page_runs_as_shown(session, tmp_path):
    host = tmp_path / "program.txt"
    host.write_text(PROGRAM)
    (tmp_path / "STEPS.HEX").write_text(TAPE)
    screen = Script(typed(session).encode())
    machine = edmsim.Machine.load(height_mm=10.0)
    Session(Rig(machine, resolution="fast"), screen, Interrupts(), host=host, tapes=tmp_path,
            monitor=session.startswith("MONITOR")).run()  # fmt: skip
    shown = screen.printed.decode().replace("\r\n", "\n").removesuffix("> \n").removesuffix(". \n")
    assert comparable(shown) == comparable(session)


def test_the_page_shows_a_whole_job_and_what_goes_wrong():
    assert len(SESSIONS) == 7
    assert len(WALKS) == 1
    assert JOB in SESSIONS[0]
    for word in ("START", "WAIT", "BYE", "MAIN", "EM", "INIT", "GO", "LOAD", "RUN", "KEY 1100 X START"):
        assert any(f"> {word}\n" in f"{session}\n" for session in SESSIONS)
