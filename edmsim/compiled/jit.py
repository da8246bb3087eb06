"""How compiled code is made: numba, without the GIL, cached under a key that covers all its sources.

numba's own cache looks only at the file in which a function stands. Compiled code calls functions of several files,
so a change in one of them would go unnoticed and old machine code would run. Here the cache folder is named after a
digest of every file that compiles something, of all they import, and of numba and the processor. Each file in it ends
with a digest of itself: damaged machine code is compiled anew and never run.
"""

from __future__ import annotations

import atexit
import hashlib
import io
import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import caching

_P = ParamSpec("_P")
_R = TypeVar("_R")
_PACKAGE = Path(__file__).parents[1]
_BESIDE = "controllers", "envs"
_COMPILES = b"edmsim.compiled.jit import"
_IMPORT = re.compile(r"^ *from (edmsim[\w.]*) import (?:\(([\w,\s]*)\)|([\w, ]*))", re.M)
_KEPT_S = 30 * 24 * 3600.0
_BOUNDS_CHECKED = bool(numba.config.BOUNDSCHECK)  # type: ignore[attr-defined]
# NaN and infinity keep their meaning: the loop tests for them. The rest lets sums be vectorised.
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
# Everything is inlined into one function, and arrays are not reference-counted: their owner, the plant, outlives
# the call, and the atomic counting took a third of the loop's time. So nothing in the loop may allocate.
_OPTIONS: dict[str, Any] = {
    "cache": True, "nogil": True, "fastmath": FAST, "error_model": "numpy", "forceinline": True, "_nrt": False,
}
_EXACT: dict[str, Any] = {"fastmath": False, "forceinline": False}
_UNWRAPPED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_wrappers: dict[str, Any] = {}
"""`_UNWRAPPED` for functions that only compiled code calls: each wrapper is compiled with a copy of its function."""


def _files() -> dict[str, Path]:
    """Return every module of edmsim and its file; controllers and environments stand in top-level folders."""
    found = {}
    for folder in (_PACKAGE, *(f for name in _BESIDE if (f := _PACKAGE.parent / name).is_dir())):
        above = folder if folder == _PACKAGE else folder.parent
        for file in folder.rglob("*.py"):
            found["edmsim." + ".".join(file.relative_to(above).with_suffix("").parts)] = file
    return found


def _sources() -> list[bytes]:
    """Return the text of every module that compiles something, and of what these import, over any number of steps."""
    texts = {module: file.read_bytes() for module, file in _files().items()}
    waiting = {module for module, text in texts.items() if _COMPILES in text}
    found: set[str] = set()
    while waiting:
        module = waiting.pop()
        found.add(module)
        for package, listed, named in _IMPORT.findall(texts[module].decode("utf-8")):
            names = [words.split()[0] for words in (listed or named).split(",") if words.strip()]
            imported = {package, *(f"{package}.{name}" for name in names)}
            waiting |= (imported & texts.keys()) - found
    return [texts[module] for module in sorted(found)]


def _source_digest() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {_BOUNDS_CHECKED}".encode())
    for text in _sources():
        digest.update(text)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """Return the folder of these sources: under the user's own, or else, where that cannot be, one of this run."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        root = (Path(base) if base else Path.home() / ".cache") / "edmsim" / "compiled"
        folder = root / _source_digest()
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        if not os.access(folder, os.W_OK):
            raise PermissionError(folder)
        _drop_unused(root)
    except (OSError, RuntimeError):  # the latter where the user has no home
        folder = Path(tempfile.mkdtemp(prefix="edmsim-compiled-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _drop_unused(root: Path) -> None:
    """Delete what no checkout has used for a long time; each import of edmsim touches its own folder."""
    for folder in root.iterdir():
        if time.time() - folder.stat().st_mtime > _KEPT_S:
            shutil.rmtree(folder, ignore_errors=True)


_folder = _cache_folder()


def folder() -> Path:
    """Return where machine code is kept."""
    return _folder


def use_folder(path: Path) -> None:
    """Keep the machine code of functions that are decorated from now on in another folder."""
    global _folder
    _folder = path


_kept_alone: _CheckedFiles | None = None
"""In a process that compiles for one function only, that function's files; nothing else is loaded or saved."""


class _CheckedFiles(caching.IndexDataCacheFile):
    """Files of a function's machine code, each with its digest at its end; a damaged one is as if there were none."""

    def load(self, key: Any) -> Any:
        return super().load(key) if _kept_alone is None else None  # type: ignore[no-untyped-call]

    def save(self, key: Any, data: Any) -> None:
        if _kept_alone not in (None, self):
            return
        with suppress(OSError):  # what cannot be kept, on a full disk say, is compiled again the next time
            super().save(key, data)  # type: ignore[no-untyped-call]

    def _data_name(self, _: int) -> Any:
        # numbered in turn, two processes that compile at once would take the same name for different code
        return super()._data_name(secrets.randbits(48))  # type: ignore[no-untyped-call]

    def _load_index(self) -> Any:
        return super()._load_index() if _is_whole(self._index_path) else {}  # type: ignore[no-untyped-call]

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)  # type: ignore[no-untyped-call]
        if not _is_whole(path):
            raise FileNotFoundError(path)
        return super()._load_data(name)  # type: ignore[no-untyped-call]

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())


def _is_whole(path: str) -> bool:
    """Whether a file is there and ends with the digest of what comes before."""
    try:
        content = Path(path).read_bytes()
    except OSError:
        return False
    size = hashlib.sha256().digest_size
    return hashlib.sha256(content[:-size]).digest() == content[-size:]


def is_kept(function: Any, signature: tuple[Any, ...]) -> bool:
    """Whether the cache has a compiled function's machine code for arguments of these types."""
    cache = function._cache
    key = cache._index_key(signature, function.targetdescr.target_context.codegen())
    return cache._cache_file.load(key) is not None


def keep_alone(function: Any) -> None:
    """From now on load nothing from the cache, and save only this function's machine code."""
    global _kept_alone
    _kept_alone = function._cache._cache_file


@contextmanager
def only_called_by_compiled_code() -> Iterator[None]:
    """Decorate functions that this process will not call from Python: they compile in less than half the time."""
    _wrappers.update(_UNWRAPPED)
    yield
    _wrappers.clear()


def in_cache(make: Callable[[Any], Any], function: Callable[..., Any]) -> Any:
    """Apply one of numba's decorators to a function, its machine code kept in the folder of these sources."""
    config: Any = numba.config
    before = config.CACHE_DIR, caching.IndexDataCacheFile
    config.CACHE_DIR = str(_folder)
    caching.IndexDataCacheFile = _CheckedFiles  # type: ignore[misc]
    try:
        return make(function)
    finally:
        config.CACHE_DIR, caching.IndexDataCacheFile = before  # type: ignore[misc]


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function: no Python objects, no GIL, machine code kept between runs."""
    return cast("Callable[_P, _R]", in_cache(numba.njit(**_OPTIONS, **_wrappers), function))


def compiled_apart(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function that is called, not inlined: what is seldom needed leaves the loop around it as it is."""
    return cast("Callable[_P, _R]", in_cache(numba.njit(**{**_OPTIONS, **_wrappers, "forceinline": False}), function))


def exactly_compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile what runs a few times per window: every operation is rounded as it is written.

    Functions are called and not inlined, which takes a fraction of the time to compile.
    """
    return cast("Callable[_P, _R]", in_cache(numba.njit(**{**_OPTIONS, **_wrappers, **_EXACT}), function))
