"""The example that finds out how far a wire lags: its schedule, its student, its recordings and its policy."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from edmsim.controllers import from_text
from edmsim.learning import policy_file

FILE = Path(__file__).parents[2] / "examples" / "learning" / "lag.py"


@pytest.fixture(scope="module")
def lag(load_script):
    return load_script(FILE)


@pytest.mark.parametrize(("example", "words", "said"), [
    ("lag", ("--machines", "1"), "2 machines or more"), ("lag", ("--rounds", "0"), "1 round and epoch or more"),
    ("adapt", ("--machines", "1"), "--machines 1: "), ("ppo", ("--steps", "1023"), "one rollout has 1024 decisions"),
    ("ppo_lag", ("--steps", "0"), "one rollout has 1024 decisions"),
])  # fmt: skip
def test_too_little_to_learn_from_is_refused_by_all_examples(
    load_script, tmp_path, monkeypatch, capsys, example, words, said
):
    monkeypatch.setattr(sys, "argv", [example, *words, "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit):
        load_script(FILE.with_name(f"{example}.py")).main()
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def way(lag, turn_deg, step_um=4.0, from_um=-250.0):
    """Return observations (n, entries) on the way to a corner and to 100 um behind it."""
    place_um = np.arange(from_um, 100.0, step_um)
    rows = np.zeros((len(place_um), len(lag.NAMES)), np.float32)
    for name, (mean, _) in lag.SCALE.items():
        rows[:, lag.AT[name]] = mean
    before, turn = place_um < 0, turn_deg / 180
    rows[:, lag.AT["corner_ahead"]] = np.where(before, -1e-3 * place_um, 1.0)
    rows[:, lag.AT["corner_turn"]] = np.where(before, turn, 0.0)
    rows[:, lag.AT["corner_behind"]] = np.where(before, 1.0, 1e-3 * place_um)
    rows[:, lag.AT["corner_turned"]] = np.where(before, 0.0, turn)
    return rows


def note(lag, file, rng):
    """Write a cut of a machine with more open pulses, after the first rare ones, the farther its wire lags."""
    turn_deg, lag_um = rng.uniform(45, 135) * rng.choice((-1, 1)), rng.uniform(0, 12)
    rows = way(lag, turn_deg)
    first = next(k for k, row in enumerate(rows) if lag.schedule(row)[2] > 0)
    rows[first:, lag.AT["open"]] += 0.04 * (lag_um - 6) * (rows[first:, lag.AT["corner_ahead"]] < 1)
    behind_um = 1e3 * rows[:, lag.AT["corner_behind"]]
    across_um = lag_um * math.sin(math.radians(turn_deg)) * np.exp(-behind_um / 40)
    cut_um = np.where((behind_um < 100) | (rows[:, lag.AT["corner_ahead"]] < 0.1), 4.0, 0.0)
    np.savez(file, rows=rows, across_um=across_um.astype(np.float32),
             lag_um=np.full(len(rows), lag_um, np.float32), cut_um=cut_um.astype(np.float32))  # fmt: skip


@pytest.fixture(scope="module")
def taught(lag, tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("cuts"), np.random.default_rng(1)
    files = [folder / f"{k}.npz" for k in range(160)]
    for file in files:
        note(lag, file, rng)
    torch.manual_seed(0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # on a busy machine several wait for each other
    others = lag.Cuts(files[:32])
    student = lag.taught(lag.Cuts(files[32:]), 40, others, cells=8, hidden=16)
    torch.set_num_threads(threads)
    return student, others


def test_pulses_are_rare_at_the_start_and_twice_before_the_corner_and_the_gap_is_wider_near_it(lag):
    rows = way(lag, 90.0, 1.0, from_um=-300.0)
    actions = np.array([lag.schedule(row) for row in rows])
    rare, place_um = actions[:, 2] > 0, np.arange(-300.0, 100.0)
    assert place_um[rare].tolist() == [-300, *range(-220, -200), *range(-140, -120)]
    low, high = lag.FAMILY.servo_target_share
    targets = low + (high - low) * (actions[:, 0] + 1) / 2
    assert targets[~rare & (place_um < -15)] == pytest.approx(lag.FAR)
    assert targets[place_um > -15] == pytest.approx(lag.NEAR)


@pytest.mark.slow
def test_the_student_finds_the_lag_from_the_pulses(lag, taught):
    student, others = taught
    rows, across_um, cut_um, lag_um = others.batch(torch.arange(len(others.lengths)))
    with torch.no_grad():
        offset_um, guess_um = student(rows)
    floor_um = lag.FLOOR_UM2**0.5
    with_it, without = (lag.rms_um(one, across_um, cut_um).mean() - floor_um
                        for one in (offset_um, torch.zeros_like(across_um)))  # fmt: skip
    assert with_it < 0.5 * without
    at_corner = guess_um[:, int((rows[0, :, lag.AT["corner_behind"]] == 1).sum()) - 1]
    assert np.corrcoef(at_corner, lag_um)[0, 1] > 0.9
    assert float(lag.said(student, others).rpartition("R2 of the lag ")[2]) > 0.9


def test_it_is_saved_as_a_policy_with_its_schedule(lag, taught, tmp_path):
    student, _ = taught
    made = lag.save(student, tmp_path / "policy.json", "a test", 0, 0)
    assert made.card.command == "a test"
    policy = policy_file.load(str(tmp_path / "policy.json"))
    rows, memory, actions = way(lag, -70.0, 3.3, from_um=-299.5), policy.fresh_memory(), []
    for row in rows:
        action, memory = policy.act(row, memory)
        actions.append(action)
    expected = np.array([lag.schedule(row) for row in rows])
    assert np.array(actions)[:, :3] == pytest.approx(expected, abs=2e-3)  # 0.3 um before an edge
    with torch.no_grad():
        offset_um = student(torch.from_numpy(rows)[None])[0][0].numpy()
    assert np.array(actions)[:, 3] * lag.OFFSET_UM == pytest.approx(offset_um, abs=1e-2)
    assert from_text(f"policy:{tmp_path / 'policy.json'}").policy.card.algorithm == "lag"


@pytest.mark.slow
def test_a_recording_has_what_the_student_learns_from(lag, tmp_path):
    file = tmp_path / "20000.npz"
    assert lag.recorded(tmp_path, 20_000, 1) == [file]
    with np.load(file) as cut:
        rows, across_um, lag_um, cut_um = (cut[name] for name in ("rows", "across_um", "lag_um", "cut_um"))
    assert len(rows) == len(across_um) == len(lag_um) == len(cut_um) > 100
    assert np.isfinite(across_um).all()
    assert 190 < cut_um.sum() < 205  # of 100 um on either side of the corner, where pulses ignite
    period_us = 10 ** (4 * rows[1:, lag.AT["t_period"]])  # of the decision before each row
    assert (period_us.min(), period_us.max()) == pytest.approx((50.5, 201.5), abs=1.0)
    rare, usual = lag_um[:-1][period_us > 190], lag_um[:-1][period_us < 60]
    assert rare.mean() < usual.mean()  # the wire springs back to the guides
    lag.recorded(tmp_path, 20_000, 1, student="none is asked")  # it is there, and not made again
