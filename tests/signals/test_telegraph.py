"""The random telegraph signal: the generator, the statistics, the memory of jump times."""

import math
import pickle
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.signals import ProfileError, Telegraph, profile, splitmix64
from congelation.signals.telegraph import MAX_TELEGRAPH_JUMPS, _log


def jump_times(term, count):
    signal, t, times = profile(term), 0.0, []
    for _ in range(count):
        t = signal.next_event(t)
        times.append(t)
    return times


def test_splitmix64_gives_the_published_outputs():
    assert [splitmix64(1234567, k) for k in range(1, 6)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    assert splitmix64(0, 1) == 0xE220A8397B1DCDAF
    assert splitmix64(2**64 - 1, 3) < 2**64


@given(st.floats(2.0**-53, 1.0))
def test_logarithm_is_that_of_the_library_to_rounding(u):
    assert math.isclose(_log(u), math.log(u), rel_tol=1e-15, abs_tol=0.0)


def test_logarithm_at_the_ends():
    assert _log(1.0) == 0.0
    assert _log(2.0**-53) == pytest.approx(-53 * math.log(2.0), rel=1e-15)


def test_jump_times_follow_the_documented_recipe():
    seed, rate = 1234567, 2.5
    expected, t = [], 0.0
    for k in range(1, 6):
        u = (splitmix64(seed, k + 1) // 2**11 + 1) / 2**53
        t -= math.log(u) / rate
        expected.append(t)
    assert jump_times(Telegraph(1.0, rate, seed), 5) == pytest.approx(expected, rel=1e-14)
    positive = splitmix64(seed, 1) < 2**63
    assert profile(Telegraph(3.0, rate, seed)).value(0.0) == (3.0 if positive else -3.0)


def test_jump_times_do_not_depend_on_the_machine():
    """IEEE arithmetic alone decides, so the bits can be written down."""
    assert [t.hex() for t in jump_times(Telegraph(1.0, 1.0, 1234567), 4)] == [
        "0x1.c030fce6933f9p+0",
        "0x1.30d3ffb62b251p+1",
        "0x1.e2c86b6ed71b6p+1",
        "0x1.f1c453d95fdd5p+1",
    ]


@pytest.mark.parametrize("rate", [0.5, 4.0])
def test_holding_times_are_exponential(rate):
    times = [0.0, *jump_times(Telegraph(1.0, rate, 42), 20_000)]
    holds = [rate * (b - a) for a, b in pairwise(times)]
    # Five standard errors of each statistic of 20,000 unit exponentials.
    assert sum(holds) / len(holds) == pytest.approx(1.0, abs=5 / math.sqrt(20_000))
    mean_square = sum(h * h for h in holds) / len(holds)
    assert mean_square == pytest.approx(2.0, abs=5 * math.sqrt(20 / 20_000))
    longer = sum(h > 1.0 for h in holds) / len(holds)
    assert longer == pytest.approx(math.exp(-1), abs=5 * math.sqrt(0.24 / 20_000))


def test_first_signs_are_balanced_over_seeds():
    positive = sum(profile(Telegraph(1.0, 1.0, seed)).value(0.0) > 0 for seed in range(4000))
    assert positive == pytest.approx(2000, abs=5 * math.sqrt(1000))


@given(st.integers(0, 2**31 - 1), st.floats(0.1, 5.0), st.lists(st.floats(-5.0, 50.0)))
def test_a_seed_reproduces_whatever_was_asked_before(seed, rate, times):
    used = profile(Telegraph(1.0, rate, seed))
    for t in times:
        fresh = profile(Telegraph(1.0, rate, seed))
        assert used.segment(t) == fresh.segment(t)
    unused = profile(Telegraph(1.0, rate, seed))
    assert (used, hash(used)) == (unused, hash(unused))


def test_signs_alternate_and_hold_before_zero():
    term = Telegraph(2.0, 1.0, 5)
    signal = profile(term)
    first = signal.value(0.0)
    assert signal.value(-100.0) == first
    assert signal.segment(-100.0).start == -math.inf
    for k, t in enumerate(jump_times(term, 50), 1):
        assert signal.value(t) == first * (-1) ** k
        assert signal.value(math.nextafter(t, 0.0)) == -first * (-1) ** k


def test_seeds_differ():
    assert jump_times(Telegraph(1.0, 1.0, 1), 3) != jump_times(Telegraph(1.0, 1.0, 2), 3)


def test_memory_survives_pickling_and_is_no_part_of_the_text():
    term = Telegraph(1.0, 1.0, 3)
    profile(term).segment(100.0)
    assert pickle.loads(pickle.dumps(term)) == term
    assert repr(term) == "Telegraph(amplitude=1.0, rate=1.0, seed=3)"


def test_more_jumps_than_can_be_kept_are_refused():
    signal = profile(Telegraph(1.0, 1e9, 3))
    assert signal.next_event(0.0) < 1.0
    with pytest.raises(ProfileError, match=r"telegraph\.rate = 1000000000\.0: too many jumps"):
        signal.segment(2 * MAX_TELEGRAPH_JUMPS / 1e9)
