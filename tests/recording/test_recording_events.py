"""Events in words: retracts, corners, threading, settings, the end; of too many, some."""

from dataclasses import replace

import numpy as np
import pytest

from edmsim.recording.rerun.write import MOST, events
from edmsim.recording.windows import WindowTable, column

from .conftest import LEAD, changed


def events_of(cut, windows, **report):
    return [tuple(event) for event in events(windows, cut.scene, replace(cut.report, **report))]


def test_begin_corners_and_end(cut):
    found = events_of(cut, cut.windows)
    assert found[0] == (0, "INFO", "begins at X -1.000 Y -1.000 mm")
    corners = [text for _, _, text in found if text.startswith("corner")]
    assert corners[0] == "corner of +90° at X 0.000 Y 0.000 mm, error -9.1 µm"
    assert len(corners) == 4
    assert found[-1] == (2999, "INFO", "finished")
    assert [row for row, *_ in found] == sorted(row for row, *_ in found)


def test_a_wire_that_leans_passes_its_corners_at_mid_height(cut):
    leaning = replace(cut.scene, lead=LEAD)
    windows = changed(cut.windows, x_um=column(cut.windows, "x_um") - 2000.0)
    upright = [event for event in events_of(cut, cut.windows) if "corner" in event[2]]
    assert [tuple(e) for e in events(windows, leaning, cut.report) if "corner" in e.text] == upright


def test_a_retract_says_how_far_and_why(cut):
    feed, path = (column(cut.windows, name).copy() for name in ("feed_um_s", "path_um"))
    feed[1000:1010] = -30.0
    path[1009] = path[999] - 25.0
    windows = changed(cut.windows, feed_um_s=feed, path_um=path)
    (retract,) = [event for event in events_of(cut, windows) if "retract" in event[2]]
    short = 100 * column(cut.windows, "short")[999] / 255
    assert retract[:2] == (1000, "WARN")
    assert f"{short:.0f} % short, 25 µm back" in retract[2]


def test_settings_and_threading(cut):
    on, t_s = (column(cut.windows, name).copy() for name in ("t_on_us", "t_s"))
    on[1500:] = 12.0
    t_s[2000:] += 60.0
    texts = {row: text for row, _, text in events_of(cut, changed(cut.windows, t_on_us=on, t_s=t_s))}
    assert texts[1500] == "generator set to 12 µs of 100 µs"
    assert texts[2000].startswith("wire threaded at X ")
    assert texts[2000].endswith("after 61 s")


@pytest.mark.parametrize(("outcome", "level", "text"), [
    ("wire-break", "CRITICAL", "wire-break: why"), ("persistent-short", "ERROR", "alarm: persistent-short: why"),
    ("limit-switch", "ERROR", "limit-switch: why"), ("time-limit", "WARN", "time-limit: why"),
])  # fmt: skip
def test_how_it_ended_has_its_weight(cut, outcome, level, text):
    assert events_of(cut, cut.windows, outcome=outcome, reason="why")[-1] == (2999, level, text)


def test_too_many_are_thinned_and_none_is_fine(cut):
    feed = np.where(np.arange(3000) % 2 == 0, 20.0, -20.0)
    windows = changed(cut.windows, feed_um_s=feed)
    retracts = [event for event in events_of(cut, windows) if "retract" in event[2]]
    assert len(retracts) == MOST
    assert events_of(cut, WindowTable().to_arrow()) == []
