"""The cache of compiled code: damaged files are made anew, and it needs neither a home nor a shared folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """\
from edmsim.compiled.jit import compiled, _folder

@compiled
def twice(x):
    return 2.0 * x

print(twice(21.0), sum(twice.stats.cache_hits.values()), _folder, oct(_folder.stat().st_mode & 0o777))
"""


def run(folder: Path, before: str = "", **environment: str) -> list[str]:
    """Compile a function in another process: its result, whether it was in the cache, the cache's folder and mode."""
    script = folder / "script.py"
    if not script.exists():  # to the cache a newer file is another one
        script.write_text(SCRIPT)
    code = f"import runpy\n{before}\nrunpy.run_path({str(script)!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def truncated(content: bytes) -> bytes:
    return content[: len(content) * 2 // 3]


def flipped(content: bytes) -> bytes:
    at = len(content) // 2
    return content[:at] + bytes(255 - byte for byte in content[at : at + 64]) + content[at + 64 :]


@pytest.mark.slow
def test_damaged_files_are_compiled_anew(tmp_path: Path) -> None:
    """A truncated one aborted the interpreter."""
    cache = tmp_path / "cache"
    assert run(tmp_path, XDG_CACHE_HOME=str(cache))[:1] == ["42.0"]
    for suffix, damage in ((".nbi", truncated), (".nbc", flipped), (".nbc", truncated)):
        file = max(cache.rglob(f"script.twice*{suffix}"), key=lambda file: file.stat().st_mtime_ns)
        damaged = damage(file.read_bytes())
        file.write_bytes(damaged)
        assert run(tmp_path, XDG_CACHE_HOME=str(cache))[:2] == ["42.0", "0"]
        assert file.read_bytes() != damaged
    assert run(tmp_path, XDG_CACHE_HOME=str(cache))[:2] == ["42.0", "1"]


@pytest.mark.slow
def test_without_a_home_the_cache_is_a_folder_of_this_run(tmp_path: Path) -> None:
    """Not one under a name that another user of the machine could foresee and fill."""
    homeless = (
        "import os, pathlib\n"
        "def home(): raise RuntimeError('Could not determine home directory.')\n"
        "pathlib.Path.home = home\n"
        "os.environ.pop('XDG_CACHE_HOME', None)\n"
    )
    shared = tmp_path / "shared"
    shared.mkdir()
    folders = set()
    for _ in range(2):
        *_, folder, mode = run(tmp_path, homeless, TMPDIR=str(shared))
        assert mode == "0o700"
        assert Path(folder).parent == shared
        folders.add(folder)
    assert len(folders) == 2
    assert list(shared.iterdir()) == []


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_to_does_not_stop_the_work(tmp_path: Path) -> None:
    full = (
        "import os\n"
        "def replace(*_, **__): raise OSError(28, 'No space left on device')\n"
        "os.replace = replace\n"
    )
    assert run(tmp_path, full, XDG_CACHE_HOME=str(tmp_path / "cache"))[0] == "42.0"


def test_two_kinds_kept_at_once_are_not_mixed_up(tmp_path: Path) -> None:
    """Two processes that know of no code take names for theirs: never the same one, for different code."""
    from edmsim.compiled.jit import _CheckedFiles

    first, second = (_CheckedFiles(str(tmp_path), "twice", "stamp") for _ in range(2))
    assert first._data_name(1) != second._data_name(1)
    first.save("floats", "code for floats")
    second.save("whole numbers", "code for whole numbers")
    assert first.load("floats") == "code for floats"
    assert first.load("whole numbers") == "code for whole numbers"


ADDERS = """\
from edmsim.compiled.jit import compiled

@compiled
def times(factor, x):
    return factor * x

def adder(factor):
    @compiled
    def add(a, b):
        return a + times(factor, b)
    return add
"""
AFRESH = """\
from edmsim.compiled.afresh import made_afresh
import adders

add = made_afresh(adders.adder, 3)
print(add(1, 2), sum(add.stats.cache_hits.values()))
"""


def afresh(folder: Path, before: str = "") -> list[str]:
    return made_afresh(folder, before).stdout.split()


def made_afresh(folder: Path, before: str) -> subprocess.CompletedProcess[str]:
    (folder / "adders.py").write_text(ADDERS)
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    code = f"import sys\nsys.path.insert(0, {str(folder)!r})\n{before}\n{AFRESH}"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
def test_what_is_made_afresh_is_compiled_alone_in_a_process_of_its_own(tmp_path: Path) -> None:
    """So its bits do not depend on what else a process compiled before, nor is that kept."""
    assert afresh(tmp_path, "import adders; adders.times(2, 2)") == ["7", "1"]
    kept = {file.name.split("-")[0] for file in (tmp_path / "cache").rglob("*.nbi")}
    assert kept == {"adders.times", "adders.adder.locals.add"}


@pytest.mark.slow
def test_without_another_process_this_one_compiles(tmp_path: Path) -> None:
    assert afresh(tmp_path, "sys.executable = '/nowhere/python'") == ["7", "0"]


@pytest.mark.slow
def test_a_notebook_says_that_code_is_compiled_unless_it_is_to_show_no_progress(tmp_path: Path) -> None:
    notebook = "import os; sys.modules['ipykernel'] = sys"
    quiet = made_afresh(tmp_path, f"{notebook}; os.environ['EDMSIM_PROGRESS'] = '0'")
    assert quiet.stderr == ""
    shutil.rmtree(tmp_path / "cache")
    assert "compiles its pulse loop" in made_afresh(tmp_path, notebook).stderr
    assert made_afresh(tmp_path, notebook).stderr == ""  # it is in the cache
