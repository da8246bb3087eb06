"""The fields of a record as its source declares them, with the comments above and after them."""

import inspect
import re
from collections.abc import Iterator
from typing import NamedTuple


class Field(NamedTuple):
    """A field, or several if a comment names them: ``# least, most: ...``."""

    names: list[str]
    kind: str  # type as declared
    meaning: str  # empty if it has no comment
    is_state: bool  # true if it is not an argument


def declared_fields(record: type) -> Iterator[Field]:
    """Yield the fields that a class itself declares, also those without a comment."""
    above: list[str] = []
    described: list[str] = []
    for line in inspect.getsource(record).partition('"""\n')[2].splitlines():
        if comment := re.match(r" {4}# (.*)", line):
            above.append(comment[1])
        elif field := re.match(r" {4}(\w+): (.*?)(?: = (.*?))?(?:  # (.*))?$", line):
            meaning = " ".join([*above, field[4] or ""]).strip()
            above = []
            if field[1] in described or field[2].startswith("ClassVar"):
                continue
            named = re.match(r"(\w+(?:, \w+)+): (.*)", meaning)
            described = named[1].split(", ") if named else [field[1]]
            meaning = named[2] if named else meaning
            yield Field(described, field[2], meaning[:1].upper() + meaning[1:], "init=False" in (field[3] or ""))
        elif re.match(r" {4}(def|@)", line):
            break
