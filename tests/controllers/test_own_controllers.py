"""Feed controllers that a user writes: from a file or as an object, checked, cut with, compared."""

import json
import math
import re
import sys
from typing import ClassVar

import numpy as np
import pytest

import edmsim
from edmsim import controllers
from edmsim.controllers import FeedCommand, check_controller, from_text
from edmsim.controllers.protocols import check_command, set_up_controller
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.job.cut import CHECKPOINT
from edmsim.job.plan import make_controller
from edmsim.machine.machine import Machine

LAW = '''\
from dataclasses import dataclass
from typing import ClassVar

from edmsim.controllers import FeedCommand


@dataclass
class Half:
    """Half of what the machine can run, less with every short."""

    name: ClassVar[str] = "half"
    share: float = 0.5

    def reset(self, max_feed_um_s):
        self.most = max_feed_um_s
        return FeedCommand(self.share * self.most)

    def update(self, window):
        return FeedCommand(self.share * self.most * (1 - window.short / 255))

    def snapshot(self):
        return {"most": self.most}

    def restore(self, state):
        self.most = state["most"]


class Bare:
    name = "bare"

    def reset(self, max_feed_um_s):
        return FeedCommand(1.0)
'''


class Law:
    """Half of the largest feed; what tests change makes it wrong."""

    name: ClassVar[str] = "law"

    def reset(self, max_feed_um_s):
        self.most = max_feed_um_s
        return FeedCommand(0.5 * self.most)

    def update(self, window):
        return FeedCommand(0.5 * self.most)

    def snapshot(self):
        return {"most": self.most}

    def restore(self, state):
        self.most = state["most"]


class Counting(Law):
    windows = 0

    def update(self, window):
        self.windows += 1
        return FeedCommand(0.1 * (self.windows % 7))


class Restless(Law):
    made = 0

    def __init__(self):
        type(self).made += 1

    def update(self, window):
        return FeedCommand(0.1 * self.made)


def wrong(**methods):
    """Return the law with one of its methods changed."""
    return type("Wrong", (Law,), methods)


Delayed = wrong(update=lambda self, window: FeedCommand(window.mean_delay_us))
Lost = wrong(update=lambda self, window: FeedCommand(math.nan))
Fast = wrong(update=lambda self, window: FeedCommand(50.0))
Number = wrong(update=lambda self, window: 5.0)
Text = wrong(update=lambda self, window: FeedCommand("5"))
Never = wrong(update=lambda self, window: FeedCommand(5.0, latency_s=math.nan))
Early = wrong(update=lambda self, window: FeedCommand(5.0, latency_s=-1.0))
Overtaken = wrong(update=lambda self, window: FeedCommand(5.0, latency_s=0.1))
Unset = wrong(update=lambda self, window: FeedCommand(5.0, t_on_us=math.nan))
Spelt = wrong(update=lambda self, window: FeedCommand(5.0, t_period_us="90"))
Coded = wrong(update=lambda self, window: FeedCommand(5.0, 5))
Silent = wrong(update=lambda self, window: FeedCommand(5.0, " "))
Torn = wrong(update=lambda self, window: FeedCommand(5.0, "jam \ud800"))
Endless = wrong(update=lambda self, window: FeedCommand(5.0, latency_s=1e300))
Far = wrong(update=lambda self, window: FeedCommand(5.0, offset_um=-1e300))
Boxed = wrong(update=lambda self, window: FeedCommand(np.array([5.0])))
Stateless = wrong(snapshot=lambda self: None)
Unwritable = wrong(snapshot=lambda self: {"most": {1.0}})


class Forgetful(Counting):
    def reset(self, max_feed_um_s):
        self.windows = 0
        return super().reset(max_feed_um_s)


class Untimed(Law):
    """Acts after some windows of shorts in a row, which it counts, but leaves out of its snapshot."""

    def __init__(self, patience, command):
        self.patience, self.command = patience, command

    def reset(self, max_feed_um_s):
        self.shorted = 0
        return super().reset(max_feed_um_s)

    def update(self, window):
        self.shorted = self.shorted + 1 if window.short > 127 else 0
        return self.command if self.shorted > self.patience else super().update(window)


def assert_same(one, other):
    np.testing.assert_equal(one.windows.to_pydict(), other.windows.to_pydict())  # NaN equals NaN there


@pytest.fixture
def law(tmp_path):
    file = tmp_path / "law.py"
    file.write_text(LAW, encoding="utf-8")
    return file


@pytest.mark.slow
@pytest.mark.parametrize("name", controllers.names())
def test_every_controller_of_ours_conforms(name):
    check_controller(lambda: controllers.make(name))


@pytest.mark.slow
def test_a_policy_conforms_and_so_may_an_own_one():
    check_controller(lambda: from_text("policy:GapFeed-ppo"))
    check_controller(Law)


@pytest.mark.parametrize(("kind", "message"), [
    (Counting, "remembers something across reset"), (Restless, "made again"), (Delayed, "feed of nan um/s"),
    (Fast, "50 um/s where the machine runs 33.3375"), (Number, "answered 5.0: it must return a FeedCommand"),
    (Forgetful, "does not go on from its snapshot"), (Unwritable, "snapshot that JSON cannot hold"),
    (Text, "a feed of '5' um/s"), (Never, "calculation time of nan s"), (Early, "calculation time of -1.0 s"),
    (Overtaken, "never changes its feed: each is 0.1 s late, and replaced before"),
    (Unset, "on-time nan us; None keeps"), (Spelt, "period '90' us"),
    (Coded, "the alarm 5: give the reason in words"), (Silent, "the alarm ' ': give the reason in words"),
    (Torn, "on one line"), (Endless, "time of 1e[+]300 s: give 0 to 3600"), (Far, "offset of -1e[+]300 um: give -1e"),
    (Boxed, r"a feed of array\(\[5.\]\) um/s"), (Stateless, "has the snapshot None: return its state"),
    (object, "is not a feed controller: it has no name, reset, update, snapshot, restore"),
])  # fmt: skip
def test_what_does_not_conform_is_refused(kind, message):
    with pytest.raises(InputError, match=message):
        check_controller(kind)


@pytest.mark.slow
@pytest.mark.parametrize(("patience", "command", "differ"), [
    (5, FeedCommand(-1.0), r"\d+ it commands feed_um_s 16.66875, not -1.0"),
    (780, FeedCommand(0.0, "short"), r"\d+ it commands feed_um_s 16.66875, not 0.0, alarm None, not 'short'"),
])  # fmt: skip
def test_a_timer_that_is_not_in_the_snapshot_is_noticed(patience, command, differ):
    with pytest.raises(InputError, match=f"its snapshot .*: resumed before every window, after {differ}$"):
        check_controller(lambda: Untimed(patience, command))


@pytest.mark.parametrize("number", [np.float32, np.array, np.int64])
def test_a_command_of_numpy_is_taken_in_pythons_numbers(number):
    command = check_command("law", FeedCommand(number(5), None, number(2), None, number(0), number(1)))
    assert command == FeedCommand(5, None, 2, None, 0, 1)
    assert all(type(value) in (int, float) for value in command if value is not None)


def test_a_controller_cannot_change_the_path_that_it_is_shown():
    points_um = np.array([[0.0, 0.0], [9.0, 0.0]])

    def set_up(self, machine, points_um, start_um):
        points_um[:] = 7.0

    set_up_controller(wrong(set_up=set_up)(), Machine.load(), points_um, 0.0)
    assert points_um.max() == 9.0


@pytest.mark.slow
def test_an_own_class_is_named_by_its_file(law, small_punch, tmp_path):
    check_controller(lambda: from_text(f"{law}:Half"))
    made = [f"{law}:Half:share=0.25", from_text(f"{law}:Half:share=0.25")]
    results = [edmsim.cut(small_punch, height_mm=5, resolution="fast", max_time_s=1, controller=c) for c in made]
    assert_same(*results)
    settings = [result.report["settings"] for result in results]
    assert [s["controller"] for s in settings] == [made[0], "half:share=0.25"]
    assert "controller_sha256" in settings[0]


def test_an_object_of_ours_cuts_as_its_name_does(small_punch):
    def cut(controller):
        return edmsim.cut(small_punch, height_mm=5, resolution="fast", max_time_s=1, controller=controller)

    named, as_object = cut("fixed:feed_um_s=11.0,offset_um=0.0"), cut(controllers.make("fixed", feed_um_s=11.0))
    assert_same(named, as_object)
    assert named.report["settings"] == as_object.report["settings"]


@pytest.mark.parametrize(("rest", "message"), [
    ("", r"law.py: name the feed controller in this file, .*law.py:CLASS; there are: Half"),
    (":", "there are: Half"), (":Whole", "no feed controller 'Whole'; there are: Half"),
    (":Bare", "Bare is not a feed controller: it has no update, snapshot, restore"),
    (":Half:gain=2", "Half has no parameter 'gain'; it has share"), (":Half:share", "must read name=number"),
])  # fmt: skip
def test_what_a_file_does_not_have_is_refused(law, rest, message):
    with pytest.raises(InputError, match=message):
        from_text(f"{law}{rest}")


@pytest.mark.parametrize(("text", "message"), [
    ("def law(:", r"law.py:1: is not Python: invalid syntax"), ("x = 1\ny = x / 0\n", r"law.py:2: .*ZeroDivision"),
    ("class Half:\n    name = reset = update = snapshot = restore = ''\n    def __init__(self): 1 / 0\n",
     r"law.py:3: Half cannot be made: ZeroDivisionError"),
    ("import sys\nsys.exit(0)\n", r"law.py:2: fails when it is run: SystemExit: 0"),
    ("import lathe_of_nobody", r"law.py:1: fails when it is run: ModuleNotFoundError"), ("", "the file has no class"),
])  # fmt: skip
def test_a_file_that_cannot_be_run_is_one_line(law, text, message):
    law.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        from_text(f"{law}:Half")
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"none\.py: no such file"):
        from_text(f"{law.parent / 'none.py'}:Half")


@pytest.mark.parametrize("module", ["shares_of_ours.py", "shares_in_package/__init__.py"])
def test_a_file_imports_what_lies_in_its_folder_and_nothing_from_elsewhere(module, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    name = re.split(r"[./]", module)[0]
    for folder, share in (("one", 0.25), ("two", 0.75)):
        (tmp_path / folder / module).parent.mkdir(parents=True)
        (tmp_path / folder / module).write_text(f"SHARE = {share}\n")
        (tmp_path / folder / "law.py").write_text(f"from {name} import SHARE\n{LAW}".replace("0.5", "SHARE"))
    assert from_text(f"{tmp_path / 'one' / 'law.py'}:Half").share == 0.25
    with pytest.raises(InputError, match=rf"{name} was imported from .*one.*rename one of them"):
        from_text(f"{tmp_path / 'two' / 'law.py'}:Half")


def test_an_error_in_a_method_is_one_line_with_the_users_frames(law):
    law.write_text(LAW.replace("(1 - window.short / 255)", "rest(window)") + """

def rest(window):
    return 1 / (255 - window)
""")
    controller = from_text(f"{law}:Half")
    assert controller == from_text(f"{law}:Half")
    controller.reset(30.0)
    with pytest.raises(InputError) as error:
        controller.update(255)
    assert str(error.value) == (
        f"{law}:36: Half.update fails: ZeroDivisionError: division by zero; rest was called at line 19 in update"
    )
    with pytest.raises(InputError, match=r"law.py:25: Half.restore fails: KeyError: 'most'$"):
        controller.restore({})


@pytest.mark.slow
def test_a_changed_file_is_run_again_and_a_resumed_cut_notices(law, small_punch, tmp_path):
    out = tmp_path / "out"
    options = {"height_mm": 5, "resolution": "fast", "max_time_s": 1, "out": out,
                               "controller": f"{law}:Half"}  # fmt: skip

    def interrupted(progress):
        if progress.time_s > 0.2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        edmsim.cut(small_punch, watch=interrupted, **options)
    assert (out / CHECKPOINT).exists()
    law.write_text(LAW.replace("share: float = 0.5", "share: float = 0.4"))
    assert from_text(f"{law}:Half").share == 0.4  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=r"controller .*law\.py:Half: not as in the interrupted cut"):
        edmsim.cut(small_punch, **options, resume=True)
    law.write_text(LAW)
    resumed = edmsim.cut(small_punch, **options, resume=True)
    whole = edmsim.cut(small_punch, **{**options, "out": None})
    assert_same(resumed, whole)


@pytest.mark.slow
def test_a_cut_tells_of_feeds_that_came_too_late(small_punch):
    def update(self, window):
        self.most = -self.most
        return FeedCommand(self.most, latency_s=0.1)

    options = {"height_mm": 5, "resolution": "fast", "max_time_s": 0.2}
    late = edmsim.cut(small_punch, controller=wrong(update=update)(), **options)
    (notice,) = [text for text in late.report["notices"] if "latency" in text]
    assert notice.startswith("7 feeds of the controller had no effect: the next one came before")
    prompt = edmsim.cut(small_punch, controller=Law(), **options)
    assert not any("latency" in text for text in prompt.report["notices"])


def test_something_else_in_place_of_a_controller_is_refused():
    with pytest.raises(InputError, match=r"Law is a class: give an object of it, Law\(\)"):
        make_controller(Law)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="3 is not a feed controller"):
        make_controller(3)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_wrong_command_ends_cut_and_episode_in_one_line(law, small_punch):
    law.write_text(LAW.replace("window.short / 255", "float('nan')"))
    for controller, file in ((Lost(), ""), (f"{law}:Half", f"{law}: ")):
        with pytest.raises(InputError, match=f"^{re.escape(file)}the .* controller commanded a feed of nan"):
            edmsim.cut(small_punch, height_mm=5, resolution="fast", max_time_s=5, controller=controller)
    with pytest.raises(InputError, match="must return a FeedCommand"):
        Episode(edmsim.envs.Task("GapFeed", resolution="fast"), Number(), 1, "own").run()


@pytest.mark.slow
@pytest.mark.usefixtures("short_episodes")
def test_the_command_line_takes_an_own_controller(law, small_punch, tmp_path, edmsim):
    cut = ("cut", small_punch, "--height", 5, "--resolution", "fast", "--max-time", 0.5, "--quiet", "--out", tmp_path)
    assert edmsim(*cut, "--controller", f"{law}:Half:share=0.3") == (3, "", "")
    status, out, err = edmsim(*cut, "--controller", f"{law}:Whole")
    assert (status, out, err.count("\n")) == (2, "", 1)
    status, out, _ = edmsim("evaluate", "edmsim/GapFeed-v2", "--controllers", f"fixed,{law}:Half", "--seeds", 2,
                            "--resolution", "fast", "--json")  # fmt: skip
    assert status == 0
    found = json.loads(out)[0]["controllers"]
    assert set(found) == {"fixed", f"{law}:Half", "oracle"}
    assert math.isfinite(found[f"{law}:Half"]["rate_mm2_min"]["value"])
