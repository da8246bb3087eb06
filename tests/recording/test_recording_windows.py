"""The table of windows: exact values, exact resume."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.recording.windows import (
    NAMES,
    ROW_NAMES,
    WindowTable,
    column,
    lag_along_um,
    read_windows,
    travel_direction,
    write_windows,
)

from .conftest import changed, table_of


def filled(n):
    table = WindowTable()
    for i in range(n):
        table.append([i % 200 + k / 32 for k in range(len(ROW_NAMES))])
    return table


def motion(x_um, y_um, lag):
    """A table in which only place and lag matter."""
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x_um), np.diff(y_um)))])
    return table_of(
        {"x_um": x, "y_um": y, "path_um": s, "lag_x_um": lag[0], "lag_y_um": lag[1]}
        for x, y, s in zip(x_um, y_um, path, strict=True)
    )


def test_columns_have_unit_and_meaning(cut):
    for field in cut.windows.schema:
        assert set(field.metadata) == {b"unit", b"meaning"}
        assert all(field.metadata.values())


@pytest.mark.parametrize("n", [0, 1, 4096, 4097, 9000])
def test_rows_come_back_as_appended(n):
    table = filled(n)
    rows = table.rows
    assert (len(table), rows.shape) == (n, (n, len(ROW_NAMES)))
    np.testing.assert_array_equal(rows[:, 3], [i % 200 + 3 / 32 for i in range(n)])


def test_counts_are_integers_and_values_are_exact(cut):
    for name in ("short", "open", "spark", "arc"):
        assert cut.windows.schema.field(name).type == pa.int16()
    counts = sum(column(cut.windows, name) for name in ("short", "open", "spark", "arc"))
    np.testing.assert_array_equal(counts, 255)
    np.testing.assert_array_equal(column(cut.windows, "gap_um"), cut.table.rows[:, NAMES.index("gap_um")])


def test_error_is_unknown_until_the_cut_is_measured():
    assert np.isnan(column(filled(5).to_arrow(), "error_um")).all()
    np.testing.assert_array_equal(column(filled(3).to_arrow(np.array([1.0, -2.0, 3.0])), "error_um"), [1, -2, 3])


def test_errors_of_the_wrong_length_are_refused():
    with pytest.raises(ValueError, match="shape"):
        filled(3).to_arrow(np.zeros(4))


@pytest.mark.parametrize("before", [0, 1, 5000])
def test_resuming_continues_the_same_table(before):
    whole, first, resumed = filled(6000).rows, filled(before), WindowTable()
    resumed.append([0.0] * len(ROW_NAMES))
    state = first.snapshot()
    first.append([7.0] * len(ROW_NAMES))  # a snapshot does not follow the table
    resumed.restore(state)
    for row in whole[before:]:
        resumed.append(row)
    np.testing.assert_array_equal(resumed.rows, whole)


def test_parquet_round_trip_and_equal_bytes(cut, tmp_path):
    one, two = tmp_path / "windows.parquet", tmp_path / "again.parquet"
    write_windows(cut.windows, one)
    write_windows(cut.windows, two)
    back = read_windows(one)
    assert back.schema.equals(cut.windows.schema, check_metadata=True)
    for name in NAMES:
        np.testing.assert_array_equal(column(back, name), column(cut.windows, name))
    assert one.read_bytes() == two.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.parquet", "windows.parquet"]


@pytest.mark.parametrize(("make", "reason"), [
    (lambda file: None, r"own\.parquet: no such file"),
    (lambda file: file.write_text("t_s,x_um\n0,0\n"), "not a Parquet file"),
    (lambda file: pq.write_table(pa.table({"t_s": [0.0]}), file), "column x_um is missing"),
])  # fmt: skip
def test_unreadable_tables_are_named(tmp_path, make, reason):
    make(tmp_path / "own.parquet")
    with pytest.raises(InputError, match=reason):
        read_windows(tmp_path / "own.parquet")


@pytest.mark.slow
@given(degrees=st.floats(-180, 180), size=st.floats(0.1, 50))
def test_lag_is_positive_against_the_feed_in_every_direction(degrees, size):
    angle = np.radians(degrees)
    s = np.arange(0.0, 1000.0, 1.5)
    behind = (size * np.cos(angle), size * np.sin(angle))
    x, y = np.round(s * np.cos(angle)), np.round(s * np.sin(angle))
    # Steps of 1 um over chords of 25 um and more turn the direction by at most atan(1.4 / 25).
    np.testing.assert_allclose(lag_along_um(motion(x, y, behind)), size, rtol=2e-3)
    leading = (-behind[0], -behind[1])
    np.testing.assert_allclose(lag_along_um(motion(x, y, leading)), -size, rtol=2e-3)


def test_direction_is_zero_where_nothing_moves():
    still = motion(np.full(20, 100.0), np.full(20, 50.0), (3.0, 4.0))
    np.testing.assert_array_equal(travel_direction(still), 0.0)
    np.testing.assert_array_equal(lag_along_um(still), 0.0)
    assert len(travel_direction(WindowTable().to_arrow())) == 0


def test_retracting_does_not_turn_the_direction():
    x = np.concatenate([np.arange(0, 300.0), np.arange(300.0, 280.0, -1), np.arange(280.0, 600.0)])
    table = changed(motion(x, np.zeros(len(x)), (2.0, 0.0)), path_um=x)
    np.testing.assert_allclose(lag_along_um(table), 2.0)
