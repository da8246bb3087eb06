"""What the README shows runs as it stands there."""

import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_example_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(block, "README.md", "exec"), {})
    assert "spark" in capsys.readouterr().out


@pytest.mark.parametrize("line", re.findall(r"^    (edmsim cut (?!--help).*?)(?:  +#.*)?$", README, re.MULTILINE))
def test_every_cut_in_the_readme_cuts(line, tmp_path, monkeypatch):
    from edmsim.cli import app

    monkeypatch.chdir(ROOT)
    words = shlex.split(line)[1:]
    words[words.index("--out") + 1] = str(tmp_path / "out")
    with pytest.raises(SystemExit) as left:
        app([*words, "--max-time", "5", "--resolution", "fast", "--quiet"])
    assert left.value.code in (0, 3)  # 3: stopped by the time limit added here
    assert (tmp_path / "out" / "report.json").is_file()
