"""The Riccati equations, checked through their residuals and through independent knowledge."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from congelation.errors import InfeasibleDesign, InvalidInput
from congelation.theory.gains import (
    RULES,
    filter_norm,
    filter_riccati,
    hurwitz_filter_gain,
    iss_filter_gain,
    iss_filter_gain_varying_b,
    matched_riccati,
    placed_filter_gain,
)
from congelation.theory.iss_riccati import iss_riccati, iss_weight, smallest_feasible_r
from congelation.theory.matrices import filter_matrix, upper_shift

from .systems import least_r, random_definite, seeds

orders = st.integers(min_value=1, max_value=5)
weights = st.sampled_from([0.05, 0.3, 1.0, 5.0])


SOURCES = Path(__file__).parents[2] / "fmu_src"


@pytest.fixture(scope="module")
def inside_fmus():
    """The rules that travel inside the FMUs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(SOURCES)
        return importlib.import_module("python.gains")


def residual_of_43(X, r, Q):
    """Largest element of the residual, and of the terms S X, X e_1 e_1^T X, X X / r^2 and Q."""
    SX, first, square = upper_shift(len(X)) @ X, X[:, :1] @ X[:1], X @ X / r**2
    left = SX + SX.T - first + square + Q
    return np.abs(left).max(), max(np.abs(term).max() for term in (SX, first, square, Q))


def check_solution(X, r, Q):
    residual, scale = residual_of_43(X, r, Q)
    assert residual < 1e-13 * scale
    assert np.linalg.eigvalsh(X).min() > 0


def riccati_terms(X, r, Q):
    S, e_1 = upper_shift(len(X)), np.eye(len(X))[:, :1]
    return [S @ X + X @ S.T, -X @ (e_1 @ e_1.T - np.eye(len(X)) / r**2) @ X, Q]


@given(n=orders, epsilon=weights, factor=st.floats(min_value=1.001, max_value=20))
def test_iss_riccati_solves_43(n, epsilon, factor):
    Q = iss_weight(n, epsilon)
    r = factor * least_r(n, epsilon)
    X = iss_riccati(r, Q)
    terms = riccati_terms(X, r, Q)
    scale = max(np.abs(t).max() for t in terms)
    assert np.abs(sum(terms)).max() < 1e-8 * scale
    assert np.linalg.eigvalsh(X).min() > 0
    assert np.linalg.eigvals(filter_matrix(X[:, 0] / 2)).real.max() < 0
    assert iss_filter_gain(r, epsilon, n=n) == pytest.approx(X[:, 0] / 2)


@pytest.mark.parametrize("epsilon", [1e-4, 0.1, 10**-0.5, 1.0, 3.0, 1e3])
def test_smallest_r_closed_forms(epsilon):
    """n = 1: (1 - 1/r^2) X^2 = q, so r > 1. n = 2: X blows up along v with v_1 = 1/r, and the
    projections of (43) on v and across give r^2 = 1 + q."""
    q = 1 / epsilon**2
    assert 1 < smallest_feasible_r(1, iss_weight(1, epsilon)) < 1 + 1e-9
    edge = math.sqrt(1 + q)
    assert edge < smallest_feasible_r(2, iss_weight(2, epsilon)) < edge * (1 + 1e-9)


@pytest.mark.parametrize("n", [1, 2, 4, 8])
@pytest.mark.parametrize("epsilon", [1e-4, 1e-2, 1e2, 1e4])
def test_filters_for_extreme_weights(n, epsilon):
    r = smallest_feasible_r(n, iss_weight(n, epsilon))
    assert np.isfinite(iss_filter_gain(1.5 * r, epsilon, n=n)).all()


@pytest.mark.parametrize("r", [1e10, 1e20, 1e300])
def test_filter_for_a_large_r_is_the_one_without_bound(r):
    """As r grows, (43) becomes the Riccati equation of the Kalman filter. For n = 2 its element
    (2, 2) gives X_12 = sqrt(q), and (1, 1) gives X_11 = sqrt(q + 2 X_12)."""
    q = 1 / 0.3**2
    k = iss_filter_gain(r, 0.3, n=2)
    assert k == pytest.approx([math.sqrt(q + 2 * math.sqrt(q)) / 2, math.sqrt(q) / 2], rel=1e-14)


def test_weights_beyond_double_precision_are_refused():
    with pytest.raises(InfeasibleDesign, match="double precision"):
        smallest_feasible_r(3, iss_weight(3, 1e-14))


@pytest.mark.fuzz
@given(n=st.integers(1, 6), seed=seeds)
def test_smallest_r_separates(n, seed):
    """Feasible at and above it, with an accurate solution; infeasible below."""
    Q = random_definite(np.random.default_rng(seed), n)
    r = smallest_feasible_r(n, Q)
    for factor in (1, 1 + 1e-9, 1 + 1e-8, 1 + 1e-6, 1.1, 1e3, 1e9):
        check_solution(iss_riccati(r * factor, Q), r * factor, Q)
    for factor in (1 - 1e-9, 1 - 1e-8, 1 - 1e-6, 0.9, 1e-3):
        assert iss_riccati(r * factor, Q) is None


@pytest.mark.fuzz
@given(seed=seeds)
def test_closed_form_for_order_2(seed):
    q = 10 ** np.random.default_rng(seed).uniform(-4, 8)
    edge = math.sqrt(1 + q)
    r = smallest_feasible_r(2, q * np.eye(2))
    assert edge < r < edge * (1 + 1e-9)


@given(n=st.integers(1, 6), seed=seeds)
@settings(max_examples=20)
def test_residual_of_43_away_from_the_edge(n, seed):
    """Relative to X (e_1 e_1^T - I / r^2) X as a whole, whose parts nearly cancel at the edge."""
    Q = random_definite(np.random.default_rng(seed), n)
    r = smallest_feasible_r(n, Q) * (1 + 1e-6)
    terms = riccati_terms(iss_riccati(r, Q), r, Q)
    assert np.abs(sum(terms)).max() < 1e-8 * max(np.abs(term).max() for term in terms)


def test_a_case_that_bisection_on_the_game_equation_failed():
    Q = random_definite(np.random.default_rng(0), 5)
    r = smallest_feasible_r(5, Q)
    assert r == pytest.approx(9.568993914177, rel=1e-9)
    check_solution(iss_riccati(1.000001 * r, Q), 1.000001 * r, Q)


def test_solution_that_double_precision_cannot_hold():
    """Eigenvalues of Q so far apart that X, though positive definite, does not survive rounding."""
    with pytest.raises(InfeasibleDesign, match="too near to a singular matrix"):
        iss_riccati(10.0, np.diag([1.0, 1.0, 1e-30]))


@pytest.mark.parametrize("Q", [np.diag([1.0, -1.0]), [[1.0, 2.0], [0.0, 5.0]], [[math.nan]]])
def test_weights_that_are_refused(Q):
    with pytest.raises(InvalidInput, match="symmetric and positive definite"):
        iss_riccati(5.0, Q)


@pytest.mark.fuzz
@settings(max_examples=settings.default.max_examples // 4)  # fractions in Python take their time
@given(n=st.integers(1, 5), logarithm=st.floats(-1.5, 1.5), factor=st.floats(1, 20))
def test_filters_inside_fmus_are_the_same(inside_fmus, n, logarithm, factor):
    """Bit for bit, however near to the edge: both sides round the exact solution."""
    epsilon = 10**logarithm
    r = smallest_feasible_r(n, iss_weight(n, epsilon))
    assert inside_fmus.smallest_feasible_r(n, epsilon) == r
    for given_r in (r, factor * r):
        k = iss_filter_gain(given_r, epsilon, n=n)
        assert inside_fmus.iss_filter_gain(given_r, epsilon, n) == k.tolist()
    with pytest.raises(inside_fmus.Infeasible, match="smallest feasible r is"):
        inside_fmus.iss_filter_gain(r * (1 - 1e-9), epsilon, n)


@given(seed=seeds, n=st.integers(1, 4))
@settings(max_examples=20)
def test_other_rules_inside_fmus_are_the_same(inside_fmus, seed, n):
    rng = np.random.default_rng(seed)
    k = placed_filter_gain(-rng.uniform(0.3, 3, n))
    assert inside_fmus.filter_norm(k.tolist()) == pytest.approx(filter_norm(k), rel=1e-9)
    A, B, Q = rng.normal(size=(n, n)), rng.normal(size=(n, 1)), random_definite(rng, n)
    rho, epsilon, delta = 6.0, rng.uniform(0.5, 2), rng.uniform(0, 2)
    P = matched_riccati(rho, epsilon, delta, 1.0, Q, A=A, B=B)
    inside = inside_fmus.matched_riccati(
        rho, epsilon, delta, True, Q.tolist(), A.tolist(), B.tolist()
    )
    assert inside == pytest.approx(P.ravel(), rel=1e-9, abs=1e-12)


def test_paper_values_are_infeasible():
    with pytest.raises(InfeasibleDesign, match=r"smallest feasible r is 10\.0499"):
        iss_filter_gain(5.0, 0.1, n=2)
    assert iss_filter_gain(5.0, math.sqrt(0.1), n=2).shape == (2,)
    assert iss_filter_gain(11.0, 0.1, n=2).shape == (2,)


@pytest.mark.parametrize(("n", "epsilon"), [(2, 0.1), (3, 0.1), (2, 10**-0.5), (3, 10**-0.5)])
def test_the_r_of_the_message_is_feasible(n, epsilon):
    with pytest.raises(InfeasibleDesign) as refusal:
        iss_filter_gain(0.5, epsilon, n=n)
    r = str(refusal.value).partition("smallest feasible r is ")[2].split()[0]
    iss_filter_gain(float(r), epsilon, n=n)


def test_weight_of_time_varying_b():
    Q = iss_weight(4, 0.5, 2.0, rho=2)
    assert pytest.approx(np.diag([4.0, 4.25, 4.25, 4.25])) == Q
    X = iss_riccati(2 * smallest_feasible_r(4, Q), Q)
    k = iss_filter_gain_varying_b(2 * smallest_feasible_r(4, Q), 0.5, 2.0, n=4, rho=2)
    assert k == pytest.approx(X[:, 0] / 2)
    with pytest.raises(InvalidInput, match="rho = 5"):
        iss_filter_gain_varying_b(9.0, 1.0, 1.0, n=4, rho=5)


@given(seed=seeds, n=st.integers(1, 4))
@settings(max_examples=30)
def test_bound_42_for_both_variations(seed, n):
    """V' <= -|x_tilde|^2 + r^2 eps_b^2 |Delta_b|^2 u^2 + r^2 eps_a^2 |Delta_a|^2 y^2, exactly."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(0, n))
    rho = n - m
    epsilon_a, epsilon_b = rng.uniform(0.2, 2, 2)
    Q = iss_weight(n, epsilon_a, epsilon_b, rho)
    r = smallest_feasible_r(n, Q) * rng.uniform(1.05, 3)
    X = iss_riccati(r, Q)
    P, A_f = r**2 * np.linalg.inv(X), filter_matrix(X[:, 0] / 2)
    inputs = np.vstack([np.zeros((rho - 1, m + 1)), np.eye(m + 1)])
    for _ in range(50):
        e, Delta_a, Delta_b = rng.normal(size=n), rng.normal(size=n), rng.normal(size=m + 1)
        y, u = rng.normal(size=2)
        rate = 2 * e @ P @ (A_f @ e + inputs @ Delta_b * u - Delta_a * y)  # (40)
        bound = -e @ e + r**2 * (
            epsilon_b**2 * (Delta_b @ Delta_b) * u**2 + epsilon_a**2 * (Delta_a @ Delta_a) * y**2
        )
        assert rate <= bound + 1e-9 * (abs(rate) + abs(bound))


@given(seed=seeds, n=st.integers(1, 4))
@settings(max_examples=20)
def test_filter_norm_is_the_peak_of_the_frequency_response(seed, n):
    rng = np.random.default_rng(seed)
    k = placed_filter_gain(-rng.uniform(0.3, 3, n))
    A_f, identity = filter_matrix(k), np.eye(n)
    frequencies = np.concatenate([[0.0], np.logspace(-3, 3, 1000)])
    responses = np.linalg.inv(1j * frequencies[:, None, None] * identity - A_f)
    peak = np.linalg.norm(responses, 2, axis=(1, 2)).max()
    (norm,) = filter_norm(k)
    assert norm == pytest.approx(peak, rel=1e-4)
    assert filter_riccati(k, 0.999 * peak) is None
    P = filter_riccati(k, 1.01 * norm)
    residual = A_f.T @ P + P @ A_f + P @ P / (1.01 * norm) ** 2 + identity
    assert np.abs(residual).max() < 1e-7 * np.abs(P).max() ** 2


def test_iss_filter_is_a_special_case_of_the_bounded_real_lemma():
    epsilon, r = 0.4, 4.0
    X = iss_riccati(r, iss_weight(2, epsilon))
    P, A_f = r**2 * np.linalg.inv(X), filter_matrix(X[:, 0] / 2)
    residual = A_f.T @ P + P @ A_f + P @ P / (r * epsilon) ** 2 + np.eye(2)
    assert np.abs(residual).max() < 1e-9 * np.abs(P @ P).max()
    assert filter_norm(X[:, 0] / 2)[0] <= r * epsilon


@given(poles=st.lists(st.floats(min_value=-5, max_value=-0.1), min_size=1, max_size=4))
def test_placed_poles(poles):
    k = placed_filter_gain(poles)
    expected = np.poly(poles)
    assert np.poly(filter_matrix(k)) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_filters_that_are_refused():
    with pytest.raises(InvalidInput, match="Hurwitz"):
        hurwitz_filter_gain([1.0, -1.0])
    with pytest.raises(InvalidInput, match="conjugate"):
        placed_filter_gain([-1 + 1j, -1 + 2j])
    with pytest.raises(InvalidInput, match="epsilon = -1"):
        iss_filter_gain(5.0, -1.0, n=2)
    with pytest.raises(InvalidInput, match="r = nan"):
        iss_filter_gain(math.nan, 1.0, n=2)
    with pytest.raises(InvalidInput, match="give 3 rows of 3 numbers"):
        smallest_feasible_r(3, np.eye(2))


@given(seed=seeds, n=st.integers(1, 4), damping=st.sampled_from([0.0, 1.0]))
def test_matched_riccati(seed, n, damping):
    rng = np.random.default_rng(seed)
    A, B, Q = rng.normal(size=(n, n)), rng.normal(size=(n, 1)), random_definite(rng, n)
    epsilon, delta = rng.uniform(0.3, 2), rng.uniform(0, 2)
    rho = 1 / epsilon**2 + rng.uniform(0.5, 2)
    P = matched_riccati(rho, epsilon, delta, damping, Q, A=A, B=B)
    terms = [
        A.T @ P + P @ A,
        -(rho - damping / epsilon**2) * P @ B @ B.T @ P,
        Q + damping * epsilon**2 * delta**2 * np.eye(n),
    ]
    assert np.abs(sum(terms)).max() < 1e-8 * max(np.abs(t).max() for t in terms)
    assert np.linalg.eigvalsh(P).min() > 0


def test_matched_riccati_refusals():
    A, B, Q = [[0.0, 1.0], [0.0, 0.0]], [0.0, 1.0], np.eye(2)
    with pytest.raises(InfeasibleDesign, match=r"rho > 1/epsilon\^2 = 4"):
        matched_riccati(3.0, 0.5, 1.0, 1.0, Q, A=A, B=B)
    with pytest.raises(InfeasibleDesign, match="cannot be stabilised"):
        matched_riccati(3.0, 1.0, 1.0, 1.0, Q, A=np.eye(2), B=B)


def test_matched_riccati_with_the_gain_spent_on_damping():
    """rho = 1/epsilon^2 leaves a Lyapunov equation, which a Hurwitz A can afford."""
    A = np.array([[-1.0, 1.0], [0.0, -2.0]])
    P = matched_riccati(1.0, 1.0, 0.5, 1.0, np.eye(2), A=A, B=[0.0, 1.0])
    assert pytest.approx(-1.25 * np.eye(2)) == A.T @ P + P @ A


def test_rules_are_called_by_name():
    assert RULES["iss_filter_gain"](4.0, 0.5, n=2) == pytest.approx(iss_filter_gain(4.0, 0.5, n=2))
