"""Every session shown in docs/terminal.md runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import edmsim
from edmsim.controllers.mcu.dialogue.help_texts import JOB
from edmsim.terminal.devices import Interrupts
from edmsim.terminal.rig import Rig
from edmsim.terminal.session import Session

from .conftest import Script

PAGE = (Path(__file__).parents[2] / "docs" / "terminal.md").read_text(encoding="utf-8")
SESSIONS = re.findall(r"```session\n(.*?)```", PAGE, re.DOTALL)
(PROGRAM,) = re.findall(r"```program\n(.*?)```", PAGE, re.DOTALL)
DEPENDS_ON_SPARKS = ("CUTTING", "SPEED", "GENERATOR", "EMERGENCY")
"""Figures in these lines differ between processors, whose sums round differently."""


def comparable(text: str) -> list[str]:
    lines = [line.rstrip() for line in text.strip().splitlines()]
    return [re.sub(r"[\d.]+", "#", line) if line.startswith(DEPENDS_ON_SPARKS) else line for line in lines]


def typed(session: str) -> str:
    """What was typed behind the prompts."""
    return "".join(f"{line}\n" for line in re.findall(r"^(?:>|.* \?)(?:$| (.*)$)", session, re.MULTILINE))


@pytest.mark.parametrize("session", SESSIONS)
def test_every_session_of_the_page_runs_as_shown(session, tmp_path):
    host = tmp_path / "program.txt"
    host.write_text(PROGRAM)
    screen = Script(typed(session).encode())
    machine = edmsim.Machine.load(height_mm=10.0)
    Session(Rig(machine, resolution="fast"), screen, Interrupts(), host=host).run()
    shown = screen.printed.decode().replace("\r\n", "\n").removesuffix("> \n")
    assert comparable(shown) == comparable(session)


def test_the_page_shows_a_whole_job_and_what_goes_wrong():
    assert len(SESSIONS) == 6
    assert JOB in SESSIONS[0]
    for word in ("START", "WAIT", "BYE", "MAIN", "EM", "INIT", "GO", "LOAD", "RUN", "KEY 1100 X START"):
        assert any(f"> {word}\n" in f"{session}\n" for session in SESSIONS)
