"""What tests of a machine's choices share."""

from __future__ import annotations

from typing import Any

import pytest

from edmsim.errors import InputError
from edmsim.machine.machine import Machine


def refusal(**choices: Any) -> str:
    with pytest.raises(InputError) as caught:
        Machine.load(**choices)
    text = str(caught.value)
    assert "\n" not in text
    return text
