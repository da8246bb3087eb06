"""How the pulse loop is compiled: numba, without the GIL, cached under a key that covers all its sources.

numba's own cache looks only at the file a function stands in. The pulse loop calls functions of several
files, so a change in one of them would go unnoticed and old machine code would run. Here the cache folder is
named after a digest of every source file of this package, and of numba and the processor.
"""

from __future__ import annotations

import getpass
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

_P = ParamSpec("_P")
_R = TypeVar("_R")
_FOLDERS_KEPT = 4
# NaN and infinity keep their meaning: the loop tests for them. The rest lets sums be vectorised.
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
# Everything is inlined into one function, and arrays are not reference-counted: their owner, the plant, outlives
# the call, and the atomic counting took a third of the loop's time. So nothing in the loop may allocate.
_OPTIONS: dict[str, Any] = {
    "cache": True, "nogil": True, "fastmath": FAST, "error_model": "numpy", "forceinline": True, "_nrt": False,
}


def _source_digest() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    root = (Path(base) if base else Path.home() / ".cache") / "edmsim" / "compiled"
    folder = root / _source_digest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        if not os.access(folder, os.W_OK):
            raise PermissionError(folder)
        _drop_old(root)
    except OSError:
        return Path(tempfile.gettempdir()) / f"edmsim-compiled-{getpass.getuser()}" / folder.name
    return folder


def _drop_old(root: Path) -> None:
    by_age = sorted(root.iterdir(), key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in by_age[_FOLDERS_KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)


_FOLDER = _cache_folder()


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function of the pulse loop: no Python objects, no GIL, machine code kept between runs."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_FOLDER)
    try:
        jit = numba.njit(**_OPTIONS)
        return cast("Callable[_P, _R]", jit(function))
    finally:
        config.CACHE_DIR = before
