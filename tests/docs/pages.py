"""Reads what the pages of the documentation show: blocks of code, commands, and code between backticks."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
BIN = ".venv/bin/"
COMMANDS = ("edmsim", "python", "python3", "pip", "make", "source", ".", "rerun", "tensorboard", "ray")
"""Words that a line of a command begins with, perhaps behind the folder of a virtual environment."""
_FENCE = re.compile(r"(?P<indent> *)(?P<ticks>`{3,}|~{3,})\s*(?P<info>.*)")
_FILE = re.compile(r"(?:#|//|<!--) (?P<name>[\w.-]+\.\w+)(?: -->)?\s*")


class Block(NamedTuple):
    """A block of code.

    Attributes
    ----------
    place : str
        Page and line, ``docs/training.md:5``.
    kind : str
        What stands behind the fence; ``sh`` of an indented block of commands.
    text : str
    """

    place: str
    kind: str
    text: str

    @property
    def file(self) -> str | None:
        """Name of the file the block shows, if its first line is a comment with nothing but that name."""
        first = _FILE.fullmatch(self.text.split("\n", 1)[0])
        return first["name"] if first else None

    @property
    def commands(self) -> list[list[str]]:
        """Words of the commands of a block, line by line, without comments; a backslash joins two lines."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [words for line in lines if (words := shlex.split(line, comments=True))]


def pages() -> list[str]:
    """Return README and all pages of the documentation, by their place in the repository."""
    docs = (file.relative_to(ROOT) for file in (ROOT / "docs").rglob("*.md"))
    return ["README.md", *sorted(str(page) for page in docs if not any(part.startswith("_") for part in page.parts))]


def read(page: str) -> str:
    """Return a page's text."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str) -> list[Block]:
    """Return a page's fenced blocks, and its indented ones that hold commands."""
    found, lines = [], read(page).splitlines()
    at = 0
    while at < len(lines):
        fence = _FENCE.fullmatch(lines[at])
        first = at + 1
        if fence:
            at = next(i for i in range(first, len(lines)) if lines[i].strip() == fence["ticks"])
            info = fence["info"].split() or [""]
            if info[0] in ("{code-block}", "{code}", "{code-cell}"):
                info = info[1:]
            if not info[0].startswith("{"):  # other directives of the site show no code
                body = [line.removeprefix(fence["indent"]) for line in lines[first:at]]
                found.append(Block(f"{page}:{first}", info[0], "\n".join(body)))
        elif lines[at].startswith("    ") and not (at and lines[at - 1].strip()):
            body = []
            while at < len(lines) and lines[at].startswith("    "):
                body.append(lines[at][4:])
                at += 1
            if any(is_command(line) for line in body):
                found.append(Block(f"{page}:{first}", "sh", "\n".join(body)))
        at += 1
    return found


def is_command(line: str) -> bool:
    """Return whether a line is a shell command."""
    word = (line.split() or [""])[0]
    return word.removeprefix(BIN) in COMMANDS and line.strip() != word


def quoted(page: str) -> list[str]:
    """Return what stands between single backticks outside of blocks, on one line each."""
    text, fenced = [], False
    for line in read(page).splitlines():
        if _FENCE.fullmatch(line):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            text.append(line)
    return [" ".join(code.split()) for code in re.findall(r"(?<!`)`([^`]+)`(?!`)", "\n".join(text))]
