"""The machine looks after its axes itself: every drive, own ones too, follows its path or stops the cut by name."""

import re

import pytest

from edmsim.closed_loop.stops import StopCause
from edmsim.compiled.axis_rows import carray, sample
from edmsim.controllers import axis as axes
from edmsim.controllers import make
from edmsim.controllers.axis.drive import COUNTS_PER_EDGE, KD, KP, LARGEST_ERROR, PositionServo
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError
from edmsim.plant.axes.drives import FAULTS, AxisFault, parse_fault
from tests.test_closed_loop import contour, run, simulation

LINE = contour([(0, 0), (120, 90)])
LONG = contour([(0, 0), (400, 300)])
NO_LIMIT = 10**9


@sample
def _away(drive_at, axis_at):
    drive = carray(drive_at, 1)[0]
    drive.command = 1.0 if drive.index > 300 else 0.0


class Away(PositionServo):
    """Goes off at full speed after 0.15 s, and reports nothing."""

    sample = _away


class Fibs(PositionServo):
    """Says that it takes ten counts a step, and takes five."""

    def __init__(self):
        super().__init__()
        self.record["reg"][0, COUNTS_PER_EDGE], self.record["reg"][0, LARGEST_ERROR] = 5, NO_LIMIT

    @property
    def counts_per_step(self):
        return 10.0


def servo(**registers):
    drive = PositionServo()
    for name, value in registers.items():
        drive.record["reg"][0, {"kp": KP, "kd": KD, "counts": COUNTS_PER_EDGE, "limit": LARGEST_ERROR}[name]] = value
    return drive


def cut(x, y=None, *contours, **options):
    sim = simulation(*(contours or (LINE,)), drives={"x": x, "y": x if y is None else y}, **options)
    run(sim)
    return sim


@pytest.mark.parametrize("name", ["servo", "uhu", "servo-module", "eanpos"])
def test_a_finished_cut_has_its_axes_in_place(name):
    drive = axes.make(name) if name == "servo" else axes.from_text(name)
    sim = cut(drive)
    assert sim.cause is StopCause.FINISHED
    assert max(sim.plant.away_um) <= 2.0
    assert sim.plant.place_um == pytest.approx(sim.plant.commanded_um, abs=2.2)


@pytest.mark.parametrize(
    ("drive", "reason"),
    [
        (Away(), "x is 1.* from its path, more than the 125 um"),
        (servo(kp=0, kd=0, limit=NO_LIMIT), "x is 12.* from its path, more than the 125 um"),
        (servo(kp=-2000, limit=NO_LIMIT), "x is 1.* from its path, more than the 125 um"),
        (servo(kp=0, limit=100), "drive of x has shut off its motor, 2.* um.*: its following error passed the limit"),
        (Fibs(), "x is 12.* from its path, more than the 125 um"),
    ],
    ids=["runs away", "does nothing", "turned about", "trips", "half the size"],
)
def test_an_own_drive_that_does_not_follow_stops_the_cut_by_name(drive, reason):
    sim = cut(drive, servo(), LONG)
    assert sim.cause is StopCause.DRIVE_TRIP
    assert re.search(reason, sim.reason), sim.reason


@pytest.mark.slow
def test_a_short_part_of_half_the_size_is_not_finished():
    """Its axes are never as far off as the wire's radius: what tells is that they do not come to their places."""
    sim = cut(Fibs(), servo())
    assert sim.cause is StopCause.DRIVE_TRIP
    assert re.match(r"at the end of a leg of the path x is 60\.\d um from its place, ", sim.reason)
    assert "not coming nearer" in sim.reason


@pytest.mark.parametrize(("drive", "own_um"), [
    (servo(counts=5), "1"), (servo(counts=-10), "-2"), (axes.from_text("uhu:M=4"), "1"),
    (axes.from_text("servo-module:X=19"), "4"), (axes.from_text("eanpos:measure=800"), "1"),
    (axes.from_text("eanpos:pulse=1000"), "1"), (Eanpos.tuned(changes={"measure": 200}), "4"),
    (Uhu(stored={"step_multiplier": 9}, law={"step_sense": -1}), "-2"), (axes.make("eanpos"), "0"),
])  # fmt: skip
def test_a_wrong_scale_is_refused_under_every_drive(drive, own_um):
    message = rf"drive of y \(.*\) moves {own_um} um at a step; this machine's steps are 2$"
    with pytest.raises(InputError, match=message):
        simulation(LINE, drives={"x": servo(), "y": drive})


class Silent(PositionServo):
    """Does not say what a step is."""

    counts_per_step = None


def test_an_own_drive_that_does_not_say_what_a_step_is_is_refused_in_a_cut():
    with pytest.raises(InputError, match=r"the drive of x \(servo\) lacks counts_per_step"):
        simulation(LINE, drives={"x": Silent()})


@pytest.mark.parametrize("name", ["uhu", "servo-module", "eanpos"])
@pytest.mark.parametrize(
    ("step_um", "um_per_rad"), [(1.0, 63.66197723675814), (2.0, 31.83098861837907), (5.0, 79.57747154594767)]
)
def test_the_scale_follows_from_the_machine(name, step_um, um_per_rad):
    drive = axes.from_text(name, axes.Screw(step_um, um_per_rad))
    per_count = um_per_rad / float(drive.motor["counts_per_rad"][0])
    assert drive.counts_per_step * per_count == pytest.approx(step_um)


@pytest.mark.slow
def test_threading_waits_for_slow_axes_or_says_how_long_they_would_take():
    far = contour([(700, 0), (730, 0)])
    sim = cut(Eanpos.tuned(changes={"setvel": 60}), None, contour([(0, 0), (20, 0)]), far)
    assert sim.cause is StopCause.FINISHED
    assert sim.plant.place_um[0] == pytest.approx(sim.plant.commanded_um[0], abs=2.0)
    still = simulation(contour([(0, 0), (20, 0)]), far, drives={"x": Eanpos.tuned(), "y": servo()})
    while still.leg == 0 and still.path_um < 15.0:
        still.step()
    still.plant.drives["x"].parameters["setvel"] = 1
    run(still)
    assert still.cause is StopCause.DRIVE_TRIP
    assert "between two contours x is 6" in still.reason
    assert "s more until within 2 um" in still.reason


def test_a_drive_that_stops_in_a_rapid_stops_the_cut():
    sim = cut(Away(), servo(), contour([(0, 0), (2, 0)]), contour([(300, 0), (330, 0)]))
    assert sim.cause is StopCause.DRIVE_TRIP
    assert "from its path" in sim.reason


def test_of_two_drives_on_the_fault_line_the_second_is_stopped_by_the_first():
    sim = cut(axes.from_text("uhu:T=0"), axes.from_text("servo-module"), LONG)
    assert sim.cause is StopCause.DRIVE_TRIP
    first, second = sim.reason.split("; ")
    assert "drive of x has shut off its motor" in first
    assert "following error reached the limit E of 500 counts" in first
    assert second == "the drive of y was stopped by its fault line, pulled low by x"


@pytest.mark.parametrize(("fault", "reason"), [
    ("stuck", "error reached the limit E of 500"), ("swapped", "error reached the limit E of 500"),
    ("unplugged", "x is 12"), ("supply-off", "its supply gives 0 V in place of 24 V"),
    ("logic-off", "its drive is held in reset"), ("fault-line", "pulled low from outside"),
    ("stalled", "its watchdog saw no recalculation for 125 ms"),
])  # fmt: skip
def test_every_fault_of_an_axis_stops_the_cut_with_its_cause(fault, reason):
    feed_um_s = 2.0 if fault == "stalled" else 30.0  # a duty that is held at speed leads the axis off before 125 ms
    faults, law = [AxisFault("x", fault, 0.3)], make("fixed", feed_um_s=feed_um_s)
    sim = cut(axes.from_text("uhu"), None, LONG, axis_faults=faults, controller=law)
    assert sim.cause is StopCause.DRIVE_TRIP
    assert reason in sim.reason
    assert sim.plant.time_ns >= 0.3e9


def test_a_fault_outlasts_a_checkpoint():
    def started(faults):
        return simulation(LONG, drives={"x": axes.from_text("uhu"), "y": servo()}, axis_faults=faults)

    faults = [AxisFault("x", "supply-off", 0.1)]
    sim = started(faults)
    for _ in range(8):
        sim.step()
    arrays, values = sim.snapshot()
    other = started(faults)
    other.restore(arrays, values)
    run(sim)
    run(other)
    assert other.reason == sim.reason
    assert other.plant.time_ns == sim.plant.time_ns
    assert "its supply gives 0 V" in sim.reason


@pytest.mark.parametrize(("text", "reason"), [
    ("z:stuck@1", "names no axis x or y"), ("x:loose@1", f"names no fault; choose one of {', '.join(FAULTS)}"),
    ("x:stuck", "has no time"), ("x:stuck@-1", "has no time"), ("x:stuck@nan", "has no time"),
    ("stuck@1", "names no axis"),
])  # fmt: skip
def test_a_fault_that_is_none_is_refused(text, reason):
    with pytest.raises(InputError, match=reason):
        parse_fault(text)


def test_a_fault_after_the_end_of_the_cut_is_a_notice(cut_small):
    faults = ["x:stuck@0.1", "y:stuck@9"]
    done = cut_small(max_time_s=0.5, drive="uhu", axis_faults=faults)
    assert [text for text in done.report["notices"] if "fault" in text] == [
        "the fault y:stuck@9 did not happen: the cut was over at 0.5 s"
    ]


def test_a_stepper_has_no_such_faults():
    with pytest.raises(InputError, match="y has no servo drive"):
        simulation(LINE, axis_faults=[AxisFault("y", "stuck", 0.0)])


@pytest.mark.slow
@pytest.mark.parametrize("end_um", [(120, 90), (140, 90), (400, 300)])
def test_an_axis_that_swings_through_its_place_finishes_no_cut(end_um):
    sim = cut(axes.from_text("uhu:P=900,D=255,H=0"), axes.from_text("uhu"), contour([(0, 0), end_um]))
    assert sim.cause is StopCause.DRIVE_TRIP
    assert re.search("x is .* um from its place, not coming nearer", sim.reason)
