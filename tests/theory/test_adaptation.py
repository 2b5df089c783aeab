"""The rival laws: neutral when off, consistent inside the recursion, and what each promises."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from congelation.theory.adaptation import claim_of, robust
from congelation.theory.closed_loop import SmoothPiece, close
from congelation.theory.lyapunov import output_feedback_certificate, state_feedback_certificate
from congelation.theory.matching import matched_controller
from congelation.theory.model import matrix, vector
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.output_feedback import (
    output_feedback_controller,
    output_feedback_design,
    output_feedback_model,
)
from congelation.theory.scalar import scalar_controller, scalar_plant
from congelation.theory.state_feedback import (
    state_feedback_controller,
    state_feedback_design,
    state_feedback_model,
)
from congelation.theory.strict_feedback import strict_feedback_plant
from congelation.theory.values import complete_values

from .systems import (
    degrees,
    numbers,
    orders,
    random_definite,
    random_output_feedback_parameters,
    random_phibar,
    random_state,
    random_state_feedback_parameters,
    relative_difference,
    seeds,
)

ALL_ON = {
    "sigma": 0.3,
    "switching": 1.0,
    "projection_ball": 1.0,
    "projection_box": 1.0,
    "projection_margin": 0.4,
    "dead_zone": 0.2,
    "theta_bound": 1.2,
}
"""Every modification at work at once, at states of unit size."""


class Law:
    """chi, P and the regressor of a `robust` law as functions of numbers."""

    def __init__(self, p, steps=2):
        self.theta_hat, Gamma = vector("theta_hat", p, ""), matrix("Gamma", p, p, "")
        self.law = robust(self.theta_hat, Gamma.symbol, steps)
        self.Gamma, self.tau, self.w, self.z = (
            Gamma,
            ca.SX.sym("tau", p),
            ca.SX.sym("w", p),
            ca.SX.sym("z"),
        )

    def __call__(self, expression, theta_hat, Gamma, tau=0, w=0, z=0, **settings):
        return self.function(expression)(theta_hat, Gamma, tau, w, z, **settings)

    def function(self, expression):
        """The numbers of an expression, compiled once for many calls."""
        named = {q.variables.name: (q.variables.symbol, q.default) for q in self.law.parameters}
        symbols = [self.theta_hat.symbol, self.Gamma.symbol, self.tau, self.w, self.z]
        function = ca.Function("law", symbols + [s for s, _ in named.values()], [expression])

        def call(theta_hat, Gamma, tau=0, w=0, z=0, **settings):
            values = [settings.get(name, default) for name, (_, default) in named.items()]
            return np.array(function(theta_hat, Gamma, tau, w, z, *map(ca.DM, values)))

        return call


@given(order=orders, seed=seeds)
@settings(max_examples=20)
def test_neutral_defaults_leave_the_state_feedback_law(order, seed):
    n, p = order
    rng = np.random.default_rng(seed)
    phibar = random_phibar(rng, n, p)
    plain, rival = state_feedback_controller(phibar), state_feedback_controller(phibar, robust)
    values = random_state_feedback_parameters(rng, n, p) | random_state(rng, plain)
    neutral = {k: v for k, v in complete_values(rival).items() if k not in values}
    for name in ("u", "theta_hat"):
        (a,), (b,) = (
            numbers(m, [m.output("u") if name == "u" else m.states[0].rate], neutral | values)
            for m in (plain, rival)
        )
        assert relative_difference(a, b) < 1e-12


def test_neutral_defaults_leave_the_other_laws():
    rng = np.random.default_rng(5)
    for make in (scalar_controller, matched_controller, output_feedback_controller):
        plain, rival = make(), make(adaptation=robust)
        values = complete_values(rival) | random_state(rng, plain)
        for which in ([m.output("u"), *(s.rate for s in m.states)] for m in (plain, rival)):
            assert len(which) == 1 + len(plain.states)
        expected = numbers(plain, [plain.output("u"), *(s.rate for s in plain.states)], values)
        found = numbers(rival, [rival.output("u"), *(s.rate for s in rival.states)], values)
        for a, b in zip(expected, found, strict=True):
            assert relative_difference(a, b) < 1e-12


def test_neutral_law_stays_finite_where_the_modifications_would_overflow():
    """Off means off: no 0 times infinity far out."""
    law = Law(2, steps=4)
    chi = law(law.law.rate(law.tau), [1e200, -1e180], np.eye(2), [3.0, 4.0])
    assert chi.ravel() == pytest.approx([3.0, 4.0])


@given(seed=seeds, p=st.integers(1, 3), steps=st.integers(1, 4))
@settings(max_examples=40)
def test_slope_is_the_divided_difference_of_the_rate(seed, p, steps):
    rng = np.random.default_rng(seed)
    law, Gamma = Law(p, steps), random_definite(rng, p)
    theta_hat, before, w, z = rng.normal(size=p), *rng.normal(size=(2, p)), rng.normal()
    after = law.tau + law.w * law.z
    difference = law.law.rate(after) - law.law.rate(law.tau)
    slope = law.law.slope(law.tau, after, law.w) * law.z
    half_width = np.full(p, 0.8)
    parameters = ALL_ON | {"theta_half_width": half_width}
    expected = law(difference, theta_hat, Gamma, before, w, z, **parameters)
    found = law(slope, theta_hat, Gamma, before, w, z, **parameters)
    assert found == pytest.approx(expected, rel=1e-8, abs=1e-9)


@given(order=orders, seed=seeds)
@settings(max_examples=25)
def test_modified_law_is_carried_through_the_state_feedback_recursion(order, seed):
    """z^T z' is the gradient law's plus z^T W^T terms only: every estimate term telescopes.

    z^T z' = -sum c_i z_i^2 + z^T A_zeta z + z^T W^T (theta - theta_hat), chi being whatever.
    """
    n, p = order
    rng = np.random.default_rng(seed)
    design = state_feedback_design(random_phibar(rng, n, p), robust)
    model = state_feedback_model(design)
    plant = strict_feedback_plant(design.regressors)
    own = random_state_feedback_parameters(rng, n, p) | ALL_ON | {"theta_half_width": np.ones(p)}
    values = complete_values(model, own) | random_state(rng, model)
    theta = rng.normal(size=p)
    x, theta_hat = design.symbols.x.symbol, design.symbols.theta_hat.symbol
    z, W, zeta, u, estimate_rate, J_x, J_theta = numbers(
        model,
        [
            design.z,
            design.W,
            ca.vertcat(*(s.zeta for s in design.steps)),
            design.u,
            design.theta_hat_rate,
            ca.jacobian(design.z, x),
            ca.jacobian(design.z, theta_hat),
        ],
        values,
    )
    (x_rate,) = numbers(plant, [plant.states[0].rate], {"x": values["x"], "u": u, "theta": theta})
    terms = [z.T @ J_x @ x_rate, z.T @ J_theta @ estimate_rate]
    expected = [
        -(values["c"] * z**2).sum(),
        (z.T @ zeta @ z).item(),
        (z.T @ W.T @ (theta - values["theta_hat"].ravel())).item(),
    ]
    size = max(abs(t) for t in [*(t.item() for t in terms), *expected])
    size = max(size, float(np.abs(z.T @ J_x).max() * np.abs(x_rate).max()))
    assert sum(t.item() for t in terms) == pytest.approx(sum(expected), abs=1e-9 * size)


@given(degree=degrees.filter(lambda degree: degree[0] < 4), seed=seeds)
@settings(max_examples=12)
def test_modified_law_is_carried_through_the_output_feedback_recursion(degree, seed):
    """The same identity, from the corrected (57) with x_tilde = 0 and Delta = 0."""
    n, m = degree
    rng = np.random.default_rng(seed)
    design = output_feedback_design(n, m, robust)
    model, plant = output_feedback_model(design), observer_form_plant(n, m)
    own = random_output_feedback_parameters(rng, n, m) | ALL_ON
    values = complete_values(model, own) | random_state(rng, model)
    ell = rng.normal(size=m + 1 + n)
    y = design.symbols.y.symbol
    flows = [ca.jacobian(design.z, s.variables.symbol) @ s.rate for s in model.states]
    z, u, W, W_x, alphabar, xi, Omega_T, z_y, *rates = numbers(
        model,
        [
            *(design.z, design.u, design.W_theta, design.W_x_tilde, design.alphabar_1),
            *(design.filter.xi, design.filter.Omega_T, ca.jacobian(design.z, y), *flows),
        ],
        values,
    )
    x = (xi + Omega_T @ ell[:, None]).ravel()
    x[0] = values["y"].item()  # x_tilde_1 may be anything: (57) holds x_tilde_2 alone
    (x_rate,) = numbers(plant, [plant.states[0].rate], {"x": x, "u": u, "theta": ell})
    found = (z.T @ (z_y * x_rate[0] + sum(rates))).item()
    p = {k: np.ravel(v) for k, v in values.items()}
    g = p["r"] * p["epsilon"] * p["delta"] + p["delta_1"]
    zeta = (-(g**2) * (1 / (4 * p["d"])).sum()).item()
    expected = -((p["c"] + p["d"] * W_x.ravel() ** 2) * z.ravel() ** 2).sum()
    expected += zeta * z[0].item() ** 2 + (z.T @ W.T @ (ell - p["theta_hat"])).item()
    expected -= (ell[0] * alphabar * (1 / ell[0] - p["rho_hat"]) * z[0]).item()
    size = sum(float(np.abs(z * r).max()) for r in [z_y * x_rate[0], *rates]) + abs(expected)
    assert found == pytest.approx(expected, abs=1e-9 * size)


@given(seed=seeds, p=st.integers(1, 4), shape=st.sampled_from(["ball", "box", "both"]))
@settings(max_examples=60)
def test_projection_keeps_the_estimate_and_does_not_raise_V(seed, p, shape):
    """At the edge P = 1 the estimate turns inwards for every tau, and
    (ell - theta_hat)^T (tau - chi) <= 0 for every ell in the set [7], [8], [C]."""
    rng = np.random.default_rng(seed)
    law, Gamma = Law(p), random_definite(rng, p)
    half_width, center = rng.uniform(0.5, 2, p), rng.normal(size=p)
    parameters = {
        "projection_ball": float(shape != "box"),
        "projection_box": float(shape != "ball"),
        "theta_bound": rng.uniform(0.5, 2),
        "theta_half_width": half_width,
        "theta_center": center,
    }
    P, normal, _ = law.law._constraint()
    chi = law.law.rate(law.tau)

    P_at, direction = law.function(P), rng.normal(size=p)
    direction /= np.linalg.norm(direction)
    low, high = 0.0, 10.0  # on the ray from the center, P rises from 0
    for _ in range(60):
        middle = (low + high) / 2
        below = P_at(center + middle * direction, Gamma, **parameters).item() < 1
        low, high = (middle, high) if below else (low, middle)
    tau = 10 * rng.normal(size=p)
    edge = center + high * direction
    outwards = law(normal.T @ law.Gamma.symbol @ chi, edge, Gamma, tau, **parameters).item()
    assert outwards < 0
    enlarged = 1.1 + 1e-9
    if shape != "box":
        assert np.linalg.norm(edge - center) <= enlarged * parameters["theta_bound"]
    if shape != "ball":
        assert (np.abs(edge - center) <= enlarged * half_width).all()

    theta_hat = center + rng.uniform(0, high) * direction
    ell = center + rng.uniform(-1, 1, p) * half_width
    if shape != "box":
        ell = center + (ell - center) * min(
            1, parameters["theta_bound"] / np.linalg.norm(ell - center)
        )
    pull = law(law.tau - chi, theta_hat, Gamma, tau, **parameters).ravel()
    assert (ell - theta_hat) @ pull <= 1e-9 * np.abs(pull).max()


def telegraph_loop(controller, parameters, plant=None):
    """System (60) under theta that swings and jumps, with the estimates recorded."""
    loop = close(plant or strict_feedback_plant(), controller, parameters)
    signs = np.sign(np.random.default_rng(0).normal(size=20))
    segments = [
        SmoothPiece(0.5 * k, 0.5 * (k + 1), lambda t, s=s: [-3 + s, 2 + math.cos(20 * t)])
        for k, s in enumerate(signs)
    ]
    start = loop.start({"x": [2, -1]})
    solution = loop.solve(segments, start, np.linspace(0, 10, 201), rtol=1e-8, atol=1e-9)
    assert solution.success, solution.message
    columns = [k for k, name in enumerate(loop.state_names) if "theta_hat" in name]
    return loop, solution, solution.states[:, columns]


FIG_2 = {"c": [0.5, 0.5], "epsilon": 0.3, "delta": math.sqrt(2), "damping": 0.0}


def test_projection_confines_the_estimates_along_a_run():
    center, half_width = np.array([-2.0, 1.0]), np.array([2.0, 1.2])
    box = {"theta_center": center, "theta_half_width": half_width, "projection_box": 1.0}
    controller = state_feedback_controller(adaptation=robust)
    _, _, estimates = telegraph_loop(controller, FIG_2 | box)
    assert (np.abs(estimates - center) <= 1.1 * half_width + 1e-4).all()
    _, _, free = telegraph_loop(controller, FIG_2)
    assert (np.abs(free - center) > 1.2 * half_width).any()  # so the projection was needed


def test_projection_keeps_the_certificate_for_constant_parameters():
    """V' <= -sum c_i z_i^2 where ell is in the set; the search draws ell there."""
    parameters = FIG_2 | {"damping": 1.0, "projection_ball": 1.0, "theta_bound": 6.0}
    loop = close(strict_feedback_plant(), state_feedback_controller(adaptation=robust), parameters)
    certificate = state_feedback_certificate(loop)
    assert not certificate.search(samples=300, ascents=5).violated  # |ell| > 6 is not drawn
    wide = {"projection_ball": 1.0, "theta_bound": 8.0, "rho_bound": 8.0, "delta": 1.0}
    loop = close(observer_form_plant(), output_feedback_controller(adaptation=robust), wide)
    assert not output_feedback_certificate(loop).search(samples=300, ascents=5, seed=3).violated


def test_frozen_estimates_do_not_move():
    _, _, estimates = telegraph_loop(
        state_feedback_controller(adaptation=robust), FIG_2 | {"adapt": 0.0, "damping": 1.0}
    )
    assert not estimates.any()


def test_fixed_leakage_bounds_and_forgets_the_estimate():
    """theta_hat' = -gamma x^2 - gamma sigma theta_hat: after x has settled the estimate decays
    at the rate gamma sigma, where the gradient law keeps it."""
    parameters = {"gamma": 2.0, "delta": 2.0}
    ends = {}
    for sigma in (0.0, 0.5):
        loop = close(scalar_plant(), scalar_controller(robust), parameters | {"sigma": sigma})
        segment = SmoothPiece(0, 20, lambda t: [-1 + math.sin(5 * t)])
        solution = loop.solve([segment], loop.start({"x": [3.0]}), [0, 10, 20])
        ends[sigma] = solution.states[:, 1]
    assert ends[0.0][2] == pytest.approx(ends[0.0][1], rel=1e-6)
    assert ends[0.5][2] == pytest.approx(ends[0.5][1] * math.exp(-10), rel=1e-3)


@given(seed=seeds)
@settings(max_examples=30)
def test_switching_leakage_never_raises_V_where_the_bound_is_right(seed):
    """(ell - theta_hat)^T (tau - chi) <= 0 for |ell - center| <= bound [9], and none inside."""
    rng = np.random.default_rng(seed)
    p = int(rng.integers(1, 4))
    law, Gamma = Law(p), random_definite(rng, p)
    bound, center = rng.uniform(0.5, 2), rng.normal(size=p)
    parameters = {"sigma": 1.5, "switching": 1.0, "theta_bound": bound, "theta_center": center}
    tau, direction = rng.normal(size=p), rng.normal(size=p)
    direction /= np.linalg.norm(direction)
    ell = center + rng.uniform(0, bound) * rng.permutation(direction)
    pull = law.tau - law.law.rate(law.tau)
    inside = center + 0.99 * bound * direction
    assert law(pull, inside, Gamma, tau, **parameters) == pytest.approx(np.zeros((p, 1)))
    outside = center + rng.uniform(1.01, 10) * bound * direction
    leak = law(pull, outside, Gamma, tau, **parameters).ravel()
    assert leak @ (outside - center) > 0
    assert (ell - outside) @ leak <= 0
    far = law(pull, center + 100 * bound * direction, Gamma, tau, **parameters).ravel()
    assert far == pytest.approx(1.5 * 100 * bound * direction, rel=1e-2)  # full leakage


def test_dead_zone_stops_the_estimates_and_opens_smoothly():
    law = Law(2)
    gate = law.law.regressor(law.w, law.z)
    w = np.array([1.0, -2.0])

    def at(z):
        return law(gate, [0, 0], np.eye(2), w=w, z=z, dead_zone=0.3).ravel()

    for z in (0.0, 0.1, -0.3):
        assert not at(z).any()
    assert at(0.3 * math.sqrt(2)) == pytest.approx(w / 2)
    assert at(10.0) == pytest.approx(w, rel=1e-5)
    assert np.abs(at(0.3 + 1e-6)).max() < 1e-12


def test_dead_zone_holds_the_estimates_after_settling():
    controller = state_feedback_controller(adaptation=robust)
    parameters = FIG_2 | {"damping": 1.0, "dead_zone": 0.05}
    loop, solution, estimates = telegraph_loop(controller, parameters)
    z = solution.outputs[:, [k for k, n in enumerate(loop.output_names) if ".z[" in n]]
    inside = (np.abs(z) <= 0.05).all(axis=1)
    first = int(np.argmax([inside[k:].all() for k in range(len(inside))]))
    assert inside[first]
    assert estimates[first:] == pytest.approx(np.tile(estimates[first], (len(z) - first, 1)))


CLAIMS = {
    "leakage": {"sigma": 0.5},
    "switching": {"sigma": 0.5, "switching": 1.0, "theta_bound": 2.0, "rho_bound": 3.0},
    "ball": {"projection_ball": 1.0, "theta_bound": 2.0, "rho_bound": 3.0},
    "box": {"projection_box": 1.0, "theta_half_width": 1.5, "rho_half_width": 3.0},
    "box and leakage": {
        "projection_box": 1.0,
        "theta_half_width": 1.5,
        "rho_half_width": 3.0,
        "sigma": 0.2,
    },
}


def robust_certificate(form, law):
    """The certificate of a design of the given orders under a law."""
    feedback, *orders = form
    if feedback == "state":
        phibar = random_phibar(np.random.default_rng(1), *orders)
        plant, p = strict_feedback_plant(phibar), orders[1]
        controller = state_feedback_controller(phibar, robust)
        of = state_feedback_certificate
    else:
        n, m = orders
        plant, p = observer_form_plant(n, m), m + 1 + n
        controller = output_feedback_controller(n, m, robust)
        of = output_feedback_certificate
    given = {
        name: np.full(p, value) if name == "theta_half_width" else value
        for name, value in law.items()
        if feedback == "output" or not name.startswith("rho_")
    }
    return of(close(plant, controller, given))


FORMS = [("state", 2, 2), ("state", 3, 2), ("output", 2, 0), ("output", 2, 1), ("output", 3, 1)]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("law", CLAIMS)
def test_each_law_keeps_its_claim(form, law):
    certificate = robust_certificate(form, CLAIMS[law])
    assert not certificate.search(samples=300, ascents=5).violated


@pytest.mark.parametrize("form", FORMS)
def test_leakage_without_its_residue_is_violated(form):
    certificate = robust_certificate(form, CLAIMS["leakage"])
    terms = dataclasses.replace(certificate.terms, residue=ca.SX(0))
    assert dataclasses.replace(certificate, terms=terms).search(samples=300).violated


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("law", ["switching", "ball", "box"])
def test_the_claim_is_one_for_ell_in_the_set_alone(form, law):
    certificate = robust_certificate(form, CLAIMS[law])

    def far(generator):
        ell = 20 * generator.normal(size=certificate.ell.numel())
        ell[0] = abs(ell[0]) + 1  # Assumption 3
        return ell

    assert dataclasses.replace(certificate, sample_ell=far).search(samples=300).violated


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("law", [{"dead_zone": 0.1}, {"adapt": 0.0}])
def test_dead_zone_and_frozen_estimates_have_no_certificate(form, law):
    certificate = robust_certificate(form, law)
    assert certificate.search(samples=300, ascents=5).violated
    claim = claim_of(certificate.loop.values, "theta_hat", certificate.ell.numel())
    assert "(ell - theta_hat)^T" in claim.leaves_open


@given(seed=seeds, p=st.integers(1, 4))
@settings(max_examples=30)
def test_a_claim_draws_ell_in_its_set(seed, p):
    """`nearest` leaves a point of the set alone, and takes any other into it."""
    rng = np.random.default_rng(seed)
    values = {"projection_ball": 1.0, "projection_box": 1.0, "theta_bound": rng.uniform(0.5, 2)}
    values |= {"theta_half_width": rng.uniform(0.5, 2, p), "theta_center": rng.normal(size=p)}
    claim = claim_of(values, "theta_hat", p)
    inside = claim.nearest(claim.center + 5 * rng.normal(size=p))
    offset = inside - claim.center
    assert np.linalg.norm(offset) <= values["theta_bound"] * (1 + 1e-12)
    assert (np.abs(offset) <= values["theta_half_width"] * (1 + 1e-12)).all()
    assert claim.nearest(inside) == pytest.approx(inside)
