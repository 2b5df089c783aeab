"""Values, derivatives and bounds against the formulas written out."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from congelation.signals import Chirp, Profile, Sine, Square, box_radius, profile

from .strategies import chirps, terms, time


def paper_profiles():
    """Our profile for system (60)."""
    theta_1 = profile(-3.0, Sine(0.6, 0.4), Square(0.4, 1.3))
    theta_2 = profile(2.0, Sine(0.6, 0.25, math.pi / 2), Sine(0.4, 20.0))
    return theta_1, theta_2


@given(st.floats(0.0, 100.0))
def test_profiles_of_system_60(t):
    theta_1, theta_2 = paper_profiles()
    s = math.sin(2 * math.pi * t / 1.3)
    assume(abs(s) > 1e-9)
    expected = -3 + 0.6 * math.sin(0.4 * t) + 0.4 * math.copysign(1, s)
    assert theta_1.value(t) == pytest.approx(expected, abs=1e-13)
    expected = 2 + 0.6 * math.cos(0.25 * t) + 0.4 * math.sin(20 * t)
    assert theta_2.value(t) == pytest.approx(expected, abs=1e-13)


def test_box_of_system_60():
    theta_1, theta_2 = paper_profiles()
    assert theta_1.bounds() == (-4.0, -2.0)
    assert theta_2.bounds() == (1.0, 3.0)
    assert (theta_1.radius, theta_2.radius) == (1.0, 1.0)
    assert box_radius([theta_1, theta_2]) == math.sqrt(2.0)
    assert box_radius([]) == 0.0


@given(chirps, time)
def test_chirp_equals_the_integral_of_its_frequency(chirp, t):
    w0, w1, duration = chirp.omega_start, chirp.omega_end, chirp.duration
    swept = min(max(t, 0.0), duration)
    angle = chirp.phase + w0 * min(t, 0.0) + w1 * max(t - duration, 0.0)
    angle += w0 * swept + (w1 - w0) * swept**2 / (2 * duration)
    frequency = w0 + (w1 - w0) * swept / duration
    signal = profile(chirp)
    assert signal.value(t) == pytest.approx(chirp.amplitude * math.sin(angle), abs=1e-8)
    slope = chirp.amplitude * frequency * math.cos(angle)
    assert signal.derivative(t) == pytest.approx(slope, abs=1e-7)


@given(chirps)
def test_chirp_is_continuous_with_its_derivative_at_both_ends(chirp):
    assume(chirp.omega_start != chirp.omega_end)
    signal = profile(chirp)
    before = signal.segment(-1.0)
    sweep = signal.segment(0.0)
    after = signal.segment(chirp.duration)
    assert (before.end, sweep.end, after.end) == (0.0, chirp.duration, math.inf)
    for left, right in ((before, sweep), (sweep, after)):
        assert left.value(left.end) == pytest.approx(right.value(left.end), abs=1e-10)
        assert left.derivative(left.end) == pytest.approx(right.derivative(left.end), abs=1e-9)


@given(st.lists(terms, max_size=4).map(Profile), st.floats(-30.0, 30.0))
def test_derivative_is_the_limit_of_differences(signal, t):
    segment = signal.segment(t)
    h = 1e-5
    difference = (segment.value(t + h) - segment.value(t - h)) / (2 * h)
    # Error of a central difference: h²/6 |f'''|, at most 4 terms of amplitude 10, frequency < 20.
    assert segment.derivative(t) == pytest.approx(difference, abs=1e-4)


@given(st.lists(terms, max_size=4).map(Profile), st.lists(time, min_size=1, max_size=20))
def test_values_stay_within_the_bounds(signal, times):
    low, high = signal.bounds()
    assert signal.radius == pytest.approx((high - low) / 2)
    for t in times:
        assert low - 1e-9 <= signal.value(t) <= high + 1e-9


def test_bounds_are_reached():
    signal = profile(1.0, Sine(-2.0, 3.0), Chirp(0.5, 1.0, 1.0, 1.0))
    low, high = signal.bounds()
    values = [signal.value(k * 1e-3) for k in range(100_000)]
    assert min(values) == pytest.approx(low, abs=2e-2)
    assert max(values) == pytest.approx(high, abs=2e-2)
    assert profile(Sine(2.0, 0.0, math.pi / 2)).bounds() == (2.0, 2.0)


def test_segment_offers_its_formula():
    segment = profile(-3.0, Sine(0.6, 0.4), Square(0.4, 1.3)).segment(0.1)
    assert segment.held == pytest.approx(-2.6)
    assert segment.smooth == ((0.6, 0.4, 0.0),)
    t = 0.3
    value = segment.held + sum(a * math.sin(w * t + p) for a, w, p in segment.smooth)
    assert segment.value(t) == value
    assert (segment.slope, segment.chirps) == (0.0, ())
