"""`edmsim bench --profile`: shares of a pulse's time. What marks do is tested in `plant/test_marks.py`."""

import inspect
import itertools
from importlib import import_module

import pytest
from rich.console import Console

from edmsim.bench import profile
from edmsim.errors import EdmsimError
from edmsim.plant.kernel.memory import window_function

FOUND = {
    name: profile.LoopProfile(ns, ns + 9.0, dict(zip(profile.PARTS, [0.55, *[0.05] * 9], strict=True)), 1000)
    for name, ns in (("fast", 400.0), ("default", 900.0))
}


class Turning:
    """A part that is another one at every look."""

    def __init__(self):
        self._parts = itertools.cycle(range(len(profile.PARTS) + 1))

    def __call__(self):
        return next(self._parts)


@pytest.mark.slow
def test_shares_add_up_to_one(monkeypatch):
    def unmarked(_, *shape, parts):
        assert parts[0] == ("edmsim.plant.gap.pulse_outcome.sum_rays",)
        return window_function(*shape, False), Turning()

    for name, value in (("marked", unmarked), ("LOOKS", 1000), ("ROUNDS", 5)):
        monkeypatch.setattr(profile, name, value)
    monkeypatch.setattr(profile.workloads, "SETTLE_WINDOWS", profile.BATCH)
    started = []
    found = profile.profile(started.append)
    assert list(found) == ["fast", "default"]
    assert len(started) == 4
    for one in found.values():
        assert list(one.shares) == list(profile.PARTS)
        assert sum(one.shares.values()) == pytest.approx(1.0)
        assert min(one.shares.values()) > 0.0
        assert sum(map(one.ns, profile.PARTS)) == pytest.approx(one.ns_per_pulse)
        assert one.looks >= 1000
        assert 10.0 < one.ns_per_pulse < 1e5
    assert found["fast"].ns_per_pulse < found["default"].ns_per_pulse


def test_every_function_of_a_part_is_there_and_of_one_part_only():
    names = [name for names in profile.PARTS.values() for name in names]
    assert len(set(names)) == len(names)
    for name in names:
        module, _, function = name.rpartition(".")
        found = getattr(import_module(f"edmsim.plant.{module}"), function)
        assert inspect.unwrap(getattr(found, "py_func", found)).__module__ == f"edmsim.plant.{module}"


def test_a_system_without_such_clocks_says_so(monkeypatch):
    monkeypatch.delattr(profile.time, "pthread_getcpuclockid")
    with pytest.raises(EdmsimError, match="profile on Linux"):
        profile._clock_of(0)


@pytest.mark.slow
def test_a_profile_is_a_table_and_a_picture():
    with (console := Console(width=100)).capture() as shown:
        console.print(profile.render(FOUND))
    assert {"220", "55.0", "495", "400", "909", "100.0"} <= set(shown.get().replace("│", " ").split())
    (axes,) = profile.draw(FOUND).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == list(profile.PARTS)
    lengths = [bar.get_width() for bar in axes.patches]
    assert lengths[:2] + lengths[10:12] == pytest.approx([220.0, 20.0, 495.0, 45.0])
