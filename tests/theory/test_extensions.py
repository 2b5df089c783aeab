"""State feedback beyond the paper: reference, varying gain, unknown radius, nonlinear regressors,
structured variations.

V' is that of the closed loop, not of the recursion; what each term of the law is for shows where it
is left out.
"""

import dataclasses
import math
import tomllib

import casadi as ca
import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.theory import output_feedback, state_feedback
from congelation.theory.adaptation import gradient, robust
from congelation.theory.closed_loop import close
from congelation.theory.lyapunov import output_feedback_certificate, state_feedback_certificate
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.options import Options
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.state_feedback import (
    StateFeedbackDesign,
    state_feedback_controller,
    state_feedback_design,
    state_feedback_model,
)
from congelation.theory.strict_feedback import (
    Nonlinear,
    hadamard_defect,
    regressors_of,
    strict_feedback_plant,
)
from congelation.verify.certify import certificate_of, certify, designs_of
from tests.scenarios import ROOT

from .systems import (
    numbers,
    random_output_feedback_parameters,
    random_phibar,
    random_state_feedback_parameters,
)

PLAIN = Options()
TRACKING, GAIN, RADIUS, DISTURBED = (
    Options(tracking=True),
    Options(varying_gain=True),
    Options(unknown_radius=True),
    Options(disturbance=True),
)
EVERY = [
    *(TRACKING, GAIN, RADIUS, DISTURBED),
    Options(tracking=True, varying_gain=True),
    Options(tracking=True, varying_gain=True, unknown_radius=True),
    Options(tracking=True, varying_gain=True, unknown_radius=True, disturbance=True),
]
POLYNOMIAL = Nonlinear((("x[1]**2", "sin(x[1])"), ("x[1]*x[2]", "x[2]**3 + x[1]")))
SMOOTH = Nonlinear(
    (
        ("sin(x[1])", "x[1]"),
        ("x[2]*exp(-x[1]**2/4)", "x[1]*x[2]"),
        ("x[3]*cos(x[1])", "sin(x[2]) + x[3]**2"),
    )
)


def named(options):
    return "+".join(f.name for f in dataclasses.fields(options) if getattr(options, f.name)) or "-"


def random_parameters(rng, n, p, options):
    """Moderate ones: the certificate has to be told from rounding at order 4, too."""
    q = len(options.Upsilon[0]) if options.Upsilon else p
    values = random_state_feedback_parameters(rng, n, q)
    values |= {"epsilon": rng.uniform(0.7, 2), "delta": rng.uniform(0.1, 1)}
    if options.tracking:
        values["epsilon_r"] = rng.uniform(0.7, 2)
    if options.disturbance:
        values["epsilon_d"] = rng.uniform(0.7, 2)
    if options.unknown_radius:
        del values["delta"]
        values["gamma_D"] = rng.uniform(0.1, 3)
    if options.varying_gain:
        values |= {"gamma": rng.uniform(0.1, 3), "sign_b": float(rng.choice([-1, 1]))}
        if options.tracking:
            values["epsilon_b"] = rng.uniform(0.7, 2)
    return values


def closed(phibar, parameters, options, adaptation=gradient):
    plant = strict_feedback_plant(phibar, options.varying_gain, options.disturbance)
    return close(plant, state_feedback_controller(phibar, adaptation, options), parameters)


def random_loop(seed, n, p, options, adaptation=gradient, **parameters):
    rng = np.random.default_rng(seed)
    phibar = random_phibar(rng, n, p)
    return closed(phibar, random_parameters(rng, n, p, options) | parameters, options, adaptation)


@pytest.mark.parametrize("options", EVERY, ids=named)
@pytest.mark.parametrize(("n", "p"), [(1, 1), (1, 2), (2, 2), (3, 2), (4, 2)])
def test_the_claim_holds(n, p, options):
    for seed, parameters in enumerate(({}, {"sigma": 0.4})):
        law = robust if parameters else gradient
        if options.varying_gain:
            parameters = parameters | {"sign_b": (1.0, -1.0)[seed]}
        loop = random_loop(10 * n + seed, n, p, options, law, **parameters)
        finding = state_feedback_certificate(loop).search(150, ascents=2, seed=seed)
        assert not finding.violated, (finding.margin, finding.state)
        assert finding.resolved > 0


@pytest.mark.parametrize("options", [Options(), *EVERY], ids=named)
def test_under_leakage_the_claimed_rate_is_at_least_the_decay_times_V(options):
    certificate = state_feedback_certificate(random_loop(5, 2, 2, options, robust, sigma=0.4))
    rng, ratios = np.random.default_rng(0), []
    for _ in range(300):
        ell = certificate.sample_ell(rng)
        margin = certificate.at(certificate._drawn(certificate.coordinates.draw(rng), ell), ell)
        ratios.append(margin.claimed / (certificate.terms.decay * margin.V))
    assert certificate.terms.decay > 0
    assert min(ratios) >= 1 - 1e-9
    assert min(ratios) < 1.1  # and the decay is not far below what it may be


def test_sets_of_the_laws_keep_the_claim():
    """Projection and switching leakage, for every estimate."""
    options = EVERY[-1]
    for parameters in ({"projection_ball": 1}, {"sigma": 0.5, "switching": 1}):
        sets = {"rho_center": 1.0, "rho_bound": 0.9, "sign_b": 1.0, "D_center": 1.0}
        loop = random_loop(3, 2, 2, options, robust, **parameters, **sets)
        assert not state_feedback_certificate(loop).search(150, ascents=2).violated


@pytest.mark.parametrize("regressors", [POLYNOMIAL, SMOOTH], ids=["n=2", "n=3"])
@pytest.mark.parametrize("options", [Options(), EVERY[-1]], ids=named)
def test_the_claim_holds_for_nonlinear_regressors(regressors, options):
    n, p = regressors.orders
    parameters = random_parameters(np.random.default_rng(n), n, p, options)
    loop = closed(regressors, parameters, options)
    assert not state_feedback_certificate(loop).search(200, ascents=2).violated


# Negative controls: each names a term of the law, and the search finds that it is missing.


def violated(loop):
    return state_feedback_certificate(loop).search(400, ascents=10).violated


@pytest.mark.parametrize(("n", "p"), [(1, 2), (2, 2), (3, 2), (4, 2)])
def test_without_the_damping_of_the_reference_it_fails(monkeypatch, n, p):
    monkeypatch.setattr(
        state_feedback, "reference_damping", lambda symbols, rbar: ca.SX(1, rbar[0].shape[1])
    )
    assert violated(random_loop(n, n, p, TRACKING, delta=2.0, epsilon_r=0.3))


@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_without_the_damping_of_the_disturbance_it_fails(monkeypatch, n, p):
    monkeypatch.setattr(
        state_feedback, "disturbance_damping", lambda symbols, m: ca.SX(1, m[0].shape[1])
    )
    assert violated(random_loop(n, n, p, DISTURBED, epsilon_d=0.3))


def cancel(monkeypatch):
    """u = rho_hat alpha_n, rho_hat' = -gamma sign_b alpha_n z_n, as for a constant gain."""
    monkeypatch.setattr(
        StateFeedbackDesign,
        "kappa",
        property(lambda design: -design.steps[-1].alpha / design.steps[-1].z),
    )


@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_a_control_that_cancels_does_not_stand_a_varying_gain(monkeypatch, n, p):
    cancel(monkeypatch)
    assert violated(random_loop(n, n, p, GAIN))


def test_a_chain_of_three_stands_a_varying_gain(monkeypatch):
    """The chain of specs/chain3.toml with b(t), not a random plant, of both signs."""
    rows = tomllib.loads((ROOT / "specs" / "chain3.toml").read_text())["structure"]["phibar"]
    phibar = np.zeros((3, 3, 2))
    for place, row in rows.items():
        phibar[tuple(int(k) - 1 for k in place.split(","))] = row
    parameters = {"c": np.ones(3), "epsilon": 1.5, "delta": 0.3, "gamma": 1.0}
    for sign in (1.0, -1.0):
        loop = closed(phibar, parameters | {"sign_b": sign}, GAIN)
        assert not state_feedback_certificate(loop).search(150, ascents=2).violated
    cancel(monkeypatch)
    assert violated(closed(phibar, parameters | {"sign_b": 1.0}, GAIN))


@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_an_estimate_of_the_radius_that_does_not_move_is_none(monkeypatch, n, p):
    rates = StateFeedbackDesign.estimate_rates.fget
    monkeypatch.setattr(
        StateFeedbackDesign,
        "estimate_rates",
        property(lambda design: (rates(design)[0], ca.SX(0))),
    )
    assert violated(random_loop(n, n, p, RADIUS))


@pytest.mark.parametrize("regressors", [POLYNOMIAL, SMOOTH], ids=["n=2", "n=3"])
def test_without_damping_nonlinear_regressors_fail(regressors):
    n, p = regressors.orders
    parameters = random_parameters(np.random.default_rng(n), n, p, Options())
    assert violated(closed(regressors, parameters | {"damping": 0.0}, Options()))


# The law against formulas written out by hand.


def test_first_order_by_hand():
    """n = p = 1, x' = b u + phibar x theta + d: every option at once."""
    rng = np.random.default_rng(5)
    phibar, options = 0.7, EVERY[-1]
    model = state_feedback_controller([[[phibar]]], gradient, options)
    v = random_parameters(rng, 1, 1, options)
    c, Gamma, eps, eps_r, eps_b, eps_d = (
        float(np.ravel(v[k])[0])
        for k in ("c", "Gamma", "epsilon", "epsilon_r", "epsilon_b", "epsilon_d")
    )
    for _ in range(20):
        x, theta_hat, D_hat, rho_hat, yr, dyr = rng.normal(size=6)
        state = {"x": x, "theta_hat": theta_hat, "D_hat": D_hat, "rho_hat": rho_hat}
        (u, theta_rate, D_rate, rho_rate) = numbers(
            model,
            [model.output("u"), *(s.rate for s in model.states)],
            {**v, **state, "yr": [yr, dyr]},
        )
        z = x - yr
        f = -c - theta_hat * phibar - D_hat - phibar**2 / (2 * eps**2) - phibar**2 / (2 * eps_r**2)
        f -= 1 / (2 * eps_d**2)
        h = -theta_hat * phibar
        kappa = np.sqrt(1 + f**2) + (h**2 + 1) / (2 * eps_b**2)
        assert u.item() == pytest.approx(-rho_hat * kappa * z)
        assert theta_rate.item() == pytest.approx(Gamma * phibar * x * z)
        assert D_rate.item() == pytest.approx(v["gamma_D"] * z**2)
        assert rho_rate.item() == pytest.approx(v["gamma"] * v["sign_b"] * kappa * z**2)


def test_second_order_tracking_by_hand():
    """System (60) without adaptation of the second kind: x_1' = -theta_1 x_1 + x_2, y_r given."""
    rng = np.random.default_rng(6)
    model = state_feedback_controller(options=TRACKING)
    v = random_parameters(rng, 2, 2, TRACKING)
    c, G = v["c"], v["Gamma"]
    e2, er2, s = v["epsilon"] ** -2, v["epsilon_r"] ** -2, v["epsilon"] ** 2 * v["delta"] ** 2
    for _ in range(20):
        x, theta, (yr, d1, d2) = rng.normal(size=2), rng.normal(size=2), rng.normal(size=3)
        (u,) = numbers(
            model, [model.output("u")], {**v, "x": x, "theta_hat": theta, "yr": [yr, d1, d2]}
        )
        # alpha_1 = -a z_1 + theta_1 x_1, as w_1 = (-x_1, 0) = (-1, 0) z_1 + (-1, 0) y_r
        a = c[0] + (e2 + s + er2) / 2
        z1 = x[0] - yr
        z2 = x[1] - d1 - (-a * z1 + theta[0] * x[0])
        dx, dyr, dtheta = -a + theta[0], a, np.array([x[0], 0.0])
        w1 = np.array([-x[0], 0.0])
        w2 = np.array([0.0, -x[0]]) - dx * w1
        tau = w1 * z1 + w2 * z2
        # Columns of w_2: x_1 = z_1 + y_r alone enters.
        column = np.array([dx, -1.0])
        g12, g22 = column @ np.array([-1.0, 0.0]), column @ column
        zeta = -(e2 + er2) * (g12 * z1 + g22 * z2 / 2) - s * z2 / 2
        alpha = -z1 - c[1] * z2 + dx * x[1] + dyr * d1 - w2 @ theta + dtheta @ G @ tau + zeta
        assert u.item() == pytest.approx(alpha + d2, rel=1e-10)


def test_second_order_disturbance_by_hand():
    """System (60): alpha_1 = -a x_1, so that m_1 = (1, 0) and m_2 = (a, 1)."""
    rng = np.random.default_rng(16)
    plain, damped = (state_feedback_controller(options=o) for o in (Options(), DISTURBED))
    v = random_parameters(rng, 2, 2, DISTURBED)
    with_d = dict(v, c=v["c"])
    del v["epsilon_d"]
    ed2 = with_d["epsilon_d"] ** -2
    e2, s = v["epsilon"] ** -2, v["epsilon"] ** 2 * v["delta"] ** 2
    for _ in range(20):
        x, theta = rng.normal(size=2), rng.normal(size=2)
        state = {"x": x, "theta_hat": theta}
        # zeta^d_1 = -ed2/2 z_1 is that of a larger c_1; zeta^d_2 is what is left in u.
        larger = {**v, "c": v["c"] + np.array([ed2 / 2, 0])}
        (without,) = numbers(plain, [plain.output("u")], {**larger, **state})
        (u,) = numbers(damped, [damped.output("u")], {**with_d, **state})
        slope = v["c"][0] + ed2 / 2 + (e2 + s) / 2 - theta[0]
        z = np.array([x[0], x[1] + slope * x[0]])
        assert (u - without).item() == pytest.approx(
            -ed2 * (slope * z[0] + (slope**2 + 1) * z[1] / 2), rel=1e-8
        )


def test_without_options_the_law_is_the_paper_s():
    """A reference of 0, a radius held at epsilon^2 delta^2/2: the same control."""
    rng = np.random.default_rng(7)
    phibar = random_phibar(rng, 3, 2)
    plain = random_parameters(rng, 3, 2, Options())
    state = {"x": rng.normal(size=3), "theta_hat": rng.normal(size=2)}
    model = state_feedback_controller(phibar)
    (expected,) = numbers(model, [model.output("u")], {**plain, **state})
    model = state_feedback_controller(phibar, options=TRACKING)
    values = {**plain, **state, "epsilon_r": 1e9, "yr": np.zeros(4)}
    assert numbers(model, [model.output("u")], values)[0] == pytest.approx(expected)
    model = state_feedback_controller(phibar, options=RADIUS)
    D = plain["epsilon"] ** 2 * plain["delta"] ** 2 / 2
    values = {**plain, **state, "gamma_D": 1e-12, "D_hat": D}
    assert numbers(model, [model.output("u")], values)[0] == pytest.approx(expected, rel=1e-6)


def test_derivation_at_order_4_of_4_parameters():
    """Every option excludes none but the bound estimator, which excludes two."""
    known = tuple(("1", "sin(3*t)") for _ in range(4))
    estimators = [Options(bound_estimator=True), Options(bound_estimator=True, tracking=True)]
    structured = [dataclasses.replace(options, Upsilon=known) for options in EVERY[-1:]]
    for options in (Options(), *EVERY, *estimators, *structured):
        rng = np.random.default_rng(8)
        model = state_feedback_controller(random_phibar(rng, 4, 4), robust, options)
        assert model.output("u").numel() == 1


# Structured variations: theta(t) = Upsilon(t) vartheta + theta_u(t).


UPSILON = {
    1: (("1", "sin(3*t)"),),
    2: (("1", "sin(3*t)", "0"), ("0", "t", "cos(2*t)")),
    3: (("1", "sin(3*t)"), ("exp(-t**2)", "0"), ("t/(1 + t**2)", "1")),
}


@pytest.mark.parametrize("options", [Options(), *EVERY], ids=named)
@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 3), (4, 2)])
def test_the_claim_holds_for_structured_variations(n, p, options):
    options = dataclasses.replace(options, Upsilon=UPSILON[p])
    law, parameters = (robust, {"sigma": 0.4}) if n == 3 else (gradient, {})
    loop = random_loop(n + p, n, p, options, law, **parameters)
    finding = state_feedback_certificate(loop).search(120, ascents=2)
    assert not finding.violated, (finding.margin, finding.state)
    assert finding.resolved > 0


@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 3)])
def test_known_variations_need_no_damping(n, p):
    """delta = 0 and no damping: the classical law, for any rate of Upsilon(t)."""
    loop = random_loop(n, n, p, Options(Upsilon=UPSILON[p]), delta=0.0, damping=0.0)
    assert not state_feedback_certificate(loop).search(120, ascents=2).violated
    loop = random_loop(n, n, p, Options(Upsilon=UPSILON[p]), delta=1.0, damping=0.0)
    assert violated(loop)


@pytest.mark.parametrize(("n", "p"), [(2, 2), (3, 3)])
def test_the_rate_of_the_known_variations_has_to_be_in_the_law(monkeypatch, n, p):
    """Without d alpha_{i-1}/dt, and its row E_i, V' grows with the rate of Upsilon(t)."""
    gradient_of = state_feedback._gradient

    def without(alpha, *symbols):
        found = gradient_of(alpha, *symbols)
        return found._replace(t=ca.SX(*found.t.shape))

    monkeypatch.setattr(state_feedback, "_gradient", without)
    monkeypatch.setattr(state_feedback, "time_factor", lambda symbols, steps: symbols.row())
    options = Options(Upsilon=(("1", "sin(30*t)"), ("cos(20*t)", "1"), ("0", "sin(9*t)"))[:p])
    assert violated(random_loop(n, n, p, options, delta=0.0, damping=0.0))


def factor_defect():
    """The largest |x - T z| and |w_i - wbar_i z| of a law of order 3, relative to x and w."""
    rng, options = np.random.default_rng(2), Options(Upsilon=UPSILON[2])
    design = state_feedback_design(random_phibar(rng, 3, 2), options=options)
    model = state_feedback_model(design)
    values = random_parameters(rng, 3, 2, options) | {"x": rng.normal(size=3), "t": 0.3}
    values["theta_hat"] = rng.normal(size=3)
    x = ca.vertcat(*(step.T for step in design.steps)) @ design.z
    pairs = [(design.symbols.x.symbol, x), *((s.w, s.wbar @ design.z) for s in design.steps)]
    sides = numbers(model, [side for pair in pairs for side in pair], values)
    return max(
        np.abs(a - b).max() / np.abs(a).max() for a, b in zip(sides[::2], sides[1::2], strict=True)
    )


def test_the_factors_hold_the_rate_of_the_known_variations(monkeypatch):
    """Lemma 1 with the row E_i, which the damping (26) is made of."""
    assert factor_defect() < 1e-12
    monkeypatch.setattr(state_feedback, "time_factor", lambda symbols, steps: symbols.row())
    assert factor_defect() > 1e-3


def test_first_order_structured_variations_by_hand():
    rng, phibar = np.random.default_rng(3), 0.7
    options = Options(Upsilon=(("1", "sin(3*t)"),))
    model = state_feedback_controller([[[phibar]]], options=options)
    v = random_parameters(rng, 1, 1, options)
    c, eps, delta = (float(np.ravel(v[k])[0]) for k in ("c", "epsilon", "delta"))
    for _ in range(20):
        x, t = rng.normal(size=2)
        estimate, Upsilon = rng.normal(size=2), np.array([1, np.sin(3 * t)])
        state = {"x": x, "theta_hat": estimate, "t": t}
        u, rate, clock = numbers(
            model, [model.output("u"), *(s.rate for s in model.states)], {**v, **state}
        )
        damping = phibar**2 / (2 * eps**2) + eps**2 * delta**2 / 2
        assert u.item() == pytest.approx(-(c + damping) * x - phibar * x * Upsilon @ estimate)
        assert rate.ravel() == pytest.approx(v["Gamma"] @ Upsilon * phibar * x**2)
        assert clock.item() == 1


STRUCTURES_REFUSED = {
    "rows": ((("1",),), "Upsilon has 1 row of 1 formulas; valid: a row for each of the 2"),
    "lengths": ((("1",), ("1", "t")), "rows of 1, 2 formulas"),
    "no derivative": ((("sqrt(t**2)",), ("1",)), "has not 2 derivatives at t = 0"),
    "pole": ((("1/t",), ("1",)), "has not 2 derivatives at t = 0"),
    "state": ((("x[1]",), ("1",)), r"'x\[1\]' is no formula of numbers, t, "),
    "name": ((("s",), ("1",)), "holds 's'; valid: t and pi"),
    "square wave": ((("sgn(t)",), ("1",)), "holds sgn, which is not smooth"),
}


@pytest.mark.parametrize(
    ("Upsilon", "message"), STRUCTURES_REFUSED.values(), ids=STRUCTURES_REFUSED
)
def test_structures_that_are_refused(Upsilon, message):
    with pytest.raises(InvalidInput, match=message):
        state_feedback_controller(options=Options(Upsilon=Upsilon))


# The bound estimator, a rival.


def estimator_loop(seed, n, p, adaptation=gradient, beside=PLAIN, **parameters):
    rng = np.random.default_rng(seed)
    values = random_state_feedback_parameters(rng, n, p)
    values = {k: values[k] for k in ("c", "Gamma", "damping")} | {"gamma_D": 1.3}
    options = dataclasses.replace(beside, bound_estimator=True)
    return closed(random_phibar(rng, n, p), values | parameters, options, adaptation)


@pytest.mark.parametrize("beside", [Options(), Options(tracking=True, disturbance=True)], ids=named)
@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 2), (3, 3)])
def test_the_claim_of_the_bound_estimator_holds(n, p, beside):
    for law, parameters in ((gradient, {"decay": 0.5}), (robust, {"sigma": 0.3})):
        loop = estimator_loop(n + p, n, p, law, beside, **parameters)
        finding = state_feedback_certificate(loop).search(150, ascents=2)
        assert not finding.violated, (finding.margin, finding.state)
        assert finding.resolved > 50


@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 2), (3, 2)])
def test_without_its_estimate_the_bound_estimator_fails(n, p):
    assert violated(estimator_loop(n + p, n, p, damping=0.0))


def test_the_width_of_the_bound_estimator_has_to_fall_in_its_law(monkeypatch):
    """Without (d alpha/d eta) eta' in alpha_i V' grows with the rate of eta."""
    gradient_of = state_feedback._gradient

    def without(alpha, *symbols):
        found = gradient_of(alpha, *symbols)
        return found._replace(eta=ca.SX(*found.eta.shape))

    monkeypatch.setattr(state_feedback, "_gradient", without)
    assert violated(estimator_loop(4, 2, 2, decay=50.0))


def test_first_order_bound_estimator_by_hand():
    rng, phibar = np.random.default_rng(9), 0.7
    model = state_feedback_controller([[[phibar]]], options=Options(bound_estimator=True))
    v = {"c": 1.2, "Gamma": 0.8, "gamma_D": 1.7, "decay": 0.4, "damping": 1.0}
    for _ in range(20):
        x, theta_hat, D_hat = rng.normal(size=3)
        eta = rng.uniform(0.05, 1)
        state = {"x": x, "theta_hat": theta_hat, "D_hat": D_hat, "eta": eta}
        found = numbers(model, [model.output("u"), *(s.rate for s in model.states)], {**v, **state})
        size = np.sqrt((phibar * x) ** 2 + state_feedback.SMALLEST_SQUARE)
        psi = size * np.tanh(size * x / eta)
        expected = [
            -1.2 * x - phibar * x * theta_hat - psi * D_hat,
            0.8 * phibar * x**2,
            1.7 * psi * x,
            -0.4 * eta,
        ]
        assert [f.item() for f in found] == pytest.approx(expected)


@pytest.mark.parametrize("options", [GAIN, RADIUS], ids=named)
def test_options_that_exclude_the_bound_estimator(options):
    with pytest.raises(InvalidInput, match="excludes gain = 'varying'"):
        state_feedback_controller(options=dataclasses.replace(options, bound_estimator=True))


# Output feedback: tracking, unknown radius, disturbance.


OUTPUT = [
    *(TRACKING, RADIUS, DISTURBED),
    Options(tracking=True, disturbance=True),
    Options(tracking=True, unknown_radius=True, disturbance=True),
]


def random_output_loop(seed, n, m, options, adaptation=gradient, **parameters):
    values = random_output_feedback_parameters(np.random.default_rng(seed), n, m)
    if options.unknown_radius:
        for name in ("delta", "delta_1", "corrected"):
            del values[name]
        values["gamma_D"] = 1.3
    else:
        values |= {"q": 0.7} if options.tracking else {}
        values |= {"q_d": 1.4} if options.disturbance else {}
    controller = output_feedback_controller(n, m, adaptation, options=options)
    plant = observer_form_plant(n, m, options.disturbance)
    return close(plant, controller, values | parameters)


@pytest.mark.parametrize("options", OUTPUT, ids=named)
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
def test_the_claim_holds_for_output_feedback(n, m, options):
    for sign, parameters in ((1.0, {}), (-1.0, {"sigma": 0.3})):
        law = robust if parameters else gradient
        loop = random_output_loop(n + m, n, m, options, law, sign_b_m=sign, **parameters)
        finding = output_feedback_certificate(loop).search(120, ascents=2)
        assert not finding.violated, (finding.margin, finding.state)
        assert finding.resolved >= 5


def output_violated(loop):
    return output_feedback_certificate(loop).search(300, ascents=5).violated


@pytest.mark.parametrize(("n", "m"), [(2, 0), (3, 1), (3, 2)])
def test_output_feedback_without_the_share_of_the_reference_fails(monkeypatch, n, m):
    """The damping without its factor 1 + q; of first order the rest of the law is enough."""
    damping = output_feedback._damping
    monkeypatch.setattr(
        output_feedback,
        "_damping",
        lambda design: damping(design) / (1 + design.symbols.q.symbol),
    )
    assert output_violated(random_output_loop(n + m, n, m, TRACKING, q=3.0))


@pytest.mark.parametrize(("n", "m"), [(2, 0), (2, 1), (3, 1), (3, 2)])
def test_output_feedback_without_the_share_of_the_disturbance_fails(monkeypatch, n, m):
    """The damping without its factor 1 + q_d."""
    damping = output_feedback._damping
    monkeypatch.setattr(
        output_feedback,
        "_damping",
        lambda design: damping(design) / (1 + design.symbols.q_d.symbol),
    )
    assert output_violated(random_output_loop(n + m, n, m, DISTURBED, q_d=3.0))


def test_a_law_without_damping_against_it_is_proved_for_no_disturbance():
    """On a plant with the input d: V' exceeds the claim for d alone."""
    rng = np.random.default_rng(1)
    plant = strict_feedback_plant(disturbance=True)
    values = random_parameters(rng, 2, 2, Options())
    assert violated(close(plant, state_feedback_controller(), values))
    values = random_output_feedback_parameters(rng, 2, 0)
    loop = close(observer_form_plant(2, 0, disturbance=True), output_feedback_controller(), values)
    assert output_violated(loop)


@pytest.mark.parametrize("options", [Options(), *OUTPUT], ids=named)
def test_under_leakage_output_feedback_falls_at_the_decay(options):
    """Half of c_1 pays for the part of V that holds x_tilde; the claim still holds."""
    loop = random_output_loop(4, 2, 0, options, robust, sigma=0.4)
    certificate = output_feedback_certificate(loop)
    rng, ratios = np.random.default_rng(0), []
    for _ in range(300):
        ell = certificate.sample_ell(rng)
        margin = certificate.at(certificate._drawn(certificate.coordinates.draw(rng), ell), ell)
        ratios.append(margin.claimed / (certificate.terms.decay * margin.V))
    assert certificate.terms.decay > 0
    assert min(ratios) >= 1 - 1e-9
    assert min(ratios) < 1.1
    assert not certificate.search(150, ascents=2).violated


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (3, 1), (3, 2)])
def test_output_feedback_needs_the_reference_in_the_law_of_rho_hat(monkeypatch, n, m):
    """rho_hat' = -gamma sgn(b_m) alphabar_1 z_1, as without a reference."""

    def rate(design):
        symbols, law = design.symbols, design.rho_adaptation
        regressor = -symbols.sign_b_m.symbol * design.alphabar_1
        return symbols.gamma.symbol * law.rate(regressor * symbols.z_1)

    monkeypatch.setattr(output_feedback.OutputFeedbackDesign, "rho_hat_rate", property(rate))
    assert output_violated(random_output_loop(n + m, n, m, TRACKING))


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (3, 1), (3, 2)])
def test_output_feedback_without_an_estimate_of_the_radius_fails(monkeypatch, n, m):
    monkeypatch.setattr(
        output_feedback.OutputFeedbackDesign, "D_hat_rate", property(lambda design: ca.SX(0))
    )
    assert output_violated(random_output_loop(n + m, n, m, RADIUS))


def test_first_order_output_feedback_by_hand():
    """n = 1, m = 0: y' = b u - a y, where xi_2 and row 2 of Omega are 0."""
    rng, options = np.random.default_rng(4), OUTPUT[-1]
    model = output_feedback_controller(1, 0, options=options)
    loop = random_output_loop(4, 1, 0, options)
    v = loop.values
    for _ in range(20):
        y, rho_hat, D_hat, eta, lam, yr, dyr = rng.normal(size=7)
        theta_hat = rng.normal(size=2)
        state = {"theta_hat": theta_hat, "rho_hat": rho_hat, "D_hat": D_hat}
        values = {**v, **state, "eta": eta, "lambda": lam, "y": y, "yr": [yr, dyr]}
        (u, *rates) = numbers(
            model, [model.output("u"), *(s.rate for s in model.states[:3])], values
        )
        z = y - yr
        alphabar = -(v["c"] + v["d"] + D_hat).item() * z + y * theta_hat[1]
        assert u.item() == pytest.approx(rho_hat * (alphabar + dyr))
        assert rates[0].ravel() == pytest.approx(v["Gamma"] @ [0, -y * z])
        expected = -v["gamma"].item() * v["sign_b_m"].item() * (alphabar + dyr) * z
        assert rates[1].item() == pytest.approx(expected)
        assert rates[2].item() == pytest.approx(v["gamma_D"].item() * z**2)


def test_output_feedback_refuses_a_varying_gain():
    with pytest.raises(InvalidInput, match="gain = 'varying' has no certificate in output"):
        output_feedback_controller(2, 0, options=GAIN)


# Nonlinear regressors.


def test_hadamard_factors_are_exact_for_polynomials():
    found = regressors_of(Nonlinear((("x[1]**3 - 2*x[1]",),)))
    assert found.nodes == 2
    x = ca.SX.sym("x")
    (factor,) = found.factors(x)
    value = ca.Function("f", [x], [factor])(1.7)
    assert float(value) == pytest.approx(1.7**2 - 2)
    assert regressors_of(SMOOTH).nodes > 2
    assert hadamard_defect(regressors_of(SMOOTH))[1] < 1e-9


def test_hadamard_factors_are_exact_far_from_0_and_smooth_at_0():
    regressors = regressors_of(SMOOTH)
    x = ca.SX.sym("x", 3)
    factors = [ca.densify(factor) for factor in regressors.factors(x)]
    function = ca.Function("f", [x], factors)
    rng = np.random.default_rng(0)
    for size in (1e-3, 0.3, 1, 3, 30, 1000) * 5:
        x_1, x_2, x_3 = at = size * rng.normal(size=3)
        expected = (
            (math.sin(x_1), x_1),
            (x_2 * math.exp(-(x_1**2) / 4), x_1 * x_2),
            (x_3 * math.cos(x_1), math.sin(x_2) + x_3**2),
        )
        for i, (phi, factor) in enumerate(zip(expected, function(at), strict=True), start=1):
            found = np.asarray(factor) @ at[:i]
            assert found == pytest.approx(phi, rel=1e-12, abs=1e-13 * max(size, 1))
    assert float(function(np.array([-31.74, 1, 1]))[0][0, 0]) == pytest.approx(
        math.sin(31.74) / 31.74, rel=1e-12
    )
    second = ca.jacobian(ca.jacobian(ca.vertcat(*map(ca.vec, factors)), x), x)
    assert np.isfinite(np.asarray(ca.Function("f", [x], [second])(np.zeros(3)))).all()


@pytest.mark.parametrize(
    ("text", "x", "factor"),
    [
        ("x[1]**5 + sin(x[1]) - x[1]/3", 30.0, 30.0**4 + math.sin(30.0) / 30 - 1 / 3),
        ("(3*x[1] - x[1]**2)**2*x[1]/pi", 1e4, (3e4 - 1e8) ** 2 / math.pi),
        ("tanh(x[1]/1000)", 1e5, math.tanh(100.0) / 1e5),
        ("exp(x[1]) - 1", -600.0, math.expm1(-600.0) / -600),
        ("x[1]/(4 + x[1]**2)", 1e3, 1 / (4 + 1e6)),
    ],
)
def test_a_factor_of_one_state_is_the_quotient(text, x, factor):
    regressors = regressors_of(Nonlinear(((text,),)))
    symbol = ca.SX.sym("x", 1)
    formula = regressors.factors(symbol)[0]
    assert float(ca.Function("f", [symbol], [formula])(x)) == pytest.approx(factor, rel=1e-11)
    # What is exact by itself is not made longer.
    corrected = formula.n_dep() > 0 and "fmax" in str(formula)
    assert corrected == any(name in text for name in ("sin", "tanh", "exp", "(4"))


FAR_FROM_0 = {  # x, theta_hat, rho_hat, then ell: found by seeds 0 and 4 where quadrature is used
    "x_1 = 11": ((10.656, -23.854, -19080.4, 1080.97, 3.82e-8), (-0.0715, 0.1209, 2.994)),
    "x_1 = 26": ((26.4596, -60.0316, -10020.8, 129.163, 1.23e-3), (-1.0856, -0.4984, 7.607)),
    "x_1 = -32": ((-31.7443, 72.1369, 8008.36, 1869.93, 2.2e-7), (0.1823, -0.1173, 0.5112)),
}


@pytest.mark.parametrize(("state", "ell"), FAR_FROM_0.values(), ids=FAR_FROM_0)
def test_the_pendulum_of_varying_length_keeps_its_promise_far_from_0(state, ell):
    """V' of specs/pendulum_length.toml by hand, where sin(x_1)/x_1 is the factor of phi_2."""
    (design,) = designs_of(ROOT / "specs" / "pendulum_length.toml")
    found = certificate_of(design.loop).at(state, ell)
    (x_1, x_2, *theta_hat, rho_hat), delta = state, 1.06
    theta = np.array(ell) + found.Delta
    assert np.hypot(*found.Delta[:2]) == pytest.approx(delta)
    a = 1 + delta**2 / 2  # alpha_1 = -a x_1
    z_1, z_2 = x_1, x_2 + a * x_1
    phi, ratio = np.array([math.sin(x_1), x_2]), math.sin(x_1) / x_1
    f_1 = -1 + a**2 - theta_hat[0] * ratio + theta_hat[1] * a
    f_2 = -1 - a - theta_hat[1] - (ratio**2 + a**2 + 1 + delta**2) / 2
    kappa = math.sqrt(1 + f_2**2) + f_1**2 / 2
    x_2_rate = phi @ theta[:2] - theta[2] * rho_hat * kappa * z_2
    rate = z_1 * x_2 + z_2 * (x_2_rate + a * x_2) - z_2 * phi @ (np.array(ell[:2]) - theta_hat)
    rate -= abs(ell[2]) * (1 / ell[2] - rho_hat) * kappa * z_2**2
    assert found.rate == pytest.approx(rate, rel=1e-9)
    assert found.claimed == pytest.approx(z_1**2 / 2 + z_2**2)
    assert found.relative < -1e-8
    assert not found.violated


@pytest.mark.parametrize("seed", [0, 4])
def test_no_seed_violates_the_pendulum_of_varying_length(seed):
    (found,) = certify(ROOT / "specs" / "pendulum_length.toml", samples=30, seed=seed)
    assert found.holds


def test_linear_formulas_are_the_linear_plant():
    text = Nonlinear((("-x[1]", "0"), ("0", "-x[1]")))
    rng = np.random.default_rng(0)
    parameters = random_parameters(rng, 2, 2, Options())
    one, other = (closed(r, parameters, Options()) for r in (text, state_feedback.SYSTEM_60))
    X, theta = rng.normal(size=4), rng.normal(size=2)
    assert one.function(X, theta) == pytest.approx(other.function(X, theta))


REFUSED = {
    "x[2]": r"'x\[2\]' holds x\[2\]; valid: x\[1\] to x\[1\]",
    "1 + x[1]": r"phi_1 = 1 \+ x\[1\] is 1 at x = 0; valid: 0 there",
    "cos(x[1])": "is 1 at x = 0",
    "log(x[1])": "at x = 0",
    "abs(x[1])": "holds abs, which is not smooth",
    "sqrt(x[1]**2)": "has no derivative at x = 0",
    "x[1]**0.5": "has no derivative at x = 0",
    "tanh(500*x[1])": "misses its Hadamard factor",
    "sine(x[1])": "'sine'; did you mean 'sin'",
    "y*x[1]": r"holds 'y'; valid: x\[1\] .. x\[1\] and pi",
    "x[1]^2": r"write a power with \*\*",
    "x[1] +": "is no formula",
    "__import__('os').system('ls')": "is no formula",
    "sin(x[1], 2)": "sin takes one argument",
    "True*x[1]": "is no formula",
    "1e999*x[1]": "a number that is not finite",
    "(" * 3000: "3000 characters",
}


@pytest.mark.parametrize(("text", "message"), REFUSED.items(), ids=[k[:20] for k in REFUSED])
def test_formulas_that_are_refused(text, message):
    with pytest.raises(InvalidInput, match=message) as caught:
        regressors_of(Nonlinear(((text,),)))
    assert str(caught.value).endswith("(docs/theory.md, 'Nonlinear regressors')")
