"""A short form of the campaign: some inputs for every reader, found by hypothesis and by the campaign's own seeds."""

import faulthandler
import os
import pickle
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edmsim.compiled import specialised
from edmsim.consoles.computer_1982.session import FINE, STOPPED
from tests.campaigns import devices, guard
from tests.campaigns.__main__ import nth, run
from tests.campaigns.guard import judged
from tests.campaigns.mutation import mutated
from tests.campaigns.readers import READERS, Reader

SLOW = {"mjcf": 3, "terminal": 6, "dxf": 6, "checkpoint": 6, "policy": 6}
"""Inputs of readers that take tens of milliseconds; others read `INPUTS`."""
INPUTS = 20


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
@pytest.mark.filterwarnings("ignore")
def test_good_inputs_are_taken(name, tmp_path):
    """Else every reader that refuses whatever comes would pass."""
    for data in READERS[name].corpus:
        assert judged(READERS[name].read, data, tmp_path)[0] == "taken", data[:200]


@pytest.mark.parametrize("name", READERS)
@pytest.mark.filterwarnings("ignore")
def test_bad_inputs_are_refused_in_one_line(name, tmp_path):
    reader, refused = READERS[name], 0
    for n in range(SLOW.get(name, INPUTS)):
        data = nth(reader, 0, n)
        what, wrong = judged(reader.read, data, tmp_path)
        assert not [kind for kind in wrong if not kind.startswith("slow")], (n, data[:300])  # a busy machine is slow
        refused += what == "refused"
    if name not in ("uhu", "servo-module", "elcam", "terminal"):  # these answer whatever they are given
        assert refused


@pytest.mark.parametrize("name", ["gcode", "qcl", "tape", "options", "elcam"])
@pytest.mark.filterwarnings("ignore")
def test_hypothesis_finds_nothing_either(name, tmp_path_factory):
    reader, folder = READERS[name], tmp_path_factory.mktemp(name)
    changed = st.randoms(use_true_random=False).map(lambda draw: mutated(draw, reader.corpus, reader.words))
    words = st.lists(st.sampled_from([*reader.words, b"\n", b"1", b"9"]), max_size=40).map(b"".join)

    @settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow], database=None)
    @given(st.one_of(st.binary(max_size=200), words, changed))
    def read(data):
        wrong = judged(reader.read, data, folder)[1]
        assert not [kind for kind in wrong if not kind.startswith("slow")]

    read()


def test_the_nth_input_is_always_the_same():
    for name in ("gcode", "cut-part", "elcam"):
        first = [nth(READERS[name], 3, n) for n in range(20)]
        assert first == [nth(READERS[name], 3, n) for n in range(20)]
        assert len(set(first)) > 15


def test_an_operator_who_waits_for_hours_is_interrupted(tmp_path):
    """So that scripts may cut, jog and wait as long as they like, and no letter of them need be left out."""
    cuts = b"NEW 60000 32510\nTI 30 TP 100\nSTART\nWAIT 9999\n"
    assert devices.terminal(cuts, tmp_path) == STOPPED
    assert devices.terminal(b"NEW 32520 32510\nWAIT 1\n", tmp_path) == FINE


def unpickles(_data, _folder):
    pickle.loads(pickle.dumps(Path("a")))


def writes_elsewhere(_data, folder):
    (folder.parent / "elsewhere").write_text("")


def begins_a_program(_data, _folder):
    subprocess.run([sys.executable, "--version"], check=True, capture_output=True)


def listens_to_all(_data, _folder):
    with socket.socket() as opened:
        opened.bind(("", 0))


def raises(_data, _folder):
    raise KeyError("a")


def takes_long(_data, _folder):
    until = time.process_time() + 1.2 * guard.MOST_CPU_S
    while time.process_time() < until:
        pass


@pytest.mark.slow
@pytest.mark.parametrize(("read", "named"), [
    (unpickles, "unpickled"), (writes_elsewhere, "outside its folder"), (begins_a_program, "began a program"),
    (listens_to_all, "socket.bind"), (raises, "KeyError"), (takes_long, "slow"),
])  # fmt: skip
def test_the_guard_notices(read, named, tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "MOST_CPU_S", 0.2)
    folder = tmp_path / "own"
    folder.mkdir()
    assert named in " ".join(judged(read, b"", folder)[1])


def test_the_guard_lets_the_compiler_begin_its_process(monkeypatch, tmp_path):
    """On an empty cache an input may be the first that needs the pulse loop."""
    monkeypatch.setattr(specialised, "_PROGRAM", "print('code')")

    def compiles(_data, _folder):
        assert specialised._compile_elsewhere(unpickles, (), ()) == b"code\n"

    assert judged(compiles, b"", tmp_path) == ("taken", [])


@pytest.mark.slow
def test_an_end_of_the_interpreter_is_noted_and_the_campaign_goes_on(tmp_path):
    def ends_at_times(data, _folder):
        if len(data) > 3:
            faulthandler.disable()  # pytest's, in this process alone: an end that is meant prints no traceback
            os.abort()

    reader = Reader("ends", ends_at_times, lambda: [b"abc"])
    found = run(reader, 1, 40, tmp_path)
    ended = sum(len(nth(reader, 1, n)) > 3 for n in range(40))
    assert 3 < ended < 40
    assert found["inputs"] == 40
    assert found["taken"] == 40 - ended
    assert found["found"] == {"the interpreter ended with status 6": ended}
    assert len(list(tmp_path.glob("ends-*.bin"))) == ended
