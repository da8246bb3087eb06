"""Numbers with names as a command line has them: ``name=number,...``."""

from __future__ import annotations

from edmsim.errors import InputError


def named_numbers(text: str, what: str) -> dict[str, float]:
    """Read ``name=number,...``.

    Parameters
    ----------
    text : str
        Empty for none.
    what : str
        Whose numbers they are, for a message.

    Raises
    ------
    InputError
        A pair does not read so.
    """
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
