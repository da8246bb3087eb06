"""Numbers with names as a command line has them, ``name=number,...``, and lists of controllers with such numbers."""

from __future__ import annotations

from edmsim.errors import InputError


def named_numbers(text: str, what: str) -> dict[str, float]:
    """Read ``name=number,...``, empty for none; `what` says in a message whose numbers they are."""
    found = {}
    for pair in filter(None, text.split(",")):
        key, equals, value = pair.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"{what} parameter '{pair}' must read name=number")
    return found


def listed(text: str) -> list[str]:
    """Split a list at its commas, but for those between the numbers of a controller: ``a:x=1,y=2,b`` is two."""
    pieces: list[str] = []
    for piece in text.split(","):
        if pieces and "=" in piece and ":" not in piece:
            pieces[-1] += f",{piece}"
        else:
            pieces.append(piece.strip())
    return [piece for piece in pieces if piece]
