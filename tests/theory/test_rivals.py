"""The rivals of other kind: filtered transformations, and congelation about the origin."""

import numpy as np
import pytest

from congelation.theory.adaptation import robust
from congelation.theory.closed_loop import SmoothPiece, close
from congelation.theory.filtered_transformation import filtered_transformation_controller
from congelation.theory.lyapunov import matched_certificate
from congelation.theory.matching import matched_controller, matched_plant
from congelation.theory.observer_form import observer_form_plant

from .systems import numbers


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2)])
def test_the_filtered_transformation_regulates(n, m, sign):
    """b(s) = sign (s + 2)^m, an unstable plant, a(t) fast, no bound known."""
    b = sign * np.atleast_1d(np.poly([-2.0] * m))
    controller = filtered_transformation_controller(n, m)
    given = {"lam": [2.0] * (n - m - 1)} if n - m > 1 else {}
    loop = close(observer_form_plant(n, m), controller, {"sign_b_m": sign, **given})
    center = np.array([-0.5, 0.3, 0.2][:n])
    segment = SmoothPiece(
        0, 40, lambda t: [*b, *(center + 0.3 * np.sin(np.array([9.0, 5.0, 14.0][:n]) * t))]
    )
    start = loop.start({"x": [1.0, -0.5, 0.2][:n]})
    solution = loop.solve([segment], start, [0, 40], rtol=1e-7, atol=1e-9)
    assert solution.success, solution.message
    assert np.abs(solution.states[-1, :n]).max() < 1e-3


def test_the_filtered_transformation_by_hand():
    """rho = 2: v_1 = -s k y, u = lam mu - p q e_2 - s k' y."""
    model, rng = filtered_transformation_controller(2, 0), np.random.default_rng(0)
    gamma, gamma_p, lam, s, sigma = 1.3, 0.7, 2.1, -1.0, 0.1
    given = {"gamma": gamma, "gamma_p": gamma_p, "lam": lam, "sign_b_m": s, "sigma": sigma}
    for _ in range(20):
        y, k, p, mu = rng.normal(size=4)
        values = {**given, "y": y, "k_hat": k, "p": p, "mu": mu}
        found = numbers(model, [model.output("u"), *(v.rate for v in model.states)], values)
        e_2, q = mu + s * k * y, 1 + k**2 * (1 + k**2)
        k_rate = gamma * y**2 - sigma * k
        u = lam * mu - p * q * e_2 - s * k_rate * y
        p_rate = gamma_p * q * e_2**2 - sigma * p
        assert [f.item() for f in found] == pytest.approx([u, k_rate, p_rate, -lam * mu + u])


@pytest.mark.parametrize("n", [2, 3])
def test_congelation_about_the_origin_is_the_rival_of_the_matched_plant(n):
    """ell = 0 and delta = sup |theta|: V' <= -x^T Q x - sigma |theta_hat|^2, no residue."""
    A, B = np.eye(n, k=1) + 0.2 * np.eye(n), np.eye(n)[:, -1:]
    parameters = {"delta": 2.5, "epsilon": 1.0, "sigma": 0.3}
    loop = close(matched_plant(A, B), matched_controller(A, B, robust), parameters)
    certificate, rng = matched_certificate(loop), np.random.default_rng(n)
    for _ in range(200):
        state = rng.normal(size=2 * n) * 10 ** rng.uniform(-2, 1)
        margin = certificate.at(state, np.zeros(n))
        assert margin.residue == 0
        assert margin.claimed >= 0.3 * state[n:] @ state[n:]
        assert not margin.violated


def test_a_radius_about_the_origin_costs_more_damping():
    """The control at one state, for the radius about the centre (0.7) and about 0 (2.5)."""
    A, B = np.eye(2, k=1), np.eye(2)[:, -1:]
    gains = []
    for delta in (0.7, 2.5):
        loop = close(matched_plant(A, B), matched_controller(A, B, robust), {"delta": delta})
        gains.append(abs(loop.output_function([1.0, 0, 0, 0], [0.0, 0.0])[-3]))
    assert gains[1] > 1.5 * gains[0]
