"""What was learned since a start is accepted only where other machines do not earn less by it."""

import numpy as np
import pytest

from edmsim.errors import InputError
from edmsim.evaluation import episode
from edmsim.learning import policy_file, score

RNG = np.random.default_rng(1)
MACHINES = RNG.uniform(500, 3000, 12)  # what a start earns: machines differ far more than policies


@pytest.mark.parametrize(
    ("change", "accepted"),
    [(0.0, True), (40.0, True), (-100.0, False), (RNG.normal(60, 30, 12), True), (RNG.normal(0, 400, 12), False)],
    ids=["the same", "better", "worse", "better on most", "not known to be no worse"],
)
def test_a_policy_is_accepted_by_its_differences_machine_by_machine(change, accepted):
    found = score.verdict(MACHINES + change, MACHINES)
    assert found.accepted is accepted
    assert found.words().startswith("accepted" if accepted else "refused")
    assert found.difference.low <= found.difference.value <= found.difference.high


def test_the_machines_are_none_of_a_comparison():
    assert score.FIRST_SEED + 1000 < episode.HELD_BACK


@pytest.mark.parametrize(("worse", "left"), [(True, "start"), (False, "trained")])
def test_a_refused_policy_is_saved_next_to_its_start(tmp_path, monkeypatch, worse, left):
    shipped = policy_file.locate("GapFeed-ppo")
    trained, policy_json, refused = (tmp_path / f"{name}.json" for name in ("candidate", "policy", "refused"))
    policy = policy_file.load("GapFeed-ppo")
    card = policy.card.model_copy(update={"command": "trained"})
    policy_file.write(card, shipped.with_suffix(".npz").read_bytes(), trained)
    for file in (refused, refused.with_suffix(".npz")):
        file.write_text("of a training before")

    class Cut:
        def __init__(self, seed, name):
            assert not policy_json.exists()  # an interruption leaves no policy that was not accepted
            self.total_return = MACHINES[seed - score.FIRST_SEED] - (500.0 if worse and "trained" in name else 0.0)

    def cut_job(env_id, job):
        return Cut(job[1], job[0].replace(str(trained), "trained"))

    monkeypatch.setattr(episode, "cut_job", cut_job)
    found = score.accept("edmsim/GapFeed-v2", trained, "policy:GapFeed-ppo", 6)
    assert found.machines == 6
    assert (policy_file.load(str(policy_json)).card.command == "trained") is (left == "trained")
    assert not trained.exists()
    assert refused.exists() is refused.with_suffix(".npz").exists() is worse
    if worse:
        assert policy_file.load(str(refused)).card.command == "trained"


@pytest.mark.parametrize(
    ("machines", "start", "said"), [(3, "policy:GapFeed-ppo", "4 or more"), (6, None, "--start")]
)
def test_what_cannot_be_compared_is_refused_before_the_training(machines, start, said):
    with pytest.raises(InputError, match=said):
        score.check_safe(machines, start)


@pytest.mark.parametrize("algo", ["ppo", "bandit"])
def test_a_training_does_not_replace_the_policy_of_a_folder(tmp_path, algo):
    file = tmp_path / "policy.json"
    file.write_text("a start")
    with pytest.raises(InputError, match="has a policy, which the training would replace"):
        score.train_and_score("edmsim/GapFeed-v2", algo, tmp_path, 64, 0, False, 0)
    assert file.read_text() == "a start"
