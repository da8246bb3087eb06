"""What docs/figures.md and docs/calibration.md show runs as it stands there."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

from edmsim import cli

ROOT = Path(__file__).parents[1]
SHORT = {"cut": ("--max-time", 40, "--resolution", "fast", "--quiet"), "report": (), "calibrate": ("--json",)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["figures", "calibration"])
def test_the_commands_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        monkeypatch.setattr(sys, "argv", [*words, *map(str, SHORT[words[1]])])
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert left.value.code in (0, None, 3)  # 3: stopped by the time limit added here


@pytest.mark.slow
def test_the_python_of_the_figures_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(block, "figures.md", "exec"), {})
    assert {file.name for file in tmp_path.glob("*.pdf")} == {"corner.pdf", "pulses.pdf", "delay.pdf", "campbell.pdf"}


def test_the_figures_shown_are_there() -> None:
    page = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")
    shown = re.findall(r"\]\((figures/.*?\.png)\)", page)
    assert len(shown) == 7
    for place in shown:
        assert (ROOT / "docs" / place).read_bytes().startswith(b"\x89PNG")
