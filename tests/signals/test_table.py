"""Tables: held or linear, from lists and from CSV files."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.signals import ProfileError, Table, profile

from .strategies import tables, time


@given(tables(), time)
def test_table_equals_its_definition(table, t):
    rows = list(zip(table.times, table.values, strict=True))
    before = [row for row in rows if row[0] <= t]
    after = [row for row in rows if row[0] > t]
    if not before:
        expected = rows[0][1]
    elif table.linear and after:
        (t0, v0), (t1, v1) = before[-1], after[0]
        expected = v0 + (v1 - v0) * (t - t0) / (t1 - t0)
    else:
        expected = before[-1][1]
    assert profile(table).value(t) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(tables())
def test_times_are_events_and_limits_are_the_rows(table):
    signal = profile(table)
    t = math.nextafter(table.times[0], -math.inf)
    for k, (time_k, value_k) in enumerate(zip(table.times, table.values, strict=True)):
        assert signal.next_event(t) == time_k
        left = signal.segment(t).value(time_k)
        held_left = value_k if table.linear else table.values[max(k - 1, 0)]
        assert left == pytest.approx(held_left, abs=1e-12)
        assert signal.value(time_k) == value_k
        t = time_k
    assert signal.next_event(t) == math.inf


def test_linear_table_keeps_its_value_under_later_events():
    ramp = Table([0.0, 10.0], [0.0, 20.0], linear=True)
    steps = Table([0.0, 3.0, 7.0], [1.0, 2.0, 3.0])
    signal = profile(ramp, steps)
    segment = signal.segment(5.0)
    assert (segment.start, segment.end, segment.held, segment.slope) == (3.0, 7.0, 8.0, 2.0)
    assert segment.value(5.0) == 12.0
    assert segment.value(7.0) == 16.0
    assert signal.value(7.0) == 17.0


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize(
    "text",
    [
        "0,1\n2,-3.5\n",
        "time,value\n0,1\n2,-3.5",
        "# made by hand\n\nt [s], theta\n 0 , 1  # start\n2,-3.5e0\n\n",
        "\ufefftime,value\r\n0,1\r\n2,-3.5\r\n",
    ],
)
def test_csv(tmp_path, text, linear):
    path = tmp_path / "theta.csv"
    path.write_bytes(text.encode())
    table = Table.from_csv(path, linear)
    assert table == Table([0.0, 2.0], [1.0, -3.5], linear, str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no rows; expected two columns time,value"),
        ("time,value\n", "no rows; expected two columns time,value"),
        ("0,1\n1,x\n", "line 2: '1,x' is not time,value"),
        ("0,1,2\n", "line 1: '0,1,2' is not time,value"),
        ("time\n0,1\n", "line 1: 'time' is not time,value"),
        ("time,1\n0,1\n", "line 1: 'time,1' is not time,value"),
        ("time,value\nt,v\n0,1\n", "line 2: 't,v' is not time,value"),
        ("0,1\n1,inf\n", "line 2: '1,inf' is not time,value"),
        ("0,1\nnan,nan\n", "line 2: 'nan,nan' is not time,value"),
        ("# c\n0,1\n2,1\n\n1,1\n", "line 5: time 1.0 does not come after 2.0"),
        ("0,1\n0,2\n", "line 2: time 0.0 does not come after 0.0"),
        ("0,-1e308\n1,1e308\n", "line 2: the step from -1e+308 to 1e+308 is beyond double"),
    ],
)
def test_csv_errors_name_the_file_and_the_line(tmp_path, text, message):
    path = tmp_path / "theta.csv"
    path.write_text(text)
    with pytest.raises(ProfileError) as caught:
        Table.from_csv(path)
    assert str(caught.value).startswith(f"table file {str(path)!r}")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unreadable_files(tmp_path):
    with pytest.raises(ProfileError, match=r"table file '.*absent\.csv': No such file"):
        Table.from_csv(tmp_path / "absent.csv")
    with pytest.raises(ProfileError, match=r"table file '.*': Is a directory"):
        Table.from_csv(tmp_path)
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProfileError, match=r"b\.csv': not a text file in UTF-8"):
        Table.from_csv(tmp_path / "b.csv")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], []), "table.times = []: must be a list of at least one number"),
        (("12", [1.0]), "table.times = '12': must be a list of at least one number"),
        ((3.0, [1.0]), "table.times = 3.0: must be a list of at least one number"),
        (([0.0], [math.nan]), "table.values[1] = nan: must be a finite number"),
        (([0.0, "a"], [1.0, 2.0]), "table.times[2] = 'a': must be a finite number"),
        (([0.0, 1.0], [1.0]), "table: times has 2 entries, values 1; give one value per time"),
        (([1.0, 0.5], [1.0, 2.0]), "table.times[2]: time 0.5 does not come after 1.0"),
        (([0.0], [1.0], 1), "table.linear = 1: must be true or false"),
    ],
)
def test_table_errors(arguments, message):
    with pytest.raises(ProfileError) as caught:
        Table(*arguments)
    assert str(caught.value) == message


@given(st.integers(2, 200))
def test_long_tables_are_searched_not_walked(count):
    table = Table([float(k) for k in range(count)], [float(k % 7) for k in range(count)])
    assert profile(table).value(count - 1.5) == float((count - 2) % 7)
