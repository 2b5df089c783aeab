"""Jumps: exact times, one-sided limits, and stepping from event to event."""

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from congelation.signals import (
    Chirp,
    Profile,
    ProfileError,
    Sine,
    Square,
    Table,
    Telegraph,
    profile,
)
from congelation.signals.profiles import COINCIDENT

from .strategies import amplitude, period, phase, squares, terms, time

profiles = st.lists(terms, max_size=4).map(Profile)


def events(signal, start, stop, limit=10_000):
    """The events in (start, stop], found by going from end to end."""
    found = []
    t = signal.next_event(start)
    while t <= stop:
        found.append(t)
        assert len(found) <= limit, "stepping from event to event does not advance"
        t = signal.segment(t).end
    return found


@given(amplitude, period, phase, st.integers(-10_000, 10_000))
def test_square_jumps_exactly_at_its_index(a, period, phase, k):
    wave = profile(Square(a, period, phase))
    jump = (k - phase / math.pi) * period / 2
    before = wave.segment(math.nextafter(jump, -math.inf))
    after = wave.segment(jump)
    value = a if k % 2 == 0 else -a
    assert before.end == jump == after.start
    assert (before.value(jump), wave.value(jump)) == (-value, value)
    assert after.end == (k + 1 - phase / math.pi) * period / 2
    assert wave.next_event(math.nextafter(jump, -math.inf)) == jump


@given(squares, time)
def test_square_equals_its_formula_away_from_jumps(square, t):
    s = math.sin(2 * math.pi * t / square.period + square.phase)
    assume(abs(s) > 1e-9)
    assert profile(square).value(t) == math.copysign(1.0, s) * square.amplitude


def test_square_has_the_jumps_of_the_paper_system():
    wave = profile(Square(0.4, 1.3))
    assert events(wave, 0.0, 10.0) == [k * 1.3 / 2 for k in range(1, 16)]
    assert wave.value(0.0) == 0.4


@given(profiles, time)
def test_segment_covers_the_time_asked_for(signal, t):
    segment = signal.segment(t)
    assert segment.start <= t < segment.end
    assert signal.next_event(t) == segment.end
    assert signal.value(t) == segment.value(t)
    assert signal.derivative(t) == segment.derivative(t)


@given(profiles, st.floats(-50.0, 50.0))
def test_segments_follow_one_another(signal, t):
    for _ in range(20):
        segment = signal.segment(t)
        if segment.end == math.inf:
            break
        following = signal.segment(segment.end)
        assert following.start == segment.end
        assert following.end - following.start > COINCIDENT
        inside = following.start + min(1.0, (following.end - following.start)) / 2
        again = signal.segment(inside)
        assert again.end == following.end
        assert math.isclose(
            again.value(inside), following.value(inside), rel_tol=1e-9, abs_tol=1e-9
        )
        t = segment.end


@given(st.lists(terms, min_size=1, max_size=4), st.floats(-20.0, 20.0))
def test_events_of_a_sum_are_the_union(summands, t):
    union = {e for term in summands for e in events(profile(term), t, t + 10.0)}
    listed = sorted(union)
    assume(all(b - a > 1e-9 for a, b in pairwise([t, *listed])))
    assert events(Profile(tuple(summands)), t, t + 10.0) == listed


@given(st.lists(terms, max_size=4), time)
def test_a_sum_is_the_sum(summands, t):
    parts = [profile(term) for term in summands]
    near = [e for p in parts for e in (p.segment(t).start, p.segment(t).end)]
    assume(all(abs(e - t) > 1e-9 for e in near))
    whole = Profile(tuple(summands))
    value = math.fsum(p.value(t) for p in parts)
    slope = math.fsum(p.derivative(t) for p in parts)
    assert math.isclose(whole.value(t), value, rel_tol=1e-9, abs_tol=1e-9)
    assert math.isclose(whole.derivative(t), slope, rel_tol=1e-9, abs_tol=1e-9)


def test_nearly_coincident_jumps_happen_together():
    late = 1e-14
    square, other = Square(1.0, 2.0), Square(10.0, 2.0, -late * math.pi)
    first, second = square.jump(1), other.jump(1)
    assert 0.0 < second - first < COINCIDENT
    wave = profile(square, other)
    assert wave.value(0.5) == 11.0
    assert wave.segment(0.5).end == first
    assert wave.segment(0.5).value(first) == 11.0
    assert wave.value(first) == -11.0
    assert wave.segment(first).end == pytest.approx(2.0)
    assert len(events(wave, 0.5, 10.5)) == 10


@pytest.mark.parametrize("t", [0.0, 1.0, -7.0, 1000.0])
def test_jumps_that_rounding_would_swallow_do_not_stop_the_clock(t):
    hasty = profile(Square(1.0, 1e-12), Square(1.0, 1.1e-12), Sine(1.0, 1.0))
    for _ in range(100):
        segment = hasty.segment(t)
        assert segment.end >= segment.start + COINCIDENT * max(1.0, abs(t)) / 2
        assert segment.end > t
        t = segment.end


@pytest.mark.parametrize("square", [Square(1.0, 1e-12), Square(1.0, 1.0, -1e19)])
def test_jumps_that_cannot_be_told_apart_are_refused(square):
    with pytest.raises(ProfileError, match=r"square\.period = .* near t = 1000000\.0 are too"):
        square.segment(1e6)


def test_smooth_profiles_have_no_events():
    smooth = profile(1.0, Sine(1.0, 2.0), Chirp(1.0, 2.0, 2.0, 5.0))
    assert smooth.next_event(0.0) == math.inf
    assert smooth.segment(-5.0) is smooth.segment(5.0)
    assert Profile().segment(1.0).value(1.0) == 0.0


@pytest.mark.parametrize("t", [math.nan, math.inf, -math.inf])
def test_time_must_be_finite(t):
    for signal in (profile(1.0), profile(Square(1.0, 1.0)), profile(Telegraph(1.0, 1.0, 1))):
        with pytest.raises(ProfileError, match=r"t = .*: must be a finite number"):
            signal.segment(t)


def test_steps_of_a_simulation_hit_every_event_once():
    signal = profile(Square(0.4, 1.3), Telegraph(0.1, 3.0, 11), Table([1.0, 2.6], [0.0, 1.0], True))
    expected = events(signal, 0.0, 10.0)
    stops, t, k = [], 0.0, 0
    while k < 10_000:
        k += 1
        while t < k * 1e-3:
            end = signal.segment(t).end
            if end <= k * 1e-3:
                stops.append(end)
            t = min(end, k * 1e-3)
    assert stops == expected
