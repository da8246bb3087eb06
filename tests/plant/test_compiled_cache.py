"""The cache of compiled code: damaged files are compiled again, and it needs neither a home nor a shared folder."""

import importlib
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edmsim.compiled import cache
from edmsim.compiled.specialised import specialised

SCRIPT = """\
from edmsim.compiled.jit import compiled

@compiled
def twice(x):
    return 2.0 * x

result, hits = twice(21.0), sum(twice.stats.cache_hits.values())
"""


@pytest.fixture
def script(tmp_path):
    file = tmp_path / "script.py"
    file.write_text(SCRIPT)
    return file


def truncated(content):
    return content[: len(content) * 2 // 3]


def flipped(content):
    at = len(content) // 2
    return content[:at] + bytes(255 - byte for byte in content[at : at + 64]) + content[at + 64 :]


def test_damaged_files_are_compiled_anew(script, tmp_path, monkeypatch):
    """A truncated file aborted the interpreter."""
    monkeypatch.setattr(cache, "folder", tmp_path)

    def again():
        names = runpy.run_path(str(script))
        return names["result"], names["hits"]

    assert again() == (42.0, 0)
    for suffix, damage in ((".nbi", truncated), (".nbc", flipped), (".nbc", truncated)):
        file = max(tmp_path.rglob(f"script.twice*{suffix}"), key=lambda file: file.stat().st_mtime_ns)
        damaged = damage(file.read_bytes())
        file.write_bytes(damaged)
        assert again() == (42.0, 0)
        assert file.read_bytes() != damaged
    assert again() == (42.0, 1)


HOMELESS = """\
import os, pathlib
def home(): raise RuntimeError("Could not determine home directory.")
pathlib.Path.home = home
os.environ.pop("XDG_CACHE_HOME", None)
from edmsim.compiled.cache import folder
(folder / "code").touch()
print(folder, oct(folder.stat().st_mode & 0o777))
"""


@pytest.mark.slow
def test_without_a_home_the_cache_is_a_folder_of_this_run(tmp_path):
    """Its name is random, because another user could otherwise predict it and put files there."""
    folders = set()
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", HOMELESS], env={**os.environ, "TMPDIR": str(tmp_path)}, capture_output=True,
            text=True, check=True,
        )  # fmt: skip
        folder, mode = done.stdout.split()
        assert mode == "0o700"
        assert Path(folder).parent == tmp_path
        folders.add(folder)
    assert len(folders) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_cannot_be_written_to_does_not_stop_the_work(script, tmp_path, monkeypatch):
    def replace(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "folder", tmp_path)
    monkeypatch.setattr(os, "replace", replace)
    assert runpy.run_path(str(script))["result"] == 42.0


def test_two_kinds_stored_at_once_are_not_mixed_up(tmp_path):
    """Two processes that find no code in the cache choose different names for their different code."""
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


@pytest.fixture
def adders(tmp_path, monkeypatch):
    """A module with a program that is compiled for two constants; the cache is in the module's folder."""
    (tmp_path / "adders.py").write_text(ADDERS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(cache, "folder", tmp_path)
    yield importlib.import_module("adders")
    del sys.modules["adders"]


def use(adders, *constants):
    """Add some products to 1, each by machine code that is loaded or compiled."""
    total = np.array([[1]])
    for pair in constants:
        specialised(adders.add, *pair)(total.ctypes.data)
    return int(total[0, 0])


def cached(folder, suffix):
    """Content of the cache's files with a suffix."""
    return {file.name: file.read_bytes() for file in folder.rglob(f"add-*{suffix}")}


@pytest.mark.slow
def test_constants_put_in_later_give_the_same_code_in_any_order(adders, tmp_path, monkeypatch):
    """Earlier compilations do not matter either; a program is translated once; damaged code is compiled again.
    """
    assert use(adders, (3, 1)) == 7
    (file,), (code,) = tmp_path.rglob("add-*.bc"), tmp_path.rglob("add-*.o")
    written, whole = file.stat().st_mtime_ns, code.read_bytes()
    code.write_bytes(flipped(whole))
    assert use(adders, (3, 1), (5, 0)) == 1 + 3 * 2 + 5
    assert code.read_bytes() == whole
    assert file.stat().st_mtime_ns == written
    adders.times(2, 2)
    (tmp_path / "other").mkdir()
    monkeypatch.setattr(cache, "folder", tmp_path / "other")
    assert use(adders, (5, 0), (3, 1)) == 1 + 3 * 2 + 5
    for suffix in (".bc", ".o"):
        codes = cached(tmp_path / "other", suffix)
        assert len(codes) == (1 if suffix == ".bc" else 2)
        assert codes == {name: (tmp_path / name).read_bytes() for name in codes}


def test_a_compiler_that_cannot_be_started_is_named(adders, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(RuntimeError, match="no process can be started to compile the pulse loop"):
        use(adders, (3, 1))


@pytest.mark.slow
def test_where_nothing_can_be_stored_the_code_comes_by_the_compilers_output(adders, tmp_path, monkeypatch, capsys):
    """Tested in a notebook whose progress bars are off."""
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    monkeypatch.setenv("EDMSIM_PROGRESS", "0")
    monkeypatch.setattr(cache, "folder", Path("/proc/nowhere"))
    assert use(adders, (3, 1)) == 7
    assert cached(tmp_path, ".o") == {}
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_a_notebook_says_that_code_is_compiled(adders, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    use(adders, (4, 1))
    assert "compiles its pulse loop" in capsys.readouterr().err
    use(adders, (4, 1))
    assert capsys.readouterr().err == ""  # the code is in the cache
