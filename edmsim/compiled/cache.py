"""The cache of machine code.

The name of its folder is a digest of all files that compile something, of everything they import, and of the
compiler's version. Each file in it ends with its own digest, so damaged machine code is compiled again and never run.
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
    """Return the file of every module of edmsim; controllers and environments are in top-level folders."""
    found = {}
    for folder in (_PACKAGE, *(f for name in _TOP_LEVEL if (f := _PACKAGE.parent / name).is_dir())):
        above = folder if folder == _PACKAGE else folder.parent
        for file in folder.rglob("*.py"):
            found["edmsim." + ".".join(file.relative_to(above).with_suffix("").parts)] = file
    return found


def _sources() -> list[bytes]:
    """Return the text of every module that compiles something, and of all that it imports, also indirectly."""
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
    """Return the user's cache folder of edmsim; raises `RuntimeError` if the user has no home."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "edmsim"


def _cache_folder() -> Path:
    """Return the folder of these sources; if it cannot be written, a temporary one for this process."""
    try:
        root = user_folder() / "compiled"
        own = root / _source_digest()
        own.mkdir(parents=True, exist_ok=True)
        own.touch()
        if not os.access(own, os.W_OK):
            raise PermissionError(own)
        _drop_unused(root)
    except (OSError, RuntimeError):  # the latter if the user has no home
        own = Path(tempfile.mkdtemp(prefix="edmsim-compiled-"))
        atexit.register(shutil.rmtree, own, ignore_errors=True)
    return own


def _drop_unused(root: Path) -> None:
    """Delete folders that have not been used for a long time; every import of edmsim touches its own."""
    for other in root.iterdir():
        if time.time() - other.stat().st_mtime > _UNUSED_S:
            shutil.rmtree(other, ignore_errors=True)


folder = _cache_folder()  # where machine code is cached


def signed(content: bytes) -> bytes:
    """Return a content followed by its digest."""
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
    """Write a file completely or not at all; raises `OSError` if it cannot be written."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
    try:
        temporary.write_bytes(signed(content))
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
