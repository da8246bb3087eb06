"""Part: passes of a part decided on one by one; its cut is that of ``edmsim cut --passes``."""

import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import InvalidAction
from gymnasium.utils.env_checker import check_env

import edmsim
from edmsim.envs import pass_laws
from edmsim.envs.part_task import ACTIONS, ENTRIES, LEFT_UM, TERMS, Part
from edmsim.envs.registry import make_family, stand_in
from edmsim.errors import InputError
from edmsim.evaluation.compare import check, evaluate
from edmsim.evaluation.episode import cut

from .conftest import infos_of, played

ID = "edmsim/Part-v0"
PROGRAM = "G21 G90\nG92 X0.2 Y-0.26\nG41 D1 G1 X0.2 Y0\nG1 X0\nY0.1\nX0.9\nY0\nX0.2\nG40\nM2\n"
"""A punch of 0.9 x 0.1 mm, which is cut in a second of computing."""
USUAL = np.zeros(len(ACTIONS), np.float32)
HOT = np.array([0.0, -1.0, 1.0, 0.0], np.float32)
"""A quarter of the pause and longer pulses: no wire bears them."""
AT = {entry.name: k for k, entry in enumerate(ENTRIES)}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return arguments of a small part in two passes, of one machine."""
    program = tmp_path_factory.mktemp("part") / "small.ngc"
    program.write_text(PROGRAM)
    return {"program": str(program), "passes": 2, "tab_mm": 0.0, "height_mm": 18.0, "tension_share": 1.0,
            "randomise": None}  # fmt: skip


@pytest.fixture(scope="module")
def tiny(small, tmp_path_factory):
    """Return arguments of a part as small as can be: Gymnasium's checker runs ten passes."""
    program = tmp_path_factory.mktemp("part") / "tiny.ngc"
    program.write_text(PROGRAM.replace("X0.9", "X0.25"))
    return {**small, "program": str(program)}


@pytest.fixture(scope="module")
def usual(small):
    """Return an episode as the technology has it."""
    return played(gym.make(ID, **small), [USUAL] * 2)


@pytest.mark.slow
def test_the_part_of_the_technologys_constants_is_the_cut_bit_for_bit(small, usual):
    seed = gym.make(ID, **small).reset(seed=1)[1]["plant_seed"]
    made = edmsim.cut(
        small["program"], passes=2, tab_mm=0.0, height_mm=18.0, resolution="fast", seed=seed,
        technology="tool-steel-brass-254",
    ).report
    last = usual[-1][4]
    assert last["cause"] == "done"
    assert last["time_s"] == made["machining_time_s"]
    assert last["error_um"] == made["profile_error_um"]["rms"]
    assert last["ra_um"] == made["passes"][-1]["ra_um"]
    assert [step[4]["offset_um"] for step in usual] == [one["offset_um"] for one in made["passes"]]
    assert [step[4]["dt_s"] for step in usual] == pytest.approx(
        [made["passes"][0]["end_s"], made["passes"][1]["end_s"] - made["passes"][0]["end_s"]]
    )


@pytest.mark.slow
def test_the_reward_is_time_and_at_the_end_error_and_roughness(usual):
    weights = Part().reward_weights
    for _, reward, _, _, info in usual:
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        assert info["reward_terms"]["time"] == pytest.approx(-weights.time * info["dt_s"] / 60)
    first, last = usual[0][4]["reward_terms"], usual[1][4]
    assert (first["error"], first["roughness"]) == (0.0, 0.0)
    assert last["reward_terms"]["error"] == pytest.approx(-weights.error * last["error_um"])
    assert last["reward_terms"]["roughness"] == pytest.approx(-weights.roughness * last["ra_um"])
    assert set(first) == set(TERMS)


@pytest.mark.slow
def test_sub_environments_are_the_single_environments_with_any_threads_and_copies_go_on(small, usual):
    envs = gym.make_vec(ID, num_envs=2, vectorization_mode="vector_entry_point", threads=2, wires=1, **small)
    envs.reset(seed=0)  # sub-environment 1 is the single one with seed 1
    envs.step(np.stack([HOT, USUAL]))
    for same in (pickle.loads(pickle.dumps(envs)), envs):  # as copy.deepcopy does it
        observations, rewards, terminated, truncated, infos = same.step(np.stack([USUAL, USUAL]))
        assert observations[1].tolist() == usual[1][0].tolist()
        assert rewards[1] == usual[1][1]
        assert (terminated[1], truncated[1]) == (True, False)
        assert infos["error_um"][1] == usual[1][4]["error_um"]
        same.close()


@pytest.mark.slow
def test_a_broken_wire_ends_the_step_and_the_rest_of_the_pass_is_decided_on(small):
    env = gym.make(ID, **small, wires=2, pause_octaves=2.0)
    env.reset(seed=1)
    observation, _, terminated, _, info = env.step(HOT)
    assert not terminated
    assert (observation[AT["broke"]], info["wires_lost"], info["cost"], info["pass"]) == (1.0, 1, 1.0, 1)
    assert 0.0 < observation[AT["rest"]] < 1.0
    assert info["reward_terms"]["wire_break"] < 0.0
    calm = env.step(USUAL)
    assert (calm[4]["pass"], calm[4]["cause"]) == (1, "")  # the technology's setting brings the pass to its end
    assert calm[0][AT["broke"]] == 0.0
    assert calm[4]["time_s"] > info["time_s"] + calm[4]["dt_s"]  # threading takes time, which is not cutting
    assert env.step(USUAL)[2]


@pytest.mark.slow
def test_the_last_wire_scraps_the_part_and_time_truncates(small):
    (info,) = infos_of(gym.make(ID, **small, wires=1, pause_octaves=2.0), [HOT])
    assert info["cause"] == "wire-break"
    assert info["reward_terms"]["limit"] == -Part().reward_weights.limit
    # machine time has that for the second wire, and the rate that for the next one as well, as of other tasks
    made = cut(ID, 1, "constant:pause=-1,on_time=1", **small, wires=2, pause_octaves=2.0)
    assert (made.outcome, made.wires_lost) == ("wire break", 2)
    assert 20.0 < made.time_s < 40.0
    assert made.rate_mm2_min == pytest.approx(60 * made.area_mm2 / (made.time_s + 20.0))
    env = gym.make(ID, **small, episode_s=5.0)
    env.reset(seed=1)
    _, _, terminated, truncated, info = env.step(USUAL)
    assert (terminated, truncated, info["cause"]) == (False, True, "")
    assert info["dt_s"] == pytest.approx(5.0, abs=0.1)
    part = env.unwrapped._batch.episode(0).cut  # within a pass nothing is to decide on, and no wire to thread
    with pytest.raises(InputError, match="under way"):
        part.simulation.begin_pass(part.path, ())
    with pytest.raises(InputError, match="no wire broke"):
        part.simulation.rethread(None, None)


@pytest.mark.slow
def test_a_pass_can_be_the_episode(small, usual):
    env = gym.make(ID, **small, only_pass=2)
    observation, info = env.reset(seed=1)
    assert observation[AT["short"]] == usual[0][0][AT["short"]]  # the rough cut is made, and seen
    assert (observation[AT["pass"]], observation[AT["spent"]], info["wires_lost"]) == (1.0, 0.0, 0)
    _, _, terminated, _, info = env.step(USUAL)
    assert terminated
    assert (info["pass"], info["dt_s"]) == (2, usual[1][4]["dt_s"])
    assert info["error_um"] == usual[1][4]["error_um"]  # it is the last pass: the part's error


@pytest.mark.slow
def test_offsets_move_and_never_grow(tiny, usual):
    near, far = infos_of(gym.make(ID, **tiny, offset_um=50.0), [[0.0, 0.0, 0.0, -0.2], [0.0, 0.0, 0.0, 1.0]])
    assert near["offset_um"] == usual[0][4]["offset_um"] - 10.0
    assert far["offset_um"] == near["offset_um"]  # 11 um more would be asked for


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_gymnasium_and_stable_baselines3_find_nothing(tiny):
    env = gym.make(ID, **tiny, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=1)
    assert env.render().shape == (480, 640, 3)
    short = {**tiny, "episode_s": 2.0}  # a step is over by then
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3.check_env(gym.make(ID, **short).unwrapped, skip_render_check=True)


def test_what_cannot_be_is_refused_in_one_line(small):
    env = gym.make(ID, **small)
    env.reset(seed=1)
    with pytest.raises(InvalidAction):
        env.step(np.full(len(ACTIONS), np.nan, np.float32))
    for arguments, named in (
        ({"only_pass": 3}, "only_pass"), ({"passes": 12}, "passes"), ({"passes": 1}, "passes"),
        ({"height_mm": 300.0}, "height"), ({"program": "none.ngc"}, "none.ngc"),
        ({"technology": "brass"}, "technology"), ({"objectives": ["progress"]}, "objective"),
        ({"offset_um": 0.0}, "offset_um"), ({"weights": {"speed": 1}}, "weights"),
        ({"tension_share": 10.0}, "breaks"), ({"weights": edmsim.envs.Weights()}, "give PartWeights or None"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=named):
            gym.make(ID, **{**small, **arguments})
    with pytest.raises(InputError, match="pass by pass"):
        make_family(ID)
    with pytest.raises(InputError, match="machine of its technology"):
        env.reset(options={"machine": edmsim.Machine.load()})
    with pytest.raises(InputError, match="pass by pass"):
        env.unwrapped.recorder()


@pytest.mark.slow
def test_several_objectives_and_arguments_that_change(tiny):
    env = gym.make(ID, **tiny, objectives=["time", "error"]).unwrapped
    assert env.reward_space.shape == (2,)
    env.change(only_pass=1)
    env.reset(seed=1)
    _, reward, terminated, _, info = env.step(USUAL)
    assert (terminated, info["cause"]) == (True, "done")
    assert reward.tolist() == pytest.approx([info["reward_terms"][name] for name in ("time", "error")])
    with pytest.raises(InputError, match="objectives"):
        env.change(objectives=["time"])


@pytest.mark.slow
def test_machines_are_drawn_within_their_ranges_and_a_seed_draws_the_same():
    env = gym.make(ID)
    drawn = [env.reset(seed=seed)[1]["drawn"] for seed in (1, 2, 1)]
    assert drawn[0] == drawn[2] != drawn[1]
    for one in drawn:
        assert 18.0 <= one["height_mm"] <= 36.0
        assert 0.85 <= one["tension_share"] <= 1.05
    assert set(env.unwrapped.family.drawn_constants) < set(drawn[0])


def test_a_setting_without_a_tension_has_a_share_of_the_wires_own(small, own_file):
    rough = "t_period_us = 33.2\npeak_current_A = 535.4\n"
    bare = own_file("technologies", "tool-steel-brass-254", (f"{rough}tension_N = 10.32\n", rough))
    env = gym.make(ID, **{**small, "height_mm": 25.4, "technology": bare, "tension_share": 0.9})
    env.reset(seed=1)
    assert env.unwrapped._batch.episode(0).cut.machine.tension == 0.9 * edmsim.Machine.load(wire="brass-254").tension


def test_laws_are_made_of_their_names():
    observed = np.zeros(len(ENTRIES), np.float32)
    assert pass_laws.from_text("technology").act(observed).tolist() == [0.0] * 4
    law = pass_laws.from_text("corrected:gain=0.5,bias_um=0,last_gain=1,last_bias_um=0,fast=0.7,calm=0.25")
    law.begin()
    assert law.act(observed).tolist() == [0.0] * 4
    observed[[AT["left"], AT["gauged"], AT["short"]]] = -8.0 / LEFT_UM, 1.0, 0.2
    assert law.act(observed).tolist() == [0.0] * 4  # what the rough pass left says nothing of the first trim
    observed[AT["short"]] = 0.01
    assert law.act(observed) == pytest.approx([0.7, 0.0, 0.0, 4.0 / 20.0])  # 8 um too much: half of it farther off
    observed[AT["broke"]] = 1.0
    assert law.act(observed) == pytest.approx([0.7, 0.25, 0.0, 4.0 / 20.0])
    observed[[AT["broke"], AT["pass"]]] = 0.0, 1.0
    assert law.act(observed)[3] == pytest.approx(12.0 / 20.0)  # with its path not moved it would have been 12 um
    for text, named in (
        ("correct", "no law"), ("corrected:speed=1", "speed"), ("technology:pause=1", "none"),
        ("constant:pause=9", "pause is 9.0: give a number from -1 to 1"),
    ):
        with pytest.raises(InputError, match=named):
            pass_laws.from_text(text)


@pytest.mark.slow
def test_parts_are_compared_by_what_a_law_earns(small, usual):
    made = cut(ID, 1, "technology", **small)
    assert made.total_return == pytest.approx(sum(step[1] for step in usual))
    assert (made.edge_error_um, made.ra_um) == (usual[-1][4]["error_um"], usual[-1][4]["ra_um"])
    assert made.outcome == "finished"
    with pytest.raises(InputError, match="no law"):
        evaluate(ID, ["counts"], 2)
    with pytest.raises(InputError, match="no feed controller"):
        check("edmsim/GapFeed-v2", ["technology"], 2, None)


def test_what_belongs_to_windows_is_refused_of_parts(tmp_path):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("minari")
    from edmsim.learning.dataset import record
    from edmsim.learning.score import TrainOptions, train_and_score

    for options in (TrainOptions(residual="counts"), TrainOptions(privileged_critic=True)):
        with pytest.raises(InputError, match="pass by pass"):
            train_and_score(ID, "ppo", tmp_path, 8, 0, False, 0, options)
    with pytest.raises(InputError, match="pass by pass"):
        record(ID, ["counts"], 10, tmp_path)


def test_a_policy_of_parts_is_described_by_the_environment_of_edmsim():
    class Steep(Part):
        """A user's, with other costs."""

    assert stand_in(Steep, {"passes": 3, "weights": None}) == (ID, {"passes": 3})


@pytest.mark.slow
def test_a_training_writes_a_policy_that_decides_on_passes(tiny, tmp_path):
    pytest.importorskip("stable_baselines3")
    from edmsim.learning import hyperparameters, policy_file
    from edmsim.learning.train import train

    known = hyperparameters.load(ID, "ppo")
    cut_short = {**tiny, "episode_s": 2.0}  # a step is over by then
    short = known.model_copy(update={"num_envs": 2, "environment": cut_short, "algorithm": {
        **known.algorithm, "n_steps": 1, "batch_size": 2, "n_epochs": 1,
    }})  # fmt: skip
    trained = train(ID, "ppo", tmp_path, steps=2, seed=1, parameters=short)
    policy_file.write(*trained.export("edmsim train"), tmp_path / "policy.json")
    made = cut(ID, 1, f"policy:{tmp_path / 'policy.json'}", **tiny)
    assert made.outcome == "finished"
    with pytest.raises(InputError, match="pass by pass"):
        edmsim.controllers.from_text(f"policy:{tmp_path / 'policy.json'}")
