"""The example that adapts to a machine: its teacher finds limits that are known, its student learns and cuts."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from edmsim.controllers import from_text
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode

torch = pytest.importorskip("torch")
FILE = Path(__file__).parents[2] / "examples" / "learning" / "adapt.py"


@pytest.fixture(scope="module")
def adapt():
    spec = importlib.util.spec_from_file_location("adapt", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def histories(adapt, count=24, steepness=20.0):
    """Return histories of machines whose limits are known, and these: climbs to a break, and from lower again."""
    rng = np.random.default_rng(2)
    limits, made = rng.normal(math.log(0.6), 0.4, count), []
    for limit in limits:
        flux, fluxes, broke = limit - 0.8, [], []
        for _ in range(200):
            flux += 0.01
            broke.append(rng.random() < 1 - math.exp(-math.exp(steepness * (flux - limit)) / 60))
            fluxes.append(flux)
            flux -= 0.3 * broke[-1]
        before = np.append(rng.uniform(0.5, 2.0, 4), rng.dirichlet(np.full(5, 30.0)))
        steps = (torch.tensor(each).float() for each in (fluxes, np.zeros(200), np.ones(200)))
        made.append(adapt.History(*steps, torch.tensor(broke), before))
    return made, limits


@pytest.fixture(scope="module")
def taught(adapt):
    torch.manual_seed(0)
    made, limits = histories(adapt)
    hazard = adapt.Hazard(made, steps=150)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adapt, "SHIFT_S", 200)  # a short shift
        return hazard, limits, adapt.taught(hazard, shifts=1, machines=16, cells=8)


def test_the_teacher_finds_where_wires_break_and_how_sharply(taught):
    hazard, limits, _ = taught
    assert np.abs(hazard.limits.numpy() - limits).max() < 0.15
    assert 13 < hazard.steepness < 30
    assert np.corrcoef(hazard.limits.numpy(), limits)[0, 1] > 0.97


def test_what_a_hold_loses_is_least_near_the_best_of_one_who_knows_the_limit(adapt, taught):
    shop = adapt.Shop(taught[0], 64)
    shop.cap[:] = 3.0
    shop.spent[:] = 600.0
    shop.look_ahead()
    targets = torch.zeros(64)
    lost = torch.stack([shop.loss(shop.limit + step, targets) for step in
                        torch.linspace(-1.0, 0.4, 57)])  # fmt: skip
    best = torch.linspace(-1.0, 0.4, 57)[lost.argmin(dim=0)]
    assert ((best > -0.5) & (best < 0.1)).all()  # below the limit, but not far
    assert (lost[-1] > 0.5).all()


def test_the_student_is_saved_as_a_policy_that_does_the_same_and_cuts(adapt, taught, tmp_path):
    _, _, student = taught
    adapt.save(student, tmp_path / "policy.json", "a test", 0, 0)
    controller = from_text(f"policy:{tmp_path / 'policy.json'}")
    policy, memory, own = controller.policy, controller.policy.fresh_memory(), None
    rng = np.random.default_rng(0)
    columns = [adapt.AT[name] for name in adapt.SHOWN]
    for _ in range(5):
        shown = rng.uniform(0, 1, len(adapt.NAMES)).astype(np.float32)
        action, memory = policy.act(shown, memory)
        with torch.no_grad():
            hold, target, own = student(torch.tensor(shown[columns])[None], own)
        assert math.log(policy.card.hold.flux(action[1])) == pytest.approx(float(hold), abs=1e-3)
        assert 0.5 * (action[0] + 1) * adapt.MOST_TARGET == pytest.approx(float(target), abs=1e-4)
    assert Episode(Task(adapt.ENV_ID, episode_s=1.5), controller, 3, "student").run().outcome == "time"


def test_a_history_is_recorded_and_read(adapt, tmp_path):
    adapt.record(3, 3.0, tmp_path / "3.npz")
    one = adapt.history_of(tmp_path / "3.npz")
    assert 2 <= len(one.flux) <= 3  # whole seconds
    assert one.seconds.numpy() == pytest.approx(1.0, abs=0.1)
    assert not one.broke.any()
    assert one.before[4:].sum() == pytest.approx(1.0, abs=1e-3)
