"""The boards without a clock: their lines, registers, ratios and quirks; the axes; invalid input."""

import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import edmsim
from edmsim.errors import InputError
from edmsim.hil import Rig
from edmsim.hil.boards import (
    ALERT_PULSES,
    POLARITY,
    PULSE_CURRENT,
    R_OPEN,
    R_PULSE,
    R_SHORT,
    PowercoreV2,
    PowercoreV3,
    Pulser,
)
from edmsim.hil.gap import VELOCITY_COUNTS_S, Frame, Gap, Output, Setpoints
from edmsim.plant.kernel.state import OPEN, PULSE, SHORT, SPARK

POWERCORE = edmsim.Machine.load(generator="powercore-v3")
TEXT = st.text(st.characters(max_codepoint=255), max_size=60)


def frame_of(rig, kinds, mean_A):
    """A frame of pulses of these kinds, whatever the gap would make of them."""
    output = rig.board.output()
    rows = np.zeros(len(kinds), PULSE)
    rows["kind"], rows["start_us"] = kinds, np.arange(len(kinds)) * output.t_period_us
    rows["delay_us"] = np.where(rows["kind"] == SHORT, 0.0, output.t_on_us / 2)
    rows["conducting_us"] = np.where(rows["kind"] == OPEN, 0.0, output.t_on_us)
    window = rig.gap.plant.window()._replace(
        duration_ns=round(len(kinds) * output.t_period_us * 1e3), mean_current_A=mean_A if output.on else 0.0,
    )  # fmt: skip
    return Frame(window, rows, rig.gap.plant.timing, output.on)


@pytest.fixture(scope="module")
def rig():
    fired = Rig("powercore", seed=1)
    fired.frame()
    return fired


@pytest.fixture
def board(rig):
    rig.board = PowercoreV3()
    rig.board.unsolicited()
    return rig.board


def feed(rig, kinds, mean_A, frames=1):
    said = ""
    for _ in range(frames):
        rig.board.see(frame_of(rig, kinds, mean_A))
        said += rig.board.unsolicited()
    return said


def test_telemetry_has_the_keys_of_the_board_in_its_order(rig, board):
    said = rig.send("SEND_TELEMETRY")
    keys = (
        "FIRMWARE_VERSION", "STATE", "FAULT", "INPUT_CURRENT", "INPUT_POWER", "AVG_DISCHARGE_CURRENT",
        "AVG_DISCHARGE_VOLTAGE", "AVG_OUTPUT_POWER", "DISCHARGES_SINCE_OPERATION_STARTED",
        "AVG_DISCHARGE_SUCCESS_RATE", "DISCHARGE_SUCCESS_RATE_THRESHOLD",
    )  # fmt: skip
    places = [said.index(key) for key in keys]
    assert places == sorted(places)
    assert "STATE OPERATING: FAULT NONE\r\n" in said  # its firmware sends no end of line between the two
    assert "DISCHARGE_SUCCESS_RATE_THRESHOLD:80%\r\n" in said
    assert "Machining Duty Cycle:0.100\r\nMachining Frequency:10000 Hz\r\nInitiation Voltage:80 V\r\n" in said


@pytest.mark.parametrize(("line", "answer"), [
    ("SET_ALL_PARAMETERS 0 0.10 5000 100", "OK: Parameters set"),
    ("  SET_ALL_PARAMETERS 0 0.05 10000 64 ", "OK: Parameters set"),
    ("SET_ALL_PARAMETERS 0 0.5 5000 100", "ERROR: Invalid duty cycle (must be between 0.01 and 0.12)"),
    ("SET_ALL_PARAMETERS 0 nan 5000 100", "ERROR: Invalid duty cycle (must be between 0.01 and 0.12)"),
    ("SET_ALL_PARAMETERS 0 0.1 500 100", "ERROR: Invalid frequency (must be between 5000.00 and 10000.00 Hz)"),
    ("SET_ALL_PARAMETERS 0 0.1 5000 9", "ERROR: Invalid initiation voltage (must be between 64.00 and 100.00 V)"),
    ("SET_ALL_PARAMETERS -1 0.1 5000 80", "ERROR: Invalid discharges value"),
    ("SET_ALL_PARAMETERS 0 0.12 10000 80", "OK: Parameters set"),
    ("SET_ALL_PARAMETERS 0 0.1 5000", "ERROR: Invalid number of parameters"),
    ("EDM_ISOFREQUENCY_MODE", "EDM_ISOFREQUENCY_MODE entered"),
    ("RESET_DEVICE", "Rebooting device"),
    ("set_all_parameters", "ERROR: Unknown command"),
])  # fmt: skip
def test_the_powercore_answers_its_lines(rig, board, line, answer):
    before = board.output()
    assert rig.send(line).splitlines()[0] == answer
    if answer.startswith("ERROR"):
        assert board.output() == before


def test_a_setting_reaches_the_gap(rig, board):
    rig.send("SET_ALL_PARAMETERS 0 0.05 5000 100")
    frame = rig.frame()
    assert frame.timing.open_V == 100.0
    assert (frame.timing.on_us, frame.timing.period_ns) == (10.0, 200_000)
    assert len(frame.pulses) == 10


def test_eight_of_ten_discharges_switch_the_output_off_for_a_quarter_of_a_second(rig, board):
    said = feed(rig, [SHORT] * 8 + [OPEN] * 2, 0.5)
    assert said == "Pulse skipping: discharge success rate threshold exceeded\r\n"
    assert not board.output().on
    assert not board.listens
    assert board.pins()["FEEDBACK"] == 0.0
    assert "complete" not in feed(rig, [OPEN] * 10, 0.0, 249)
    assert feed(rig, [OPEN] * 10, 0.0, 2).startswith("Pulse skipping complete\r\n")
    assert board.output().on
    assert feed(rig, [SPARK] * 7 + [OPEN] * 3, 0.5) == ""
    assert board.pins()["FEEDBACK"] > 0.0


def test_feedback_is_the_input_power_of_the_last_second_renewed_every_ten_milliseconds(rig, board):
    calm, loud = 15.0 / 48.0, 60.0 / 48.0  # 15 and 60 W of the limit of 75 W
    feed(rig, [SPARK] * 2 + [OPEN] * 8, calm, 900)
    assert board.pins()["FEEDBACK"] == 1.0
    feed(rig, [SPARK] * 2 + [OPEN] * 8, calm, 110)
    assert board.pins()["FEEDBACK"] == pytest.approx(0.8)
    feed(rig, [SPARK] * 2 + [OPEN] * 8, loud, 9)
    assert board.pins()["FEEDBACK"] == pytest.approx(0.8)
    feed(rig, [SPARK] * 2 + [OPEN] * 8, loud, 500)
    assert board.pins()["FEEDBACK"] == pytest.approx(0.5, abs=0.02)
    feed(rig, [SPARK] * 2 + [OPEN] * 8, loud, 600)
    assert board.pins()["FEEDBACK"] == pytest.approx(0.2, abs=0.01)


def test_above_75_watts_pulses_are_skipped_for_ten_milliseconds_and_the_power_settles(rig, board):
    said = ""
    for _ in range(4000):
        frame = frame_of(rig, [SPARK] * 5 + [OPEN] * 5, 3.0)  # 144 W while it runs
        board.see(frame)
        said += board.unsolicited()
    assert "Pulse skipping: power setpoint exceeded\r\nPulse skipping complete\r\n" in said
    assert float(said.split("INPUT_POWER ")[-1].split("W")[0]) == pytest.approx(75, abs=6)
    assert board.pins()["FEEDBACK"] < 0.05


def test_idle_without_enable_and_an_end_after_so_many_discharges(rig, board):
    rig.move("ENABLE 0")
    feed(rig, [OPEN] * 10, 0.0, 11)
    assert "STATE IDLE\r\n" in rig.send("SEND_TELEMETRY")
    assert not board.output().on
    assert board.pins()["FEEDBACK"] == 0.0
    rig.move("ENABLE 1")
    rig.send("SET_ALL_PARAMETERS 12 0.1 10000 80")
    said = feed(rig, [SPARK] * 5 + [OPEN] * 5, 0.5, 3)
    assert said == "Number of discharges requested reached: 15\r\n"
    assert not board.output().on


def test_edge_detection_ends_with_the_first_contact_and_says_so_on_feedback(rig, board):
    assert rig.send("EDGE_DETECTION_MODE") == ""
    output = board.output()
    assert (output.t_on_us, output.t_period_us, output.open_V) == (5.0, 100.0, 48.0)
    feed(rig, [OPEN] * 10, 0.0, 20)
    assert "NO EDGE DETECTED YET\r\n" in rig.send("SEND_TELEMETRY")
    assert feed(rig, [OPEN] * 9 + [SHORT], 0.1) == "EDGE DETECTED\r\n"
    assert board.pins()["FEEDBACK"] == 1.0
    assert not board.output().on
    feed(rig, [OPEN] * 10, 0.0, 1005)
    assert board.pins()["FEEDBACK"] == 0.0
    feed(rig, [OPEN] * 10, 0.0, 1005)
    assert board.output().on


def test_a_reset_takes_two_seconds_and_forgets_the_parameters(rig, board):
    rig.send("SET_ALL_PARAMETERS 0 0.05 5000 100")
    rig.send("RESET_DEVICE")
    assert not board.listens
    assert "Setup complete" in feed(rig, [OPEN] * 10, 0.0, 2100)
    assert board.output() == Output(10, True, 10.0, 100.0, 80.0)


def test_alrt_counts_the_sparks_of_the_last_512_pulses(rig):
    rig.board = PowercoreV2()
    feed(rig, [SPARK] * 18, 1.0, 8)
    assert rig.board.pins() == {"ALRT": 144 / ALERT_PULSES, "AMP": 0.012}
    feed(rig, [OPEN] * 18, 0.0, 21)
    assert rig.board.pins()["ALRT"] == 134 / ALERT_PULSES
    feed(rig, [OPEN] * 18, 0.0, 8)
    assert rig.board.pins()["ALRT"] == 0.0


@pytest.fixture
def pulser(rig):
    rig.board = Pulser()
    return rig.board


def test_the_pulser_starts_off_with_the_registers_of_its_manual(rig, pulser):
    assert rig.send("r 1 5") == "0x01: 0 10 25 50 25\r\n"
    assert not pulser.output().on
    assert rig.send("w 0x01 2") == "ok\r\n"
    assert pulser.output() == Output(2, True, 500.0, 2000.0, None, 1.0)


@pytest.mark.parametrize(
    ("write", "read"),
    [("w 2 0", 1), ("w 2 200", 80), ("w 4 255", 100), ("w 4 1", 5), ("w 5 99", 95), ("w 1 5", 0), ("w 3 7", 25)],
)
def test_a_value_that_is_none_becomes_the_nearest_and_a_polarity_off(rig, pulser, write, read):
    register = write.split()[1]
    rig.send(write)
    assert rig.send(f"r {register}") == f"0x{int(register):02x}: {read}\r\n"


def test_a_new_current_does_not_end_the_pause_of_a_new_polarity(rig, pulser):
    for register, value in ((POLARITY, 1), (POLARITY, 2), (PULSE_CURRENT, 20)):
        pulser.write(register, value)
    for _ in range(2):
        pulser.see(frame_of(rig, [OPEN], 0.0))  # 2 ms each
        assert not pulser.output().on


def test_reading_the_count_begins_an_interval_and_the_ratios_are_those_of_time(rig, pulser):
    rig.send("w 1 1")
    pulser.see(frame_of(rig, [SPARK, OPEN, SHORT, OPEN], 0.0))
    # of 8000 us: 500 in the spark, 250 before it and twice 250 open, the short with its pause
    assert pulser.read(R_PULSE) == b"\0"
    count, delay, spread, pulse, short, open_ = pulser.read(0x10, 6)
    assert (count, delay, spread) == (1, 50, 0)
    assert (pulse, short, open_) == (round(255 * 500 / 8000), round(255 * 2000 / 8000), round(255 * 750 / 8000))
    assert pulser.read(0x10, 2) == bytes([0, 255])
    size = len(pickle.dumps(pulser))
    for on_10_us in (50, 10):
        rig.send(f"w 4 {on_10_us}")
        for _ in range(150):
            pulser.see(frame_of(rig, [SPARK] * 4, 0.0))
    assert len(pickle.dumps(pulser)) < size + 100  # however long it is not read
    assert list(pulser.read(0x10, 3)) == [255, 30, 20]  # the count stays at its most; 250 and 50 us
    assert sum(pulser.read(r)[0] for r in (R_PULSE, R_SHORT, R_OPEN)) <= 255


def test_a_change_while_it_fires_suppresses_the_driver(rig, pulser):
    rig.send("w 1 1")
    rig.send("w 2 20")
    assert not pulser.output().on
    pulser.see(frame_of(rig, [OPEN], 0.0))
    assert pulser.output().on
    assert pulser.output().peak_A == 2.0
    rig.send("w 1 2")
    for _ in range(9):
        assert not pulser.output().on
        pulser.see(frame_of(rig, [OPEN], 0.0))
    rig.move("ENABLE 0")  # GATE
    pulser.see(frame_of(rig, [OPEN], 0.0))
    assert not pulser.output().on


def test_registers_set_what_the_gap_is_fired_with():
    own = Rig("spark", seed=3)
    own.send("w 1 1")
    own.send("w 2 50 0 10 50")  # 5 A, register 3 is read-only, 100 us, half of the time
    own.run(0.002)
    frame = own.frame()
    assert frame.timing.current_A == pytest.approx(5.0)
    assert (frame.timing.on_us, frame.timing.pause_us) == (100.0, 100.0)


def test_steps_places_and_velocities_lead_the_axes_to_the_step():
    own = Rig("powercore-v2", seed=1)
    assert own.move("STEP X 3") == "ok\r\n"
    own.move("STEP y -2")
    assert own.move("FLY 3").startswith("ERROR: give STEP X|Y n, ")
    own.run(0.1)
    assert own.gap.place_um == (6.0, -4.0)
    own.move("POS -20 9")
    own.run(0.2)
    assert own.gap.place_um == (-20.0, 8.0)  # motor steps of 2 um
    own.move("VEL -40 0")
    own.run(0.25)
    assert own.gap.place_um[0] == pytest.approx(-30.0, abs=2.5)
    own.run(1.0)
    assert own.gap.place_um[0] == pytest.approx(-20.0 - 40.0 * VELOCITY_COUNTS_S, abs=2.5)
    status = own.move("?").split()
    assert status[2:6] == ["X", f"{own.gap.place_um[0]:.1f}", "Y", "8.0"]


def test_a_setpoint_ends_where_the_travel_does():
    points = Setpoints((10.0, 10.0), 2.0, 1000.0, 20.0)
    points.step(0, 1000)
    points.move_at((0.0, 0.0), 0)
    points.go_to((1e9, -1e9))
    steps = points.plan(0, 1_000_000_000)
    way = [(2_000_000 * k, axis, d) for k in range(1, 6) for axis, d in ((0, 1), (1, -1))]  # 2 um at 1000 um/s
    assert steps == way


def test_status_lines_come_as_often_as_requested():
    # a frame is 1, 9.8 and 5 ms, and a line waits for its end; that must not delay those that follow
    for board, rate_Hz in (("powercore", 300), ("powercore-v2", 50), ("spark", 70)):
        own = Rig(board, seed=1)
        own.move(f"STREAM {rate_Hz}")
        lines = []
        while own.time_s < 0.5:
            own.frame()
            lines.append(own.streamed())
        assert sum(map(bool, lines)) == pytest.approx(0.5 * rate_Hz, abs=1)
    assert own.move("STREAM 1e9").startswith("ERROR: STREAM takes 0")
    own.move("STREAM 0")
    own.frame()
    assert own.streamed() == ""


def test_a_wire_driven_into_the_metal_is_lost_and_threaded_again():
    own = Rig("powercore", seed=1)
    assert own.move("THREAD") == "ERROR: there is a wire\r\n"
    own.move("ENABLE 0")
    for _ in range(200):
        own.move("VEL 1000 0")
        own.run(0.05)
        if own.gap.lost:
            break
    assert own.gap.lost
    assert " WIRE 0 " in own.status()
    assert (own.frame().pulses["kind"] == OPEN).all()
    assert own.move("THREAD") == "ok\r\n"
    assert " WIRE 1 " in own.status()


def test_the_same_lines_at_the_same_times_give_the_same_bits():
    def status():
        own = Rig("powercore", seed=5)
        own.move("VEL 5 1")
        own.run(0.2)
        own.send("SET_ALL_PARAMETERS 0 0.1 8000 90")
        own.run(0.1)
        return own.status() + own.send("SEND_TELEMETRY") + repr(own.gap.plant.snapshot()["state"])

    assert status() == status()


def test_a_snapshot_goes_on_to_the_bit_also_past_a_change_of_voltage():
    own = Gap(POWERCORE, seed=2)
    own.setpoints.move_at((20.0, 0.0), 0)
    own.run(Output(50, True, 5.0, 100.0, 90.0, 50.0))
    state = own.snapshot()
    goes_on = own.run(Output(50, True, 5.0, 100.0, 90.0, 50.0))
    own.run(Output(20, False, 10.0, 100.0, 80.0))
    own.restore(state)
    again = own.run(Output(50, True, 5.0, 100.0, 90.0, 50.0))
    assert again.window == goes_on.window
    assert again.pulses.tobytes() == goes_on.pulses.tobytes()
    with pytest.raises(InputError, match="setpoints"):
        own.restore(own.plant.snapshot())


@settings(max_examples=100)
@given(TEXT)
def test_any_line_to_the_powercore_is_answered_and_changes_no_setting_by_accident(rig, text):
    board = rig.board = PowercoreV3()
    before, gap = board.output(), rig.gap.plant.time_ns
    said = rig.send(text)
    assert said.endswith("\r\n") or text.strip().startswith("EDGE_DETECTION_MODE")
    assert said.isascii()
    assert board.output() == before or said.startswith(("Setup complete\r\nOK", "Rebooting device"))
    assert rig.gap.plant.time_ns == gap


@settings(max_examples=100)
@example(["0", "0", "0", "\x1f0"])  # a space to Python, not to C
@example(["0", "0.1", "10000", "\u0668\u0660"])  # digits, likewise
@given(st.lists(st.one_of(st.integers(-9, 300).map(str), st.floats().map(str), TEXT), min_size=4, max_size=4))
def test_what_the_powercore_takes_its_generator_fires(words):
    board = PowercoreV3()
    board.unsolicited()
    said = board.line("SET_ALL_PARAMETERS " + " ".join(words))
    output = board.output()
    POWERCORE.with_(open_voltage_V=output.open_V).with_pulses(output.t_on_us, output.t_period_us)
    assert said.startswith(("OK", "ERROR"))


@settings(max_examples=100)
@given(TEXT | st.builds("{} {} {}".format, st.sampled_from("rw"), st.integers(-1, 300), st.integers(-1, 300)))
def test_any_line_to_the_pulser_is_answered_and_leaves_registers_in_their_ranges(text):
    board = Pulser()
    said = board.line(text)
    assert said.endswith("\r\n")
    assert said.startswith(("0x", "ok", "ERROR"))
    polarity, current, _, duration, duty = board.read(1, 5)
    assert polarity <= 4
    assert 1 <= current <= 80
    assert 5 <= duration <= 100
    assert 1 <= duty <= 95


@settings(max_examples=100)
@given(
    st.one_of(
        TEXT, st.builds("{} {} {}".format, st.sampled_from(["STEP X", "POS", "VEL", "STREAM", "ENABLE"]),
                        st.one_of(st.floats(), st.integers()), st.one_of(st.just(""), st.floats(), TEXT)),
    )
)  # fmt: skip
def test_any_line_to_the_axes_is_answered_and_sends_none_beyond_its_travel(rig, text):
    said = rig.move(text)
    assert said.endswith("\r\n")
    assert said.startswith(("ok", "ERROR: ", "T "))
    travel_um = rig.gap.plant.machine.base.table.travel_mm.value * 1e3
    now = rig.gap.plant.time_ns
    for _, axis, direction in rig.gap.setpoints.plan(now, now + 1_000_000):
        assert axis in (0, 1)
        assert direction in (-1, 1)
    assert all(0 <= place <= travel_um for place in rig.gap.setpoints.snapshot()["now_um"])


def test_a_setting_that_is_refused_changes_nothing():
    gap = Gap(edmsim.Machine.load(generator="powercore-v3"), 1)
    gap.run(Output(10, True, 10.0, 100.0, 80.0))
    before = gap.snapshot()
    with pytest.raises(InputError, match=r"t_on 500 us is not within 1\.\.25 us"):
        gap.run(Output(10, True, 500.0, 100.0, 90.0))
    after = gap.snapshot()
    assert all(np.array_equal(before[name], after[name], equal_nan=name == "gap.choices") for name in before)


def test_voltage_and_current_that_nobody_commands_are_those_of_the_set_up():
    gap = Gap(edmsim.Machine.load(open_voltage_V=70.0, peak_current_A=2.0), 1)
    for commanded, expected in (((None, None), (70.0, 2.0)), ((90.0, None), (90.0, 2.0)), ((None, 3.0), (70.0, 3.0))):
        gap.run(Output(10, True, 30.0, 100.0, *commanded))
        machine = gap.plant.machine
        assert (machine.open_voltage_V, machine.peak_current_A) == expected


def test_a_board_that_is_none_and_a_gap_without_room_are_refused():
    with pytest.raises(InputError, match=r"no board 'powercore-v9'; choose one of .*spark"):
        Rig("powercore-v9")
    with pytest.raises(InputError, match="the gap is 1 to 250 um"):
        Rig("spark", gap_um=0.0)
