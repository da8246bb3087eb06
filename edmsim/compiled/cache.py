"""The cache of machine code: a folder whose name is a digest of all sources.

The folder is named after a digest of every file that compiles something, of all they import, and of the compiler.
Each file in it ends with a digest of itself: damaged machine code is compiled again and never run.
"""

import atexit
import hashlib
import os
import re
import secrets
import shutil
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_TOP_LEVEL = "controllers", "envs"
_COMPILES = b"edmsim.compiled.jit import"
_IMPORT = re.compile(r"^ *from (edmsim[\w.]*) import (?:\(([\w,\s]*)\)|([\w, ]*))", re.M)
_UNUSED_S = 30 * 24 * 3600.0
_DIGEST = hashlib.sha256().digest_size


def _files() -> dict[str, Path]:
    """Return every module of edmsim and its file; controllers and environments stand in top-level folders."""
    found = {}
    for folder in (_PACKAGE, *(f for name in _TOP_LEVEL if (f := _PACKAGE.parent / name).is_dir())):
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
    compilers = f"{version('numba')} {version('llvmlite')} {os.environ.get('NUMBA_BOUNDSCHECK')}"
    digest = hashlib.sha256(compilers.encode())
    for text in _sources():
        digest.update(text)
    return digest.hexdigest()[:16]


def user_folder() -> Path:
    """Return the folder of all that edmsim keeps for this user; raises `RuntimeError` where the user has no home."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "edmsim"


def _cache_folder() -> Path:
    """Return the folder of these sources: under the user's own, or else, where that cannot be, one of this run."""
    try:
        root = user_folder() / "compiled"
        own = root / _source_digest()
        own.mkdir(parents=True, exist_ok=True)
        own.touch()
        if not os.access(own, os.W_OK):
            raise PermissionError(own)
        _drop_unused(root)
    except (OSError, RuntimeError):  # the latter where the user has no home
        own = Path(tempfile.mkdtemp(prefix="edmsim-compiled-"))
        atexit.register(shutil.rmtree, own, ignore_errors=True)
    return own


def _drop_unused(root: Path) -> None:
    """Delete what no checkout has used for a long time; each import of edmsim touches its own folder."""
    for other in root.iterdir():
        if time.time() - other.stat().st_mtime > _UNUSED_S:
            shutil.rmtree(other, ignore_errors=True)


folder = _cache_folder()  # where machine code is kept


def signed(content: bytes) -> bytes:
    """Return a file's content with its digest at the end."""
    return content + hashlib.sha256(content).digest()


def read_signed(path: Path) -> bytes | None:
    """Return a file's content without its digest; None if there is no such file or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    content, digest = content[:-_DIGEST], content[-_DIGEST:]
    return content if hashlib.sha256(content).digest() == digest else None


def write_signed(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; raises `OSError` where it cannot be."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
    try:
        temporary.write_bytes(signed(content))
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
