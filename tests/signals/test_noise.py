"""Sampled noise: its moments, its independence, its samples."""

from __future__ import annotations

import numpy as np
import pytest

from congelation.signals import Noise, ProfileError, profile


def test_moments_and_independence_of_samples():
    """20,000 samples: mean, variance, kurtosis and neighbours, each within five standard errors."""
    noise = Noise(2.0, 0.5, 7)
    values = np.array([noise.segment(0.5 * k + 0.1).held for k in range(20_000)]) / 2.0
    error = 1.0 / np.sqrt(len(values))
    assert abs(values.mean()) < 5 * error
    assert abs(values.var() - 1.0) < 5 * error * np.sqrt(2.0)
    # The sum of twelve uniform numbers has the kurtosis 2.9; the variance of z^4 is below 96.
    assert abs((values**4).mean() - 2.9) < 5 * error * np.sqrt(96.0)
    assert abs((values[1:] * values[:-1]).mean()) < 5 * error
    other = Noise(2.0, 0.5, 8)
    more = np.array([other.segment(0.5 * k).held for k in range(20_000)]) / 2.0
    assert abs((values * more).mean()) < 5 * error


def test_a_sample_begins_at_its_time():
    noise = profile(Noise(1.0, 0.1, 3))
    for k in (-3, 0, 1, 3, 17, 1_000_003):
        piece = noise.segment(k * 0.1)
        assert piece.start == k * 0.1
        assert piece.end == (k + 1) * 0.1
        assert noise.value(float(np.nextafter(piece.end, -np.inf))) == piece.held
        assert noise.next_event(piece.end) == (k + 2) * 0.1


def test_samples_too_short_for_the_time_are_refused():
    with pytest.raises(ProfileError, match=r"noise\.sample_time = 1e-12: the samples near"):
        Noise(1.0, 1e-12, 1).segment(1e5)
