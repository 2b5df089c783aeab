"""Profiles as the parameters of an FMU."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.signals import (
    Chirp,
    Constant,
    Profile,
    ProfileError,
    Sine,
    Slots,
    Square,
    Table,
    Telegraph,
    flat_parameters,
    profile,
)

from .strategies import chirps, noises, number, sines, squares, telegraphs, time

ROOMY = Slots(sines=3, squares=3, chirps=2, telegraphs=2, noises=1)


@st.composite
def in_order(draw):
    """Profiles in the order of their flat parameters, the form that survives the round trip."""
    mean = draw(number)
    terms = [Constant(mean)] if mean else []
    for strategy, most in ((sines, 3), (squares, 3), (chirps, 2), (telegraphs, 2), (noises, 1)):
        terms += draw(st.lists(strategy, max_size=most))
    return Profile(tuple(terms))


def test_names_types_and_units():
    listed = flat_parameters()
    assert [p.name for p in listed] == [
        "mean",
        *[f"sine[{k}].{n}" for k in (1, 2) for n in ("amplitude", "omega", "phase")],
        *[f"square[{k}].{n}" for k in (1, 2) for n in ("amplitude", "period", "phase")],
        *[f"chirp[1].{n}" for n in ("amplitude", "omega_start", "omega_end", "duration", "phase")],
        *[f"telegraph[1].{n}" for n in ("amplitude", "rate", "seed")],
        "table.file",
        "table.linear",
    ]
    by_name = {p.name: p for p in listed}
    assert by_name["sine[2].omega"][1:4] == ("Real", 1.0, "rad/s")
    assert by_name["square[1].period"][1:4] == ("Real", 1.0, "s")
    assert by_name["telegraph[1].rate"][1:4] == ("Real", 1.0, "1/s")
    assert by_name["telegraph[1].seed"][1:4] == ("Integer", 1, "")
    assert by_name["table.file"][1:4] == ("String", "", "")
    assert by_name["table.linear"][1:4] == ("Boolean", False, "")
    assert all(p.description for p in listed)
    python = {"Real": float, "Integer": int, "String": str, "Boolean": bool}
    assert all(type(p.default) is python[p.type] for p in listed)


def test_slots_are_followed():
    names = [p.name for p in flat_parameters(Slots(0, 1, 0, 0, False))]
    assert names == ["mean", "square[1].amplitude", "square[1].period", "square[1].phase"]
    assert "telegraph[2].seed" in [p.name for p in flat_parameters(ROOMY)]


def test_defaults_are_the_zero_profile():
    assert Profile.from_flat({p.name: p.default for p in flat_parameters(ROOMY)}) == Profile()
    assert Profile.from_flat({}) == Profile()
    assert Profile().to_flat() == {p.name: p.default for p in flat_parameters()}


@given(in_order())
def test_flat_round_trip(signal):
    flat = signal.to_flat(ROOMY)
    assert list(flat) == [p.name for p in flat_parameters(ROOMY)]
    assert Profile.from_flat(flat) == signal


@given(in_order(), st.lists(number, max_size=3), time)
def test_any_order_keeps_the_value(signal, means, t):
    shuffled = profile(*means, *reversed(signal.terms))
    again = Profile.from_flat(shuffled.to_flat(ROOMY))
    assert again.value(t) == pytest.approx(shuffled.value(t), abs=1e-9)


def test_terms_of_amplitude_zero_are_dropped():
    signal = profile(0.0, Sine(0.0, 3.0), Sine(1.0, 2.0), Square(0.0, 2.0))
    assert Profile.from_flat(signal.to_flat()) == profile(Sine(1.0, 2.0))


def test_table_round_trip(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("0,1\n1,2\n")
    signal = profile(1.0, Table.from_csv(path, linear=True))
    flat = signal.to_flat()
    assert (flat["table.file"], flat["table.linear"]) == (str(path), True)
    assert Profile.from_flat(flat) == signal
    assert Profile.from_flat({"table.file": "a.csv"}, base=str(tmp_path)).value(0.5) == 1.0


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        ({"meen": 1.0}, "meen: unknown parameter; did you mean 'mean'?"),
        (
            {"sine[2].amplitud": 1.0},
            "sine[2].amplitud: unknown parameter; did you mean 'sine[2].amplitude'?",
        ),
        ({"sine[0].omega": 1.0}, "sine[0].omega: unknown parameter; did you mean 'sine["),
        ({"constant[1].value": 1.0}, "constant[1].value: unknown parameter;"),
        ({"mean": float("nan")}, "mean = nan: must be a finite number"),
        ({"square[2].period": 0.0}, "square[2].period = 0.0: must be a finite number above 0"),
        ({"sine[1].omega": float("inf")}, "sine[1].omega = inf: must be a finite number"),
        ({"telegraph[1].seed": -5}, "telegraph[1].seed = -5: must be an integer from 0 to"),
        ({"table.linear": 1}, "table.linear = 1: must be true or false"),
        ({"table.file": 1}, "table.file = 1: must be the name of a CSV file"),
        ({"table.file": "no.csv"}, "table.file: table file 'no.csv': No such file or directory"),
    ],
)
def test_from_flat_errors(flat, message):
    with pytest.raises(ProfileError) as caught:
        Profile.from_flat(flat)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("signal", "slots", "message"),
    [
        (profile(*[Sine(1.0, k) for k in range(3)]), Slots(), "terms sine: 3 given, at most 2 fit"),
        (
            profile(Telegraph(1.0, 1.0, 1)),
            Slots(telegraphs=0),
            "terms telegraph: 1 given, at most 0",
        ),
        (
            profile(Chirp(1.0, 1.0, 2.0, 1.0)),
            Slots(chirps=0),
            "terms chirp: 1 given, at most 0 fit",
        ),
        (profile(Square(1.0, 1.0)), Slots(squares=0), "terms square: 1 given, at most 0 fit"),
        (profile(Table([0.0], [1.0])), Slots(), "table.times: give the rows in a CSV file"),
        (profile(Table([0.0], [1.0])), Slots(table=False), "terms table: 1 given, at most 0 fit"),
    ],
)
def test_to_flat_errors(signal, slots, message):
    with pytest.raises(ProfileError) as caught:
        signal.to_flat(slots)
    assert str(caught.value).startswith(message)
