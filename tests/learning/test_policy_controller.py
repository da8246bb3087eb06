"""A policy as a controller does what it would do in its environment; files that cannot be used are refused."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import edmsim
from edmsim.controllers import check_controller
from edmsim.controllers.protocols import WindowObservation, set_up_controller
from edmsim.envs.episode import Task
from edmsim.envs.registry import env_id_of, make_family
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.job.plan import make_controller
from edmsim.learning import bandit, policy_file
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.score import measured_with

ROOT = Path(__file__).parents[2]
LINE_UM = np.array([[0.0, 0.0], [1000.0, 0.0]])
AIR = WindowObservation(1.0, 0.0255, 0, 255, 30.0, 0.0, float("nan"), 33.0, 0.0)
SPARKS, SHORTS = AIR._replace(open=249, mean_delay_us=25.0), AIR._replace(open=249, short=6)
SLOTS = "G21 G90\nG0 X0 Y0\nG1 X0.3\nG4 P1\nX0.4\nG0 X3 Y0\nG1 X3.3\nM2\n"
"""Three legs: two in one slot with a dwell between them, then one in another start hole."""


@pytest.fixture
def make_policy(tmp_path):
    """Write a policy of an environment with a random network; return its .json."""

    def make(name, **options):
        environment = {"resolution": "fast", **options}
        family, file, rng = make_family(name, **environment), tmp_path / f"{name}.json", np.random.default_rng(4)
        sizes = [len(family.entries()), 8, len(family.action_names)]
        policy_file.write_policy(
            file, env_id=env_id_of(name), environment=environment, lstm=None, algorithm="ppo", command="none: random",
            weights=[rng.normal(0, 0.4, shape) for shape in pairwise(sizes)], seed=0, steps=0,
            biases=[rng.normal(0, 0.1, size) for size in sizes[1:]], mean=rng.uniform(0, 0.2, sizes[0]),
            variance=rng.uniform(0.1, 1, sizes[0]),
        )  # fmt: skip
        return file

    return make


def started(controller, task, seed=5):
    """Begin an episode with a controller; return its first command."""
    task.reset(seed)
    set_up_controller(controller, task.machine, task.scenario.legs_um[0], 0.0)
    return controller.reset(task.max_feed_um_s)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [("GapFeed", {}), ("HeightStep", {"action": "speed"}), ("Corner", {"leg_mm": 0.05, "decision_s": None}),
     ("Contour", {"history": 2}), ("GapFeed", {"action": "servo", "knobs": ["period"]}),
     ("ThinWire", {"decision_s": None, "wires": 1}), ("MaxRate", {"decision_s": None, "wires": 1}),
     ("Trim", {"decision_s": None})],
)
def test_the_controller_does_what_the_policy_does_in_its_environment(make_policy, name, options):
    policy = policy_file.load(str(make_policy(name, **options)))
    env = gym.make(env_id_of(name), resolution="fast", **options)
    task, controller = Task(name, resolution="fast", **options), PolicyController(policy)
    observed, _ = env.reset(seed=5)
    command, settings = started(controller, task), set()
    for _ in range(120):
        observed, reward, terminated, _, info = env.step(policy.action(observed).astype(np.float32))
        result = task.advance(command.feed_um_s, command.t_on_us, command.t_period_us, command.offset_um)
        assert command.offset_um == pytest.approx(info["offset_um"], abs=1e-4)
        # observations are float32: actions differ by some of their last digits, feeds by such a part of the greatest
        rounding_um_s = 2e-6 * env.unwrapped.family.max_feed_um_s
        assert result.observation.feed_um_s == pytest.approx(info["feed_um_s"], abs=rounding_um_s)
        assert (task.machine.t_on_us, task.machine.t_period_us) == (info["t_on_us"], info["t_period_us"])
        assert result.reward == pytest.approx(reward, abs=1e-3)
        settings.add((info["t_on_us"], info["t_period_us"]))
        assert result.over == terminated
        if terminated:
            break
        command = controller.update(result.observation)
    assert (len(settings) > 1) == (name in ("Corner", "MaxRate", "ThinWire", "Trim") or "knobs" in options)


def test_a_policy_that_decides_more_seldom_than_windows_come_sees_what_its_environment_shows(make_policy):
    options = {"action": "servo", "decision_s": 0.1}
    policy = policy_file.load(str(make_policy("GapFeed", **options)))
    env, task = gym.make("edmsim/GapFeed-v2", **options), Task("GapFeed")
    observed, _ = env.reset(seed=5)
    controller = PolicyController(policy)
    command = started(controller, task)
    for _ in range(30):
        observed, *_, info = env.step(policy.action(observed).astype(np.float32))
        assert info["dt_s"] == pytest.approx(4 * 0.0255)
        for _ in range(4):
            result = task.advance(command.feed_um_s)
            command = controller.update(result.observation)
        assert result.observation.path_um == info["path_um"]


def test_a_policy_goes_on_with_the_next_wire(make_policy):
    controller = PolicyController(policy_file.load(str(make_policy("ThinWire"))))
    machine = edmsim.Machine.load(wire="brass-100", t_on_us=10.0, t_period_us=100.0)
    set_up_controller(controller, machine, np.array([[0.0, 0.0], [1000.0, 0.0]]), 0.0)
    window = WindowObservation(1.0, 0.0255, 0, 20, 20.0, 1.0, 9.0, 10.0, 0.0)
    controller.reset(33.0)
    for _ in range(10):
        controller.update(window)
    t_on_us, t_period_us = controller.snapshot()["setting_us"]
    ratio = t_period_us / t_on_us
    command = controller.wire_lost()
    assert (command.feed_um_s, command.t_on_us, command.t_period_us) == (5.0, 10.0, 100.0)
    assert ratio != 10.0
    family = controller.policy.family()
    expected = [1 / family.wires, 0.0, 10 * 0.0255 / family.episode_s, np.log2(ratio) / 10]
    assert controller.observation[-4:] == pytest.approx(expected)
    assert controller.reset(33.0) == controller.reset(33.0)
    assert controller.observation[-4] == 0.0


def test_the_law_that_a_policy_adds_to_goes_on_with_the_next_wire_as_in_training(make_policy):
    policy = policy_file.load(str(make_policy("ThinWire", action="speed", decision_s=None, knobs=[])))
    residual = policy_file.Residual(law="voltage", range_um_s=1e-3)
    controller = PolicyController(replace(policy, card=policy.card.model_copy(update={"residual": residual})))
    set_up_controller(controller, edmsim.Machine.load(), np.array([[0.0, 0.0], [1000.0, 0.0]]), 0.0)
    first = controller.reset(33.0)
    window = WindowObservation(1.0, 0.0255, 255, 0, 0.0, 1.0, 9.0, 5.0, 0.0)
    retreat = [controller.update(window) for _ in range(10)][-1]
    assert retreat.feed_um_s < 0.0
    assert controller.wire_lost().feed_um_s == pytest.approx(first.feed_um_s, abs=0.01)


def test_a_snapshot_goes_on_bit_for_bit(make_policy):
    first, second = (make_controller(f"policy:{make_policy('Corner')}") for _ in range(2))
    task = Task("Corner", resolution="fast")
    started(second, task, 1)
    command = started(first, task, 1)
    for _ in range(15):
        command = first.update(task.advance(command.feed_um_s, command.t_on_us, command.t_period_us).observation)
    second.restore(json.loads(json.dumps(first.snapshot())))
    window = task.advance(command.feed_um_s).observation
    assert first.update(window) == second.update(window)
    assert first.snapshot() == second.snapshot()


def test_a_short_that_stays_raises_the_alarm_and_a_dwell_is_noticed(make_policy):
    controller = make_controller(f"policy:{make_policy('GapFeed')}")
    machine = edmsim.Machine.load()
    set_up_controller(controller, machine, np.array([[0.0, 0.0], [1000.0, 0.0]]), 0.0)
    controller.reset(33.0)
    held = edmsim.controllers.WindowObservation(0.0, 0.0255, 0, 255, 60.0, 0.0, float("nan"), 0.0, 0.0)
    for _ in range(50):
        command = controller.update(held)
    assert abs(command.feed_um_s) <= 4.0  # a change of what the machine ran, not of what it was asked for
    shorted = held._replace(short=255, open=0)
    commands = [controller.update(shorted) for _ in range(80)]
    alarms = [i for i, command in enumerate(commands) if command.alarm]
    assert alarms[0] == 78  # 79 windows of 25.5 ms are the first to last longer than 2 s
    assert commands[-1][:2] == (0.0, "persistent short")


@pytest.fixture
def retreating(tmp_path):
    """Write a policy that runs back in windows without sparks, or with many shorts; return its .json."""
    family = make_family("GapFeed")
    entries = [entry.name for entry in family.entries()]
    weights = np.zeros((len(entries), 1))
    weights[entries.index("spark")], weights[entries.index("short")] = 300.0, -3000.0
    policy_file.write_policy(
        tmp_path / "retreating.json", env_id="edmsim/GapFeed-v2", environment={}, mean=np.zeros(len(entries)),
        variance=np.ones(len(entries)), lstm=None, weights=[weights], biases=[np.array([-1.0])], algorithm="own",
        command="none", seed=0, steps=0,
    )  # fmt: skip
    return tmp_path / "retreating.json"


class WithoutApproach(PolicyController):
    """Leaves the approach out: a cut begins as an episode does."""

    reset_in_air = PolicyController.reset


@pytest.mark.parametrize("met", [SPARKS, SHORTS], ids=["sparks", "shorts"])
@pytest.mark.parametrize(
    ("name", "options", "first_um_s"),
    [("GapFeed", {}, 5.0), ("Corner", {"action": "speed", "decision_s": None}, 0.0)],  # with setting, offset
)
def test_the_first_pulses_that_find_metal_end_the_approach_and_the_policy_begins_there(
    make_policy, met, name, options, first_um_s
):
    file = make_policy(name, **options)
    cutting, fresh = (make_controller(f"policy:{file}") for _ in range(2))
    for controller in (cutting, fresh):
        set_up_controller(controller, edmsim.Machine.load(), LINE_UM, 0.0)
    assert cutting.reset_in_air(33.0) == (first_um_s, None, None, None, 0.0, 0.0)  # an episode's first feed
    for open_ in (*[255] * 40, 250):
        assert cutting.update(AIR._replace(open=open_)) == (33.0, None, None, None, 0.0, 0.0)
    assert cutting.update(met._replace(path_um=40.0)) == fresh.reset(33.0)
    for window in (met, AIR, AIR, met):  # no second approach
        further = window._replace(path_um=40.0 + window.path_um)
        assert cutting.update(further) == fresh.update(window)
    np.testing.assert_array_equal(cutting.observation, fresh.observation)
    assert cutting.reset_in_air(33.0).feed_um_s == first_um_s
    assert cutting.update(AIR).feed_um_s == 33.0  # of the next leg


def test_the_approach_is_no_faster_than_the_policy(make_policy):
    controller = make_controller(f"policy:{make_policy('GapFeed', max_feed_um_s=40.0)}")
    set_up_controller(controller, edmsim.Machine.load(), LINE_UM, 0.0)
    controller.reset_in_air(400.0)
    assert controller.update(AIR).feed_um_s == 40.0


@pytest.mark.parametrize("kind", ["servo", "residual"])
def test_a_policy_whose_law_moves_the_wire_begins_at_once(make_policy, kind):
    options = {"action": "servo", "knobs": ["period"]} if kind == "servo" else {"action": "speed"}
    policy = policy_file.load(str(make_policy("GapFeed", **options)))
    if kind == "residual":
        residual = policy_file.Residual(law="voltage", range_um_s=5.0)
        policy = replace(policy, card=policy.card.model_copy(update={"residual": residual}))
    cutting, fresh = PolicyController(policy), PolicyController(policy)
    for controller in (cutting, fresh):
        set_up_controller(controller, edmsim.Machine.load(), LINE_UM, 0.0)
    assert cutting.reset_in_air(33.0) == fresh.reset(33.0)
    for _ in range(5):
        assert cutting.update(AIR) == fresh.update(AIR)


def test_an_episode_has_no_approach(retreating):
    task, controller = Task("GapFeed", resolution="fast"), make_controller(f"policy:{retreating}")
    episode = Episode(task, controller, 5, "retreating")
    assert controller.snapshot()["approaching"] is False
    assert next(episode.windows()).observation.feed_um_s < 5.0  # the policy's first action


def test_a_policy_conforms_from_its_approach_on(retreating):
    check_controller(lambda: make_controller(f"policy:{retreating}"))


@pytest.mark.slow
def test_a_policy_that_retreats_in_air_cuts_every_leg_after_an_approach(retreating, tmp_path):
    program = tmp_path / "slots.ngc"
    program.write_text(SLOTS)
    options = {"height_mm": 5.0, "resolution": "fast", "offset": "none", "max_time_s": 120.0}
    cut = edmsim.cut(program, controller=make_controller(f"policy:{retreating}"), **options)
    assert cut.report["outcome"] == "finished"
    stuck = edmsim.cut(program, controller=WithoutApproach(policy_file.load(str(retreating))), **options)
    assert stuck.report["outcome"] == "time-limit"
    assert stuck.windows.column("open").to_numpy().min() == 255


@pytest.mark.slow
def test_a_cut_interrupted_in_the_approach_goes_on_bit_for_bit(retreating, tmp_path):
    program, out = tmp_path / "slots.ngc", tmp_path / "out"
    program.write_text(SLOTS)
    options = {"controller": f"policy:{retreating}", "height_mm": 5.0, "resolution": "fast", "offset": "none",
               "max_time_s": 3.0}  # fmt: skip
    whole = edmsim.cut(program, **options).windows
    assert whole.column("open").to_numpy()[:20].min() == 255  # in air when it is interrupted
    assert whole.column("open").to_numpy().min() < 250  # it ends the approach after that

    def interrupt(progress):
        if progress.time_s > 0.25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        edmsim.cut(program, out=out, watch=interrupt, **options)
    resumed = edmsim.cut(program, out=out, resume=True, **options).windows
    np.testing.assert_equal(resumed.to_pydict(), whole.to_pydict())  # NaN equals NaN there


@pytest.mark.slow
def test_the_corners_of_a_later_leg_are_observed_where_they_are(make_policy):
    file, commands = make_policy("Contour"), []
    points = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 300.0]])
    observed = edmsim.controllers.WindowObservation(0.0, 0.0255, 10, 60, 40.0, 1.0, 9.0, 20.0, 0.0)
    for start_um in (0.0, 1024.0):
        controller = make_controller(f"policy:{file}")
        set_up_controller(controller, edmsim.Machine.load(), points, start_um)
        first = controller.reset(33.0)
        places = np.arange(0.5, 600.0, 0.5) + start_um
        commands.append([first, *(controller.update(observed._replace(path_um=place)) for place in places.tolist())])
    assert commands[0] == commands[1]
    assert len({command.feed_um_s for command in commands[0]}) > 2


@pytest.mark.parametrize("file", sorted((ROOT / "models" / "policies").glob("*.json")), ids=lambda f: f.stem)
def test_what_is_shipped_loads_by_name_and_says_how_it_was_made(file):
    found = bandit.find(file.stem)
    card = bandit.load(found) if found else policy_file.load(file.stem).card
    name, trained_in = ("adapt", None) if found else (card.algorithm, card.trained_in)
    assert file.stem == f"{card.env_id.removeprefix('edmsim/')[:-3]}-{name}"
    made_by = f"edmsim train {trained_in or card.env_id} --algo {card.algorithm} "
    assert card.command.startswith((made_by, f"python examples/learning/{name}.py "))
    assert trained_in != card.env_id
    rivals, resolutions = measured_with(card.env_id)
    assert {(s["controller"], s["resolution"]) for s in card.scores} == {
        (c, r) for c in ("policy", *rivals) for r in resolutions
    }
    if found:
        return
    policy = policy_file.load(file.stem)
    assert file.with_suffix(".npz").stat().st_size < 100_000
    assert (np.abs(policy.action(np.zeros(len(card.observation)))) <= 1).all()


def edit(change):
    def damage(file):
        document = json.loads(file.read_text())
        change(document)
        file.write_text(json.dumps(document))

    return damage


def replace_arrays(change):
    def damage(file):
        packed = file.with_suffix(".npz")
        with np.load(packed) as stored:
            arrays = dict(stored)
        change(arrays)
        np.savez(packed, **arrays)
        document = json.loads(file.read_text())
        document["arrays_sha256"] = policy_file.digest(packed.read_bytes())
        file.write_text(json.dumps(document))

    return damage


DAMAGES = {
    "no json": (lambda f: f.write_text("\x00\x01"), "damaged"),
    "nothing but brackets": (lambda f: f.write_text("[" * 100_000), "damaged"),
    "missing": (lambda f: f.unlink(), "no such file"),
    "no arrays": (lambda f: f.with_suffix(".npz").unlink(), "no such file"),
    "cut short": (lambda f: f.with_suffix(".npz").write_bytes(f.with_suffix(".npz").read_bytes()[:90]), "sha256"),
    "other format": (edit(lambda t: t.update(format="onnx")), "format"),
    "lacks a field": (edit(lambda t: t.pop("epsilon")), "epsilon"),
    "not finite": (edit(lambda t: t["observation"][3].update(mean=float("inf"))), "mean"),
    "foreign environment": (edit(lambda t: t.update(env_id="CartPole-v1")), "CartPole-v1"),
    "other observations": (edit(lambda t: t["environment"].update(history=2)), "entries"),
    "other environment": (edit(lambda t: t.update(env_id="edmsim/Corner-v3")), "entries"),
    "other argument": (edit(lambda t: t["environment"].update(colour="red")), "colour"),
    "other actions": (edit(lambda t: t["action"].append("more")), "commands feed"),
    "other layers": (edit(lambda t: t.update(widths=[9])), "weight_0"),
    "lost layer": (edit(lambda t: t.update(widths=[8, 8])), "damaged"),
    "nan weights": (replace_arrays(lambda a: a["weight_0"].fill(np.nan)), "finite"),
    "pickle": (replace_arrays(lambda a: a.update(weight_0=np.array([{}], object))), "damaged"),
}


@pytest.mark.parametrize(("damage", "named"), DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_policy_is_refused_in_one_line(make_policy, damage, named):
    file = make_policy("GapFeed")
    damage(file)
    with pytest.raises(InputError) as refused:
        make_controller(f"policy:{file}")
    assert named in str(refused.value)
    assert str(refused.value).count("\n") == 0
    assert file.stem in str(refused.value)


def test_a_policy_of_another_environment_is_refused_where_one_is_named(make_policy):
    file = make_policy("GapFeed")
    assert policy_file.load(str(file), "edmsim/GapFeed-v2").card.env_id == "edmsim/GapFeed-v2"
    with pytest.raises(InputError, match="trained in edmsim/GapFeed-v2, not in edmsim/Corner-v3"):
        policy_file.load(str(file), "edmsim/Corner-v3")


def test_an_unknown_name_tells_those_there_are():
    with pytest.raises(InputError, match=r"no policy 'genius'; give its \.json file, or one of .*GapFeed-ppo"):
        make_controller("policy:genius")


def test_it_wants_the_set_up_before_it_begins(make_policy):
    with pytest.raises(InputError, match="set_up"):
        make_controller(f"policy:{make_policy('GapFeed')}").reset(33.0)


def test_either_file_names_the_policy(make_policy, tmp_path):
    file = make_policy("GapFeed")
    shutil.copy(file, tmp_path / "same.json")
    assert policy_file.locate(str(file.with_suffix(".npz"))) == file


def test_a_cut_with_other_dials_than_those_of_the_training_says_so():
    controller = make_controller("policy:GapFeed-ppo")
    assert controller.beyond_training(edmsim.Machine.load(height_mm=20)) == []
    (notice,) = controller.beyond_training(edmsim.Machine.load(height_mm=20, flushing_lower_Pa=35e3))
    assert notice.startswith("the pressure of the lower nozzle is 0.35 bar, but the policy was trained at 0.3 bar")


@pytest.mark.slow
def test_a_report_has_the_notices_of_its_policy(tmp_path):
    settings = {"controller": "policy:GapFeed-ppo", "resolution": "fast", "max_time_s": 0.5}
    result = edmsim.cut(ROOT / "examples/punch.ngc", wire="brass-200", **settings)
    assert any(text.startswith("the diameter of the wire is 200 um, but") for text in result.report["notices"])


@pytest.mark.parametrize(("clip", "limited"), [(10.0, 10.0), (1e9, 30.0)])
def test_a_written_policy_limits_its_input_as_its_training_did(tmp_path, clip, limited):
    count = len(make_family("GapFeed").entries())
    policy = policy_file.write_policy(
        tmp_path / "own.json", env_id="edmsim/GapFeed-v2", environment={}, mean=np.zeros(count),
        variance=np.ones(count), lstm=None, weights=[np.full((count, 1), 0.01)], biases=[np.zeros(1)],
        algorithm="own", command="none", seed=0, steps=0, clip=clip,
    )  # fmt: skip
    assert policy.action(np.eye(count)[0] * 30.0)[0] == pytest.approx(0.01 * limited)
