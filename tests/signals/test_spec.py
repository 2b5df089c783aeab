"""Profiles as the TOML of a scenario writes them."""

import math
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.signals import (
    Chirp,
    Constant,
    Profile,
    ProfileError,
    Sine,
    Square,
    Table,
    Telegraph,
    profile,
)

from .strategies import terms

SYSTEM_60 = """
"theta[1]" = [{constant = -3.0}, {sine = {amplitude = 0.6, omega = 0.4}},
              {square = {amplitude = 0.4, period = 1.3}}]
"theta[2]" = [{constant = 2}, {sine = {amplitude = 0.6, omega = 0.25, phase = 1.5707963267948966}},
              {sine = {amplitude = 0.4, omega = 20}}]
"""


def test_system_60_from_toml():
    spec = tomllib.loads(SYSTEM_60)
    assert Profile.from_spec(spec["theta[1]"]) == profile(-3, Sine(0.6, 0.4), Square(0.4, 1.3))
    assert Profile.from_spec(spec["theta[2]"]) == profile(
        2, Sine(0.6, 0.25, math.pi / 2), Sine(0.4, 20)
    )


def test_every_kind_of_term(tmp_path):
    (tmp_path / "wind.csv").write_text("0,1\n1,2\n")
    spec = [
        {"chirp": {"amplitude": 1, "omega_start": 1, "omega_end": 20, "duration": 10}},
        {"telegraph": {"amplitude": 0.5, "rate": 2.0, "seed": 7}},
        {"table": {"file": "wind.csv", "linear": True}},
        {"table": {"times": [0, 1], "values": [2, 3]}},
    ]
    assert Profile.from_spec(spec, base=str(tmp_path)).terms == (
        Chirp(1.0, 1.0, 20.0, 10.0, 0.0),
        Telegraph(0.5, 2.0, 7),
        Table([0.0, 1.0], [1.0, 2.0], True, str(tmp_path / "wind.csv")),
        Table([0.0, 1.0], [2.0, 3.0]),
    )


def test_a_number_alone_is_a_constant():
    assert Profile.from_spec(2) == profile(2.0) == Profile((Constant(2.0),))
    assert Profile.from_spec([]) == Profile()


@given(st.lists(terms, max_size=5).map(Profile))
def test_spec_round_trip(signal):
    assert Profile.from_spec(signal.to_spec()) == signal


def test_spec_round_trip_of_a_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("0,1\n")
    signal = profile(Table.from_csv(path, linear=True))
    assert signal.to_spec() == [{"table": {"file": str(path), "linear": True}}]
    assert Profile.from_spec(signal.to_spec()) == signal


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("x", "theta = 'x': must be a finite number or a list of terms, such as [{constant"),
        (math.nan, "theta = nan: must be a finite number or a list of terms"),
        (True, "theta = true: must be a finite number or a list of terms"),
        ([1.0], "theta[1] = 1.0: must be one term, such as {constant = -3.0}; terms: constant"),
        ([{}], "theta[1] = {}: must be one term"),
        ([{"constant": 1, "sine": {}}], "theta[1] = {'constant': 1, 'sine': {}}: must be one term"),
        ([{"constant": 1}, {"sin": {}}], "theta[2].sin: unknown key; did you mean 'sine'?"),
        ([{"zzz": {}}], "theta[1].zzz: unknown key; valid: constant, sine, square, chirp, tele"),
        ([{"constant": "a"}], "theta[1].constant = 'a': must be a finite number"),
        ([{"constant": math.inf}], "theta[1].constant = inf: must be a finite number"),
        ([{"constant": 10**400}], "theta[1].constant = 10000"),
        ([{"sine": 1.0}], "theta[1].sine = 1.0: must be a table of amplitude, omega, phase"),
        ([{"table": 1.0}], "theta[1].table = 1.0: must be a table of file, linear"),
        (
            [{"sine": {"amplitud": 1, "omega": 1}}],
            "theta[1].sine.amplitud: unknown key; did you mean 'amplitude'?",
        ),
        ([{"sine": {"amplitude": 1}}], "theta[1].sine.omega: missing; angular frequency"),
        (
            [{"sine": {"amplitude": True, "omega": 1}}],
            "theta[1].sine.amplitude = true: must be a finite number",
        ),
        (
            [{"square": {"amplitude": 1, "period": 0}}],
            "theta[1].square.period = 0: must be a finite number above 0",
        ),
        (
            [{"square": {"amplitude": 1, "period": -1.0}}],
            "theta[1].square.period = -1.0: must be a finite number above 0",
        ),
        (
            [{"chirp": {"amplitude": 1, "omega_start": 1, "omega_end": 2, "duration": math.nan}}],
            "theta[1].chirp.duration = nan: must be a finite number above 0",
        ),
        (
            [{"telegraph": {"amplitude": 1, "rate": 0.0, "seed": 1}}],
            "theta[1].telegraph.rate = 0.0: must be a finite number above 0",
        ),
        (
            [{"telegraph": {"amplitude": 1, "rate": 1.0, "seed": -1}}],
            "theta[1].telegraph.seed = -1: must be an integer from 0 to 2147483647",
        ),
        (
            [{"telegraph": {"amplitude": 1, "rate": 1.0, "seed": 1.5}}],
            "theta[1].telegraph.seed = 1.5: must be an integer from 0 to 2147483647",
        ),
        ([{"table": {}}], "theta[1].table: give either file, or times and values"),
        (
            [{"table": {"file": "a", "times": [1]}}],
            "theta[1].table: give either file, or times and values",
        ),
        ([{"table": {"files": "a"}}], "theta[1].table.files: unknown key; did you mean 'file'?"),
        ([{"table": {"file": 3}}], "theta[1].table.file = 3: must be the name of a CSV file"),
        (
            [{"table": {"file": "absent.csv"}}],
            "theta[1].table.file: table file 'absent.csv': No such file or directory",
        ),
        (
            [{"table": {"times": [1, 0], "values": [1, 1]}}],
            "theta[1].table.times[2]: time 0.0 does not come after 1.0",
        ),
        (
            [{"table": {"times": [1], "values": [1], "linear": "no"}}],
            "theta[1].table.linear = 'no': must be true or false",
        ),
        ([{"table": {"times": [1]}}], "theta[1].table.values = (): must be a list"),
        (
            [{"constant": 1.5e308}] * 2,
            "(Constant(value=1.5e+308), Constant(value=1.5e+308)): the sum must be",
        ),
    ],
)
def test_errors_name_the_path_the_value_and_what_is_valid(spec, message):
    with pytest.raises(ProfileError) as caught:
        Profile.from_spec(spec, where="theta")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sine(math.nan, 1.0), "sine.amplitude = nan: must be a finite number"),
        (lambda: Square(1.0, 0.0), "square.period = 0.0: must be a finite number above 0"),
        (lambda: Telegraph(1.0, 1.0, True), "telegraph.seed = true: must be an integer"),
        (lambda: Constant("1"), "constant.value = '1': must be a finite number"),
        (lambda: Profile((1.0,)), "1.0: must be one of constant, sine, square"),
    ],
)
def test_constructors_check_too(make, message):
    with pytest.raises(ProfileError) as caught:
        make()
    assert str(caught.value).startswith(message)
