"""The certificate itself: the worst Delta, the margin, and a search that can be trusted."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from congelation.theory.certificate import PerturbationSet
from congelation.theory.closed_loop import SmoothPiece, close
from congelation.theory.iss_riccati import iss_riccati, iss_weight
from congelation.theory.lyapunov import output_feedback_certificate, state_feedback_certificate
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import strict_feedback_plant

from .systems import seeds

FIG_2 = {"c": [0.5, 0.5], "epsilon": 0.3, "delta": math.sqrt(2)}


def state_feedback(**parameters):
    loop = close(strict_feedback_plant(), state_feedback_controller(), FIG_2 | parameters)
    return state_feedback_certificate(loop)


@given(seed=seeds, p=st.integers(2, 5), share=st.floats(0, 1))
@settings(max_examples=60)
def test_worst_perturbation_is_admitted_and_beats_all_others(seed, p, share):
    rng = np.random.default_rng(seed)
    admitted = PerturbationSet(2.0, (False,) + (True,) * (p - 1), first=1, delta_1=2.0 * share)
    gradient = rng.normal(size=p)
    worst = admitted.worst(gradient)
    assert worst[0] == 0
    assert np.linalg.norm(worst) <= 2.0 * (1 + 1e-12)
    assert abs(worst[1]) <= admitted.delta_1 * (1 + 1e-12)
    for _ in range(200):
        Delta = np.append(0, rng.normal(size=p - 1))
        Delta *= 2.0 / np.linalg.norm(Delta)
        if abs(Delta[1]) > admitted.delta_1:
            Delta[1] = math.copysign(admitted.delta_1, Delta[1])
        assert gradient @ Delta <= gradient @ worst + 1e-9


def test_worst_perturbation_of_nothing():
    assert PerturbationSet(1.0, (True, True)).worst(np.zeros(2)).tolist() == [0, 0]
    only = PerturbationSet(1.0, (True,), first=0, delta_1=0.25)
    assert only.worst(np.array([-3.0])).tolist() == [-0.25]


def test_rate_at_the_worst_delta_is_the_rate_of_V_along_the_loop():
    """V' in closed form against a difference quotient of V along a short run."""
    certificate = state_feedback()
    X, ell = np.array([0.4, -0.3, 0.8, -0.2]), np.array([-3.0, 2.0])
    margin = certificate.at(X, ell)
    theta, h = ell + margin.Delta, 1e-6
    solution = certificate.loop.solve(
        [SmoothPiece(0, 2 * h, lambda t: theta)], X, [0, h, 2 * h], rtol=1e-13, atol=1e-15
    )
    V = [certificate.at(state, ell).V for state in solution.states]
    assert (-3 * V[0] + 4 * V[1] - V[2]) / (2 * h) == pytest.approx(margin.rate, rel=1e-5)
    assert margin.value == margin.rate + margin.claimed
    assert np.linalg.norm(margin.Delta) == pytest.approx(math.sqrt(2))


def test_V_of_the_output_feedback_design_by_hand():
    """At z = 0 and exact estimates V is the weight times r^2 x_tilde^T X^-1 x_tilde."""
    parameters = {"d": [0.2, 0.5], "r": 4.0, "epsilon": 0.5, "delta": 0.75, "delta_1": 0.3}
    loop = close(observer_form_plant(), output_feedback_controller(), parameters)
    ell = np.array([2.0, -1.0, 0.5])
    names = {"controller.rho_hat": 0.5, "plant.x[2]": 1.5}
    names |= {f"controller.theta_hat[{k + 1}]": value for k, value in enumerate(ell)}
    X = [names.get(name, 0.0) for name in loop.state_names]
    P = 16 * np.linalg.inv(iss_riccati(4.0, iss_weight(2, 0.5)))
    V_x_tilde = 1.5**2 * P[1, 1]
    weight = (1 / (4 * 0.2) + 1 / (4 * 0.5)) * (1 + 0.3 / (4 * 0.5 * 0.75))
    assert pytest.approx(weight * V_x_tilde) == output_feedback_certificate(loop).at(X, ell).V


def test_V_falls_along_a_run_with_jumps():
    certificate = state_feedback()
    ell = np.array([-3.0, 2.0])
    segments = [
        SmoothPiece(0.1 * k, 0.1 * (k + 1), lambda t, s=(-1) ** k: [-3 + s, 2 + math.sin(50 * t)])
        for k in range(20)
    ]
    loop = certificate.loop
    solution = loop.solve(segments, loop.start({"x": [2, -1]}), np.linspace(0, 2, 401))
    margins = certificate.along(solution.states, ell)
    V = np.array([m.V for m in margins])
    assert (np.diff(V) <= 1e-9 * V[0]).all()
    assert not any(m.violated for m in margins)


def test_search_is_repeatable_and_names_the_states():
    certificate = state_feedback(damping=0)
    first, second = (certificate.search(samples=50, ascents=2, seed=7) for _ in range(2))
    assert first.state == second.state
    assert set(first.state) == set(certificate.loop.state_names)
    again = certificate.at(list(first.state.values()), first.ell)
    assert again.excess == pytest.approx(first.margin.excess)
    assert first.violated
    assert first.samples == 50


def test_ascent_finds_what_sampling_alone_does_not():
    parameters = {"c": [0.8, 0.8], "d": [0.2, 0.2], "r": 11.0, "epsilon": 0.1, "corrected": 0}
    parameters |= {"delta": math.sqrt(2), "delta_1": 1.0}
    loop = close(observer_form_plant(), output_feedback_controller(), parameters)
    certificate = output_feedback_certificate(loop)
    sampled = certificate.search(samples=100, ascents=1, seed=3)
    climbed = certificate.search(samples=100, ascents=20, seed=3)
    assert climbed.margin.excess >= sampled.margin.excess
    assert climbed.violated


def test_a_radius_beyond_the_design_is_found_out():
    """Designed for delta = sqrt(2), judged at twenty times that."""
    certificate = state_feedback()
    wider = dataclasses.replace(
        certificate, perturbations=PerturbationSet(20 * math.sqrt(2), (True, True))
    )
    assert not certificate.search(samples=200, ascents=5).violated
    assert wider.search(samples=200, ascents=5).violated


def test_margin_at_rest_is_zero():
    margin = state_feedback().at(np.zeros(4), np.zeros(2))
    assert (margin.V, margin.value, margin.relative, margin.excess) == (0, 0, 0, 0)
    assert not margin.violated
