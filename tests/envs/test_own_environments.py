"""Environments that users register: their own family of cuts, or one of ours with other arguments."""

import importlib.util
import json
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from edmsim.envs import Corner, Family, GapFeed, Task, Weights, register
from edmsim.envs.registry import make_family, resolve, stand_in
from edmsim.errors import InputError
from edmsim.evaluation import compare, episode
from edmsim.job.cut import cut
from edmsim.learning import hyperparameters, policy_file, score

BEND = '''\
from dataclasses import dataclass

import numpy as np

from edmsim.envs import GapFeed, register


@dataclass(frozen=True, kw_only=True)
class Bend(GapFeed):
    """An arc."""

    length_mm: float = 0.06
    radius_mm: float = 0.5

    def draw_cut(self, rng, machine, seed, drawn):
        radius_um = 1e3 * self.radius_mm * rng.uniform(0.5, 1.0)
        cut = super().draw_cut(rng, machine, seed, drawn | {"radius_um": radius_um})
        angle = np.linspace(0, 1e3 * self.length_mm / radius_um, 20)
        points = radius_um * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
        return cut._replace(legs_um=(cut.legs_um[0][0] + points,))


register("lab/Bend-v0", Bend, height_mm=(5.0, 6.0), episode_s=10.0)
'''
BEND_ID = "lab/Bend-v0"


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """Take back what tests register."""
    before = dict(gym.registry)
    yield
    gym.registry.clear()
    gym.registry.update(before)


@pytest.fixture
def bend(tmp_path: Path) -> str:
    file = tmp_path / "bend.py"
    file.write_text(BEND, encoding="utf-8")
    return f"{file}:{BEND_ID}"


@pytest.mark.slow
def test_an_own_family_is_a_whole_environment(bend: str) -> None:
    assert resolve(bend) == BEND_ID
    env = gym.make(BEND_ID)
    check_env(env.unwrapped)
    assert make_family(BEND_ID).episode_s == 10.0
    _, info = env.reset(seed=3)
    assert 5 <= info["drawn"]["height_mm"] <= 6
    assert 250 < info["drawn"]["radius_um"] < 500
    envs = gym.make_vec(BEND_ID, num_envs=2, vectorization_mode="vector_entry_point")
    envs.reset(seed=3)
    for _ in range(20):
        one, many = env.step(np.ones(1, np.float32)), envs.step(np.ones((2, 1), np.float32))
        np.testing.assert_array_equal(one[0], many[0][0])
        assert one[1] == many[1][0]
    task = Task(BEND_ID)
    task.reset(3)
    assert task.scenario.legs_um[0].shape == (20, 2)
    assert tuple(task.scenario.legs_um[0][0]) == task.machine.base.table.centre_um


def test_one_of_ours_with_other_arguments() -> None:
    register("lab/Careful-v0", GapFeed, weights=Weights(short=2.0), resolution="fast")
    family = make_family("lab/Careful-v0", history=2)
    assert (family.weights, family.history) == (Weights(short=2.0), 2)
    assert gym.make_vec("lab/Careful-v0", 2).unwrapped.family.weights == family.weights
    kwargs = {"task": "GapFeed", "history": 3}
    gym.register("lab/Plain-v0", entry_point="edmsim.envs.environment:EdmEnv", kwargs=kwargs)
    assert make_family("lab/Plain-v0").history == 3


@dataclass(frozen=True, kw_only=True)
class Pulsing(GapFeed):
    """A straight cut in which a second action sets the pulse period, and the corners are shown."""

    knobs: Sequence[str] = ("period",)
    knows_corners: ClassVar[bool] = True

    def setting_us(self, first_us: Any, requested: Any) -> tuple[float, float]:
        on_us, period_us = first_us
        return on_us, period_us * (2.0 + requested[0])


@pytest.mark.slow
def test_an_own_family_may_set_the_generator_and_show_corners() -> None:
    register("lab/Pulsing-v0", Pulsing, resolution="fast")
    env = gym.make("lab/Pulsing-v0")
    check_env(env.unwrapped)
    assert env.action_space.shape == (2,)
    assert env.observation_space.shape == (50,)
    envs = gym.make_vec("lab/Pulsing-v0", num_envs=2, vectorization_mode="vector_entry_point")
    env.reset(seed=1)
    envs.reset(seed=1)
    for requested, period_us in ((-1.0, 100.0), (0.0, 200.0), (1.0, 300.0)):
        *_, one = env.step(np.array([0.1, requested], np.float32))
        *_, many = envs.step(np.array([[0.1, requested]] * 2, np.float32))
        assert one["t_period_us"] == many["t_period_us"][0] == period_us


def test_no_policy_file_can_describe_observations_and_actions_of_an_own_family():
    for own in (
        {"setting_us": Pulsing.setting_us}, {"locates_discharges": True}, {"next_feed_um_s": Pulsing.draw},
        {"counts_threading": True},
    ):  # fmt: skip
        with pytest.raises(InputError, match="Own has other observations or actions than GapFeed"):
            stand_in(type("Own", (GapFeed,), own), {})


def test_the_registered_form_of_an_own_family_is_json() -> None:
    register("lab/Pulsing-v0", Pulsing, resolution="fast", weights={"short": 2.0})
    spec = gym.make("lab/Pulsing-v0", history=2).unwrapped.spec
    assert spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert again.unwrapped.family == Pulsing(resolution="fast", weights=Weights(short=2.0), history=2)  # type: ignore[attr-defined]


def test_what_cannot_be_registered_is_reported() -> None:
    class Alone(Family):
        def draw_cut(self, *arguments: Any) -> Any: ...

    with pytest.raises(InputError, match="must derive from one of"):
        register("lab/Wrong-v0", Alone)
    with pytest.raises(InputError, match="the family int must derive from one of"):
        make_family(int)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="leg_mm is -1"):
        register("lab/Wrong-v0", Corner, leg_mm=-1)
    with pytest.raises(InputError, match="no argument 'colour'"):
        register("lab/Wrong-v0", Corner, colour="red")
    assert "lab/Wrong-v0" not in gym.registry
    for other in ("edmsim/GapFeed-v2", "edmsim/GapFeed-v9", "GapFeed", "CartPole-v1"):
        with pytest.raises(InputError, match=f"{other} names an environment that is not your own"):
            register(other, Corner)
    assert type(make_family("GapFeed")) is GapFeed


def test_what_a_file_does_not_register_is_reported(bend: str) -> None:
    file = bend.removesuffix(f":{BEND_ID}")
    with pytest.raises(InputError, match=r"bend\.py: this file registers no environment 'lab/Twist-v0'"):
        resolve(f"{file}:lab/Twist-v0")
    with pytest.raises(InputError, match=r"registers no environment '': write .*bend\.py:ID with one of lab"):
        resolve(file)
    with pytest.raises(InputError, match="CartPole"):
        compare.check("CartPole-v1", ["fixed"], 2, "fast")
    with pytest.raises(InputError, match="there is no environment 'lab/Nowhere-v0'"):
        compare.check("lab/Nowhere-v0", ["fixed"], 2, "fast")


@pytest.mark.parametrize(("returned", "said"), [
    ("1 / 0", r"bend\.py:16: Bend\.draw_cut fails: ZeroDivisionError: division by zero"),
    ("machine.with_(height_mm=-1)", r"bend\.py:16: workpiece height -1 mm is not within"),
    ("None", r"bend\.py: Bend\.draw_cut returns None: give a Scenario"),
    ("super().draw_cut(rng, machine, seed, drawn)._replace(legs_um=())", r"bend\.py: .* returns legs_um \(\): give"),
    ("super().draw_cut(rng, machine, seed, drawn)._replace(heights=([0.0], [99.0]))", r"returns heights .* up to"),
])  # fmt: skip
def test_a_cut_that_cannot_be_drawn_is_one_line_with_its_place(bend, returned, said):
    file = Path(bend.removesuffix(f":{BEND_ID}"))
    file.write_text(BEND.replace("radius_um = 1e3 * self.radius_mm * rng.uniform(0.5, 1.0)", f"return {returned}"))
    for _ in range(2):  # a process of a sweep resolves a name for every run
        task = Task(resolve(bend))
    with pytest.raises(InputError, match=said) as refused:
        task.reset(3)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", [list, np.float32, np.int64])
def test_a_path_may_be_a_list_or_of_any_numbers(kind):
    def draw_cut(self, *arguments):
        cut = GapFeed.draw_cut(self, *arguments)
        leg = np.rint(cut.legs_um[0])
        return cut._replace(legs_um=[leg.tolist() if kind is list else leg.astype(kind)])

    task = Task(type("Own", (GapFeed,), {"draw_cut": draw_cut}))
    task.reset(1)
    assert task.total_um == 3000.0


def test_what_a_file_registers_can_be_pickled(bend):
    family = make_family(resolve(bend))
    assert pickle.loads(pickle.dumps(family)) == family


def test_registered_arguments_stay_where_controllers_are_compared_and_policies_trained(bend: str) -> None:
    resolve(bend)
    assert episode.lines_of(BEND_ID).seeds == episode.lines_of("edmsim/GapFeed-v2").seeds
    assert hyperparameters.load(BEND_ID, "ppo").num_envs == hyperparameters.load("GapFeed", "ppo").num_envs


@pytest.mark.slow
def test_controllers_are_compared_in_it(bend, edmsim):
    shown = edmsim("evaluate", bend, "--controllers", "voltage", "--seeds", 2, "--resolution", "fast", "--json")
    (found,) = json.loads(shown.out)
    assert found["env_id"] == BEND_ID
    assert {cut["outcome"] for cut in found["cuts"]} == {"finished"}


@pytest.mark.slow
def test_environments_of_one_family_have_their_own_recordings_and_figures(tmp_path, edmsim):
    (tmp_path / "own.py").write_text(
        "from edmsim.envs import GapFeed, register\n"
        "for lab in 'ab':\n    register(f'{lab}/GapFeed-v2', GapFeed, episode_s=0.1)\n", encoding="utf-8",
    )  # fmt: skip
    both = [f"{tmp_path / 'own.py'}:{lab}/GapFeed-v2" for lab in "ab"]
    page, out = tmp_path / "page.md", tmp_path / "out"
    words = "--controllers", "fixed", "--seeds", 2, "--page", page, "--record", out
    assert edmsim("evaluate", *both, *words).status == 0
    for name in ("a-GapFeed-v2", "b-GapFeed-v2"):
        assert (out / name / "seed-1000000" / "fixed" / "cut.rrd").is_file()
        assert f"](page-{name}.png)" in page.read_text(encoding="utf-8")
        assert (tmp_path / f"page-{name}.png").is_file()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="the extra rl is not installed")
def test_a_policy_trained_in_it_cuts_where_nobody_knows_it(
    bend, small_punch, tmp_path, edmsim, monkeypatch, short_training
):
    monkeypatch.setattr("edmsim.learning.score.RESOLUTIONS", ("fast",))
    assert edmsim("train", bend, "--steps", 64, "--score", 2, "--out", tmp_path / "bend").status == 0
    gym.registry.pop(BEND_ID)
    card = policy_file.load(str(tmp_path / "bend" / "policy.json")).card
    assert card.env_id == "edmsim/GapFeed-v2"
    assert card.command.startswith(f"edmsim train {bend} --algo ppo")
    # what differs from the defaults of the id that anybody knows
    assert card.environment == {"machine_episodes": 4, "height_mm": [5.0, 6.0], "episode_s": 10.0, "length_mm": 0.06}
    assert [row["env_id"] for row in card.scores] == [BEND_ID] * 3
    score.write_card(str(tmp_path / "bend" / "policy.json"), [score.Score("policy", "fast", 2, *[1.0] * 5, 0, 0)])
    assert len(policy_file.load(str(tmp_path / "bend" / "policy.json")).card.scores) == 4  # those of `bend` stay
    made = cut(small_punch, controller=f"policy:{tmp_path / 'bend' / 'policy.json'}", height_mm=5.0,
               resolution="fast", max_time_s=1.0)  # fmt: skip
    assert made.windows.num_rows > 30
