"""Installations from a wheel, a checkout, and a checkout whose links are plain files have the files of the tree."""

import os
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from collections import Counter
from pathlib import Path

import matplotlib
import pytest

from edmsim.compiled import cache
from edmsim.errors import STOPPED
from tests.plant.test_determinism import HASH, in_this_process

ROOT = Path(__file__).parents[1]
LINKS = ("controllers", "envs", "models")
PUNCH = "G21 G90\nG0 X-2 Y0.5\nG41 D1\nG1 X0 Y0.5\nY1\nX1\nY0\nX0\nY0.5\nG40\nM2\n"
BUILD = "from setuptools import build_meta as b; print(b.build_{kind}('dist'))"


def product():
    """Files of the product by their path in an installation."""
    found = set()
    for folder in ("edmsim", *LINKS):
        for file in (ROOT / folder).rglob("*"):
            inside = file.relative_to(ROOT / folder)
            linked = folder == "edmsim" and inside.parts[0] in LINKS
            if file.is_file() and not linked and "__pycache__" not in inside.parts:
                found.add((Path("edmsim") / ("" if folder == "edmsim" else folder) / inside).as_posix())
    return found


def checkout(to, *, links):
    """Copy the files for a build, with the links as links, or as text files, which some systems make instead."""
    to.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, to / name)
    for name in ("edmsim", *LINKS):
        shutil.copytree(ROOT / name, to / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    if not links:
        for name in LINKS:
            target = os.readlink(to / "edmsim" / name)
            (to / "edmsim" / name).unlink()
            (to / "edmsim" / name).write_text(target, encoding="utf-8")
    return to


def run(*command, at, path=None, status=0):
    """Run a command that can import only its own Python files and those of `path`; return its output.

    Its cache of compiled code is in `at`.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["XDG_CACHE_HOME"] = str(at / "cache")  # of which nothing is kept
    environment["MPLCONFIGDIR"] = matplotlib.get_cachedir()  # shared, because the list of fonts takes seconds to make
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=at, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize("links", [True, False])
def test_a_bare_checkout_is_imported_as_it_is(tmp_path, links):
    tree = checkout(tmp_path / "tree", links=links)
    code = (
        "import edmsim, edmsim.envs, edmsim.models, edmsim.controllers.mcu.computer\n"
        "print(edmsim.__file__, edmsim.envs.__file__, edmsim.models.__file__, edmsim.controllers.__file__)\n"
        "print(edmsim.Machine.load().height_mm)\n"
    )
    out = run(sys.executable, "-c", code, at=tmp_path, path=tree)
    assert all(Path(file).is_relative_to(tree) for file in out.split()[:4])
    assert out.split()[4] == "20.0"


@pytest.fixture(scope="module", params=[True, False], ids=["links", "no links"])
def wheel(request, tmp_path_factory):
    """The wheel of a checkout."""
    tree = checkout(tmp_path_factory.mktemp("wheel") / "tree", links=request.param)
    name = run(sys.executable, "-c", BUILD.format(kind="wheel"), at=tree).split()[-1]
    return tree / "dist" / name


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_wheel_holds_every_file_once(wheel):
    names = [name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name]
    assert max(Counter(names).values()) == 1
    assert set(names) == product()


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_source_archive_holds_every_file_once(tmp_path):
    tree = checkout(tmp_path / "tree", links=True)
    name = run(sys.executable, "-c", BUILD.format(kind="sdist"), at=tree).split()[-1]
    with tarfile.open(tree / "dist" / name) as archive:
        files = [member.name.partition("/")[2] for member in archive.getmembers() if not member.isdir()]
    packed = [name for name in files if name.split("/")[0] in ("edmsim", *LINKS)]
    inside = [name if name.split("/")[0] == "edmsim" else f"edmsim/{name}" for name in packed]
    assert max(Counter(inside).values()) == 1
    assert product() <= set(inside)


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("wheel", [True], indirect=True)
def test_an_installed_wheel_cuts_the_same_bits(wheel, tmp_path):
    """In an environment outside the tree that has the dependencies of this one, but not its edmsim.

    It starts with this tree's cache of compiled code, less the machine code of the pulse loop, which it makes from
    the rest: the name of the cache's folder ensures that both have the same sources.
    """
    venv.create(tmp_path / "clean", symlinks=True)
    programs = tmp_path / "clean" / "bin"
    pip = (sys.executable, "-m", "pip", "--python", programs / "python", "--quiet")
    run(*pip, "install", "--no-compile", "--no-index", "--no-deps", wheel, at=tmp_path)
    site = Path(run(programs / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", at=tmp_path))
    # the .pth file makes the dependencies importable, but not their own .pth files, one of which leads to this tree
    cached = cache.folder.relative_to(cache.folder.parents[2])
    shutil.copytree(cache.folder, tmp_path / "cache" / cached, ignore=shutil.ignore_patterns("*.o", "*.lock"))
    (site / "dependencies.pth").write_text(f"{Path(pytest.__file__).parents[1]}\n", encoding="utf-8")
    # a drive's sample function is compiled first: the loop's bits must not depend on code compiled before it
    drive_first = f"from edmsim.controllers import axis\naxis.from_text('uhu').sample.address\n{HASH}"
    place = "import edmsim.envs\nprint(edmsim.envs.__file__)\n"
    found, digest = run(programs / "python", "-c", place + drive_first, at=tmp_path).splitlines()
    assert Path(found).is_relative_to(site)
    assert digest == in_this_process()
    (tmp_path / "punch.ngc").write_text(PUNCH, encoding="utf-8")
    run(programs / "edmsim", "cut", "punch.ngc", "--out", "out", "--height", "5", "--resolution", "fast",
        "--max-time", "0.2", "--quiet", at=tmp_path, status=STOPPED)  # fmt: skip
    assert (tmp_path / "out" / "windows.parquet").is_file()
    assert list((tmp_path / "cache" / "edmsim" / "compiled").iterdir()) == [tmp_path / "cache" / cached]
    assert list((tmp_path / "cache" / cached).glob("*.o"))
