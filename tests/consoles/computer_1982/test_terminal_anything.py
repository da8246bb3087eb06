"""Whatever is typed: the session ends, the machine is left safe, and only the words that move it move it."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import edmsim
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.controllers.mcu.firmware import memory_map as at

from .conftest import run_script

MACHINE = edmsim.Machine.load(height_mm=5.0)
NUMBERS = st.one_of(st.integers(-20, 40), st.sampled_from([300, 65_536, "AAH", "0H", "", "-"]))
MOVES = ("START", "RUN", "GO", "X", "Y", "YES")
WORDS = st.sampled_from(
    ["HELP", "STATUS", "POS", "NEW", "CW", "CCW", "NEW 32520 32510", "TI 30 TP 100", "TI", "TP", "SPEED", "GEN ON",
     "GEN OFF", "WAIT 1", "MAIN", "LOAD", "LIST", "STOP", "EM", "INIT", "WIRE", "", "NO", *MOVES]
)  # fmt: skip
LINES = st.one_of(
    st.tuples(WORDS, st.lists(NUMBERS, max_size=4)).map(lambda line: " ".join(map(str, [line[0], *line[1]]))),
    st.text(max_size=70),
)


@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(LINES, max_size=25))
def test_whatever_is_typed_the_session_ends_and_the_machine_is_safe(lines):
    rig = Rig(MACHINE, seed=1, resolution="fast")
    assert run_script(rig, *lines).status in (0, 2, 3)
    assert (rig.board.generator_on, rig.moving) == (False, False)
    assert rig.computer.pulse_codes == (0, 0)
    if not any(move in line.upper() for line in lines for move in MOVES):
        assert rig.place_um == (32_500.0, 32_500.0)


ADDRESSES = st.one_of(
    st.sampled_from([area.first + k for area in at.MAP for k in range(min(area.bytes, 12))]),
    st.integers(0x4000, 0x4034), st.integers(0, 0xFFFF),
)  # fmt: skip
ALTERED = st.one_of(
    st.tuples(ADDRESSES, st.integers(0, 0xFF)).map(lambda pair: f"S {pair[0]:04X} {pair[1]:02X}"),
    st.sampled_from(["D 4000,4034", "G 0210", "G 3400", "G 0200", "G 0300"]),
    st.text("DSRHPGM? ,0123456789ABCDEF", max_size=12),
)


@pytest.mark.slow
@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(ALTERED, max_size=12), st.booleans())
def test_whatever_the_monitor_alters_in_a_cut_the_session_ends_and_the_machine_is_safe(lines, cutting):
    rig = Rig(MACHINE, seed=1, resolution="fast")
    cut = ["TI 30 TP 100", "NEW 32540 32500", "START", "WAIT 1"] if cutting else []
    typed = ["G 0400", *cut, "MON", *lines, "G", "WAIT 1", "STATUS", "LIST", "START", "WAIT 1", "STOP", "BYE"]
    assert run_script(rig, *typed, monitor=True, tapes=Path("/nonexistent")).status in (0, 2, 3)
    assert (rig.board.generator_on, rig.moving) == (False, False)
    assert rig.computer.pulse_codes == (0, 0)
