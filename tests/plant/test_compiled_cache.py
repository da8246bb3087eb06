"""The cache of compiled code: damaged files are made anew, and it needs neither a home nor a shared folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """\
from edmsim.compiled.cache import folder
from edmsim.compiled.jit import compiled

@compiled
def twice(x):
    return 2.0 * x

print(twice(21.0), sum(twice.stats.cache_hits.values()), folder, oct(folder.stat().st_mode & 0o777))
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


def test_two_kinds_stored_at_once_are_not_mixed_up(tmp_path: Path) -> None:
    """Two processes that know of no code take names for theirs: never the same one, for different code."""
    from edmsim.compiled.numba_internals import _SignedFiles

    first, second = (_SignedFiles(str(tmp_path), "twice", "stamp") for _ in range(2))
    assert first._data_name(1) != second._data_name(1)
    first.save("floats", "code for floats")
    second.save("whole numbers", "code for whole numbers")
    assert first.load("floats") == "code for floats"
    assert first.load("whole numbers") == "code for whole numbers"


ADDERS = """\
from edmsim.compiled.jit import compiled
from edmsim.plant.kernel.memory import _rows

@compiled
def times(factor, x):
    return factor * x

def add(place, factor, twice):
    rows = _rows(place, (1, 1))
    rows[0, 0] += times(factor, 2 if twice else 1)
"""
USE = """\
import numpy as np
from edmsim.compiled.specialised import specialised
import adders

total = np.array([[1]])
for constants in {constants}:
    specialised(adders.add, *constants)(total.ctypes.data)
print(total[0, 0])
"""


def use(folder: Path, *constants: tuple[int, int], before: str = "", cache: str = "cache") -> tuple[str, str]:
    """Add some products in another process: what it printed, and what it said beside."""
    module = folder / "adders.py"
    if not module.exists():
        module.write_text(ADDERS)
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / cache), "PYTHONDONTWRITEBYTECODE": "1"}
    code = f"import os, sys\nsys.path.insert(0, {str(folder)!r})\n{before}\n{USE.format(constants=constants)}"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def cached(folder: Path, suffix: str) -> dict[str, bytes]:
    """Content of the cache's files with a suffix."""
    return {file.name: file.read_bytes() for file in folder.rglob(f"add-*{suffix}")}


@pytest.mark.slow
def test_constants_put_in_later_give_the_same_code_in_any_order(tmp_path: Path) -> None:
    """Nor does it matter what the process itself had compiled before."""
    first = use(tmp_path, (3, 1), (5, 0))
    other = use(tmp_path, (5, 0), (3, 1), before="import adders; adders.times(2, 2)", cache="other")
    assert first == other == (str(1 + 3 * 2 + 5), "")
    for suffix in (".bc", ".o"):
        codes = cached(tmp_path / "cache", suffix)
        assert len(codes) == (1 if suffix == ".bc" else 2)
        assert codes == cached(tmp_path / "other", suffix)


@pytest.mark.slow
def test_a_program_is_translated_once_and_damaged_code_is_made_again(tmp_path: Path) -> None:
    use(tmp_path, (3, 1))
    program = cached(tmp_path, ".bc")
    (code,) = (tmp_path / "cache").rglob("add-*.o")
    whole = code.read_bytes()
    for damage in (truncated, flipped):
        code.write_bytes(damage(whole))
        assert use(tmp_path, (3, 1)) == ("7", "")
        assert code.read_bytes() == whole
    (file,) = (tmp_path / "cache").rglob("add-*.bc")
    written = file.stat().st_mtime_ns
    assert use(tmp_path, (4, 0)) == ("5", "")
    assert cached(tmp_path, ".bc") == program
    assert file.stat().st_mtime_ns == written


@pytest.mark.slow
def test_a_compiler_that_cannot_be_started_is_named(tmp_path: Path) -> None:
    before = "sys.executable = '/nowhere/python'"
    use_it = "from edmsim.plant.kernel.memory import window_function\nwindow_function(2, 8, 4, 0)"
    code = f"import sys\n{before}\n{use_it}"
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert "no process can be started to compile the pulse loop" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_where_nothing_can_be_stored_the_code_comes_by_the_compilers_output(tmp_path: Path) -> None:
    nowhere = "import adders, pathlib, edmsim.compiled.cache as c\nc.folder = pathlib.Path('/proc/nowhere')"
    assert use(tmp_path, (3, 1), before=nowhere)[0] == "7"
    assert cached(tmp_path, ".o") == {}


@pytest.mark.slow
def test_a_notebook_says_that_code_is_compiled_unless_it_is_to_show_no_progress(tmp_path: Path) -> None:
    notebook = "sys.modules['ipykernel'] = sys"
    assert use(tmp_path, (3, 1), before=f"{notebook}; os.environ['EDMSIM_PROGRESS'] = '0'")[1] == ""
    assert "compiles its pulse loop" in use(tmp_path, (4, 1), before=notebook)[1]
    assert use(tmp_path, (4, 1), before=notebook)[1] == ""  # it is in the cache
