"""The Lyapunov functions of the four designs, as certificates of their closed loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from congelation.errors import InvalidInput
from congelation.theory.adaptation import Claim, claim_of
from congelation.theory.certificate import Certificate, Coordinates, PerturbationSet
from congelation.theory.closed_loop import ClosedLoop
from congelation.theory.gains import filter_norm, filter_riccati, iss_riccati, iss_weight
from congelation.theory.kfilter import KFilter

__all__ = [
    "matched_certificate",
    "output_feedback_certificate",
    "scalar_certificate",
    "state_feedback_certificate",
]

LARGEST_GAP = 0.27847
"""The largest a (1 - tanh a), rounded up."""

Matrix = NDArray[np.float64]
Sampler = Callable[[np.random.Generator], Matrix]


def scalar_certificate(loop: ClosedLoop) -> Certificate:
    """(5): V = x^2/2 + (ell - theta_hat)^2/(2 gamma), claimed V' <= -k_bar x^2.

    Controller 2 is certified too, with ell = inf theta(t): V' = -k_bar x^2 - (theta - ell) x^2.
    """
    x, ell = _state(loop, "x"), _congealed(loop)
    V = x**2 / 2 + _estimation(loop, ell, loop.values["gamma"]) / 2
    claimed = loop.values["k_bar"].item() * x**2
    rate = 2 * loop.values["k_bar"].item()
    return _of_x(loop, ell, V, claimed, _ball(loop, -np.ones(1)), 1, rate, loop.values["gamma"])


def matched_certificate(loop: ClosedLoop) -> Certificate:
    """V = x^T P x + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat), claimed V' <= -x^T Q x.

    Of first order, V' holds 2 P B Delta x^2, so that Controller 2 is certified with an extreme ell.
    """
    x, ell, values = _state(loop, "x"), _congealed(loop), loop.values
    V = _quadratic(values["P"], x) + _estimation(loop, ell, values["Gamma"])
    first_order = None
    if x.numel() == 1:
        (gain,) = loop.controller.gains
        first_order = np.sign(np.asarray(gain.constants["B"], float)).ravel()
    perturbations = _ball(loop, first_order)
    rate = float(np.linalg.eigvals(_inverse(values["P"]) @ values["Q"]).real.min())
    claimed = _quadratic(values["Q"], x)
    return _of_x(loop, ell, V, claimed, perturbations, 2, rate, values["Gamma"])


def state_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """V = |z|^2/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2, V' <= -sum c_i z_i^2 (23).

    A varying gain adds |ell_b| (1/ell_b - rho_hat)^2/(2 gamma) to V, ell_b = sign_b inf |b(t)|,
    and halves c_1 .. c_{n-1}; an unknown radius adds (D - D_hat)^2/(2 gamma_D) to V, where
    D = epsilon^2 delta^2/2; a reference leaves epsilon_r^2 delta^2 |Y|^2/2 of V', Y = [y_r; ..]
    up to order n - 1, and with a varying gain epsilon_b^2 |Y|^2/2, Y up to order n.

    Of first order, V' holds (phibar . Delta) z^2, so that Controller 2 is certified with an extreme
    ell, for which that product is never positive.
    """
    values = loop.values
    _, theta = loop.arguments
    names = [s.variables.name for s in loop.controller.states]
    z, x, theta_hat = (
        loop.bound_signal("controller.z"),
        _state(loop, "x"),
        _state(loop, "theta_hat"),
    )
    n, p = x.numel(), theta_hat.numel()
    known, varying_gain = "delta" in values, "rho_hat" in names
    ell = ca.SX.sym("ell", p + varying_gain + (not known))
    nominal = None
    if loop.controller.Upsilon is not None:  # theta at Delta = 0 is Upsilon(t) vartheta
        nominal = loop.controller.Upsilon @ ell[:p]
        nominal = ca.vertcat(nominal, ell[p]) if varying_gain else nominal
    delta = ca.SX(values["delta"].item()) if known else ell[-1]
    law = claim_of(values, "theta_hat", p)
    difference = ell[:p] - theta_hat
    V = ca.sumsqr(z) / 2 + _quadratic(_inverse(values["Gamma"]), difference) / 2
    rate = np.array(values["c"], dtype=float).ravel()
    claimed, residue = law.decay(ell[:p], theta_hat), law.residue(ell[:p])
    falls = [law.sigma * _smallest(values["Gamma"])]
    drawn = {"z": n, "error": p}
    if not known:
        drawn["D_error"] = 1
    if varying_gain:
        drawn["root"] = 1
    if nominal is not None:
        drawn["t"] = 1
    drawn |= {v.name: v.symbol.numel() for v in loop.external}
    free = {name: ca.SX.sym(name, size) for name, size in drawn.items()}
    solved = {"theta_hat": ell[:p] + free["error"]}

    perturbations, sample = _ball(loop), _within(law)
    if not known:
        D_law = claim_of(values, "D_hat", 1)
        if "epsilon" in values:
            D = values["epsilon"].item() ** 2 * delta**2 / 2
            sample = _with_radius(sample, D_law, values["epsilon"].item())
        else:  # the bound estimator: a (1 - tanh a) is at most LARGEST_GAP
            D, eta = delta, _state(loop, "eta")
            sample = _with_bound(sample, D_law)
            residue += LARGEST_GAP * n * eta * delta
            drawn["root_of_eta"] = 1
            free["root_of_eta"] = ca.SX.sym("root_of_eta")
            solved["eta"] = free["root_of_eta"] ** 2
        D_hat = _state(loop, "D_hat")
        V += (D - D_hat) ** 2 / (2 * values["gamma_D"].item())
        claimed += D_law.decay(D, D_hat)
        residue += D_law.residue(D)
        falls.append(D_law.sigma * values["gamma_D"].item())
        solved["D_hat"] = D + free["D_error"]
    if varying_gain:
        sign, ell_b, rho_hat = values["sign_b"].item(), ell[p], _state(loop, "rho_hat")
        rho_law = claim_of(values, "rho_hat", 1)
        rate[:-1] /= 2
        V += sign * ell_b * (1 / ell_b - rho_hat) ** 2 / (2 * values["gamma"].item())
        claimed += sign * ell_b * rho_law.decay(1 / ell_b, rho_hat)
        residue += sign * ell_b * rho_law.residue(1 / ell_b)
        falls.append(rho_law.sigma * values["gamma"].item())
        solved["rho_hat"] = sign * free["root"] ** 2  # sign_b rho_hat >= 0 for ever
        gain = theta.numel() - 1
        perturbations = replace(
            perturbations, varies=(True,) * gain + (False,), gain=gain, sign=sign
        )
        sample = _with_gain(sample, p, rho_law, sign)
    if nominal is not None:
        solved["t"] = free["t"]
    for v in loop.external:
        yr = v.symbol
        if "epsilon_r" in values:
            residue += values["epsilon_r"].item() ** 2 * delta**2 * ca.sumsqr(yr[:n]) / 2
        if "epsilon_b" in values:
            residue += values["epsilon_b"].item() ** 2 * ca.sumsqr(yr) / 2
        solved[v.name] = free[v.name]
    claimed += ca.sum1(ca.DM(rate) * z**2)

    symbols = [_state(loop, name) for name in solved if name in names]
    symbols += [v.symbol for v in loop.external]
    rows = ca.SX.zeros(n)
    for i in range(n):  # (12): z_i holds x_i with coefficient 1, and no x_j beyond
        (rest,) = ca.substitute([z[i]], [x, *symbols], [rows, *solved.values()])
        rows[i] = free["z"][i] - rest
    X = _stacked(loop, {"x": rows, **solved})
    coordinates = Coordinates(ca.vertcat(*free.values()), X, tuple(drawn.values()))

    if n == 1 and names == ["theta_hat"] and not loop.external:
        (slope_of_x,) = loop.bind([loop.rate[0]])
        (slope,) = ca.substitute([ca.jacobian(slope_of_x, theta)], [x], [1])  # phibar_{1,1}
        perturbations = _ball(loop, np.asarray(ca.DM(slope)).ravel())
    decay = min(2 * float(rate.min()), *falls)
    return Certificate(
        loop, ell, V, claimed, residue, perturbations, sample, coordinates, nominal, decay
    )


def output_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """The function of Proposition 2, with the weight of V_xtilde that the corrected damping needs.

    V = z^T z/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2
    + |b_m| (1/b_m - rho_hat)^2/(2 gamma) + (1 + delta_1/(g delta)) sum_i 1/(4 d_i) V_xtilde,
    where g is the filter's r epsilon; claimed V' <= -sum c_i z_i^2. The printed damping (59) is
    judged by the printed weight, sum_i 1/(4 d_i). Of first order x_tilde does not enter z', so that
    Controller 2 is certified without V_xtilde, with ell_a = inf a(t).
    """
    z, ell, values = loop.bound_signal("controller.z"), _congealed(loop), loop.values
    n = values["k"].size
    m = ell.numel() - n - 1
    names = ("x", "theta_hat", "rho_hat", "eta", "lambda")
    x, theta_hat, rho_hat, eta, lambda_ = (_state(loop, name) for name in names)
    xi, Omega_T = _filter_signals(loop, m)
    V_x_tilde, g = _estimation_error_function(values, n - m)

    known, sum_d = "delta" in values, float(np.sum(1 / (4 * values["d"])))
    constants, delta, delta_1 = ell, 0.0, math.inf
    offset: tuple[float, ...] = ()
    if known:
        delta, delta_1 = values["delta"].item(), values["delta_1"].item()
        corrected = bool(values["corrected"].item()) and delta > 0
        weight = sum_d * (1 + delta_1 / (g * delta) if corrected else 1)
        needed = ca.SX(sum_d * (g * delta + delta_1) ** 2)
        if n == 1 and _free_ell(loop) and not loop.external:
            weight, offset = 0.0, (0.0, min(delta, delta_1))
    else:  # any delta, and delta_1 up to that
        constants = ca.vertcat(ell, ca.SX.sym("delta"))
        weight, needed = sum_d * (1 + 1 / g), sum_d * ((g + 1) * constants[-1]) ** 2
    q = values["q"].item() if "q" in values else 1.0
    if loop.external:
        needed *= 1 + q  # y^2 <= (1 + q) z_1^2 + (1 + 1/q) y_r^2
    sign = values["sign_b_m"].item()
    V = (
        ca.sumsqr(z) / 2
        + _estimation(loop, ell, values["Gamma"]) / 2
        + sign * ell[0] * (1 / ell[0] - rho_hat) ** 2 / (2 * values["gamma"].item())
        + weight * _quadratic(V_x_tilde, x - xi - Omega_T @ ell)  # x_tilde, (39)-(40)
    )
    varies = (False,) * (m + 1) + (True,) * n
    law, rho_law = claim_of(values, "theta_hat", m + 1 + n), claim_of(values, "rho_hat", 1)
    claimed = ca.sum1(ca.DM(values["c"]) * z**2) + law.decay(ell, theta_hat)
    claimed += sign * ell[0] * rho_law.decay(1 / ell[0], rho_hat)
    residue = law.residue(ell) + sign * ell[0] * rho_law.residue(1 / ell[0])
    sample, extra = _with_inverse(law, rho_law, sign), {}
    others = [v.symbol for v in loop.external]
    if not known:
        D_hat, D_law = _state(loop, "D_hat"), claim_of(values, "D_hat", 1)
        V += (needed - D_hat) ** 2 / (2 * values["gamma_D"].item())
        claimed += D_law.decay(needed, D_hat)
        residue += D_law.residue(needed)
        others.append(D_hat)
        scale = math.sqrt(2 * sum_d * (1 + q if loop.external else 1)) * (g + 1)
        sample = _with_radius(sample, D_law, scale)
    for v in loop.external:
        residue += needed / q * v.symbol[0] ** 2
        extra[v.name] = v.symbol.numel()

    # Drawn are z, x_tilde, the errors of the estimates, eta and lambda_1 .. lambda_m. Row 1 of
    # x = xi + Omega^T ell + x_tilde holds lambda_{m+1} with coefficient b_m, and z_i, i >= 2, holds
    # lambda_{m+i} with coefficient 1, (46): they give the rest of lambda one by one, then x.
    drawn = {"z": n - m, "x_tilde": n, "error": m + 1 + n, "rho_error": 1, "eta": n, "lambda": m}
    drawn |= extra if known else {**extra, "D_error": 1}
    free = {name: ca.SX.sym(name, size) for name, size in drawn.items()}
    estimates = [ell + free["error"], 1 / ell[0] + free["rho_error"]]
    full = ca.vertcat(free["lambda"], ca.SX.zeros(n - m))
    state = xi + Omega_T @ ell + free["x_tilde"]
    solved = {v.name: free[v.name] for v in loop.external}
    if not known:
        solved["D_hat"] = needed + free["D_error"]
    y = free["z"][0] + (free["yr"][0] if loop.external else 0)  # (45)
    for i in range(n - m):
        given = [ca.vertcat(y, ca.SX.zeros(n - 1)), *estimates, free["eta"], full]
        unsolved = state[0] - y if i == 0 else z[i]
        (rest,) = ca.substitute(
            [unsolved],
            [x, theta_hat, rho_hat, eta, lambda_, *others],
            [*given, *solved.values()],
        )
        full[m + i] = -rest / ell[0] if i == 0 else free["z"][i] - rest
    (state,) = ca.substitute([state], [eta, lambda_], [free["eta"], full])
    state[0] = y  # to the bit
    drawn_states = [state, *estimates, free["eta"], full]
    X = _stacked(loop, dict(zip(names, drawn_states, strict=True)) | solved)
    return Certificate(
        loop,
        constants,
        V,
        claimed,
        residue,
        PerturbationSet(
            delta, varies, first=m + 1, delta_1=delta_1, offset=offset, free_delta=not known
        ),
        sample,
        Coordinates(ca.vertcat(*free.values()), X, tuple(drawn.values())),
    )


def _filter_signals(loop: ClosedLoop, m: int) -> tuple[ca.SX, ca.SX]:
    """xi and Omega^T of (30), (31)."""
    eta, lambda_ = (loop.state("controller", name) for name in ("eta", "lambda"))
    gains = {g.variables.name: g.variables for g in loop.controller.gains}
    k_filter = KFilter(m, eta, lambda_, gains["k"])
    xi, Omega_T = loop.bind([k_filter.xi, k_filter.Omega_T])
    return xi, Omega_T


def _estimation_error_function(values: Mapping[str, Matrix], rho: int) -> tuple[Matrix, float]:
    """(P, g): V_xtilde = x_tilde^T P x_tilde has V_xtilde' <= -|x_tilde|^2 + g^2 |F^T Delta|^2.

    For the gain of the ISS filter the r^2 X^-1 and r epsilon of (42), b constant; for any other by
    the bounded real lemma, if the filter's norm is at most g.
    """
    k = values["k"].ravel()
    if "filter_gain" in values:
        X, r, g = None, math.nan, values["filter_gain"].item()
    else:
        r, epsilon, Q = _iss_design(values, rho)
        X, g = iss_riccati(r, Q), r * epsilon
    if X is not None and np.allclose(X[:, 0] / 2, k):
        return r**2 * _inverse(X), g
    P = filter_riccati(k, g)
    if P is None:
        raise InvalidInput(
            f"the K-filter lets through more of Delta than the damping counts with, {g:.9g}; "
            f"valid: at least its H-infinity norm, {filter_norm(k).item():.9g}"
        )
    return P, g


def _iss_design(values: Mapping[str, Matrix], rho: int) -> tuple[float, float, Matrix]:
    """r, epsilon (of a) and Q of (41)."""
    n, r = values["k"].size, values["r"].item()
    if "epsilon_b" not in values:
        epsilon = values["epsilon"].item()
        return r, epsilon, iss_weight(n, epsilon)
    epsilon = values["epsilon_a"].item()
    return r, epsilon, iss_weight(n, epsilon, values["epsilon_b"].item(), rho)


def _of_x(
    loop: ClosedLoop,
    ell: ca.SX,
    V: ca.SX,
    claimed: ca.SX,
    perturbations: PerturbationSet,
    leakage: float,
    rate: float,
    Gamma: Matrix,
) -> Certificate:
    """The certificate of a design whose error variables are x; V holds `leakage`/2 of the
    estimation error's square, and falls at `rate` without it."""
    x, theta_hat = _state(loop, "x"), _state(loop, "theta_hat")
    law = claim_of(loop.values, "theta_hat", theta_hat.numel())
    drawn, error = ca.SX.sym("x", x.numel()), ca.SX.sym("error", theta_hat.numel())
    X = _stacked(loop, {"x": drawn, "theta_hat": ell + error})
    return Certificate(
        loop,
        ell,
        V,
        claimed + leakage * law.decay(ell, theta_hat),
        leakage * law.residue(ell),
        perturbations,
        _within(law),
        Coordinates(ca.vertcat(drawn, error), X, (drawn.numel(), error.numel())),
        decay=min(rate, law.sigma * _smallest(Gamma)),
    )


def _smallest(Gamma: Matrix) -> float:
    """The smallest eigenvalue: sigma times it is the rate at which leakage alone lets V fall."""
    return float(np.linalg.eigvalsh(np.atleast_2d(Gamma)).min())


def _stacked(loop: ClosedLoop, values: Mapping[str, ca.SX]) -> ca.SX:
    """The states of the loop in its order, from expressions by name."""
    states = [s.variables.name for s in (*loop.plant.states, *loop.controller.states)]
    states += [v.name for v in loop.external]
    return ca.densify(ca.vertcat(*(values[name] for name in states)))


def _congealed(loop: ClosedLoop) -> ca.SX:
    _, theta = loop.arguments
    return ca.SX.sym("ell", theta.numel())


def _estimation(loop: ClosedLoop, ell: ca.SX, Gamma: Matrix) -> ca.SX:
    """(ell - theta_hat)^T Gamma^-1 (ell - theta_hat)."""
    return _quadratic(_inverse(Gamma), ell - _state(loop, "theta_hat"))


def _quadratic(P: Matrix, v: ca.SX) -> ca.SX:
    return v.T @ ca.DM(P) @ v


def _inverse(P: Matrix) -> Matrix:
    return np.asarray(np.linalg.inv(P), dtype=float)


def _state(loop: ClosedLoop, name: str) -> ca.SX:
    side = "plant" if name == "x" else "controller"
    return loop.state(side, name).symbol


def _ball(loop: ClosedLoop, first_order: Matrix | None = None) -> PerturbationSet:
    """|theta - center| <= delta.

    Where V' holds theta in (first_order . Delta) z^2 alone and ell may be chosen, it is such that
    this product is never positive: center + delta first_order/|first_order|.
    """
    _, theta = loop.arguments
    delta = loop.values["delta"].item() if "delta" in loop.values else 0.0
    free = "delta" not in loop.values
    offset: tuple[float, ...] = ()
    if first_order is not None and first_order.any() and _free_ell(loop):
        offset = tuple(-delta * first_order / np.linalg.norm(first_order))
    return PerturbationSet(delta, (True,) * theta.numel(), offset=offset, free_delta=free)


def _free_ell(loop: ClosedLoop) -> bool:
    """Whether ell need not be the centre of theta(t): without damping it would fail there, and no
    set of the adaptation law has to hold it."""
    law = claim_of(loop.values, "theta_hat", loop.state("controller", "theta_hat").symbol.numel())
    return not loop.values["damping"].item() and not law.restricts


def _within(law: Claim) -> Sampler:
    """Random ell: of any size, or in the set for which the law's claim holds."""

    def sample(generator: np.random.Generator) -> Matrix:
        size = law.center.size
        if not law.restricts:
            return np.asarray(10 ** generator.uniform(-1, 1) * generator.normal(size=size))
        reach = np.minimum(law.half_width, law.bound)
        return law.nearest(law.center + generator.uniform(-1, 1, size) * reach)

    return sample


def _with_radius(sample: Sampler, law: Claim, epsilon: float) -> Sampler:
    """Random ell and delta, the latter of any size for which D is in its law's set."""

    def with_radius(generator: np.random.Generator) -> Matrix:
        ell = sample(generator)
        D = law.nearest(np.array([(epsilon * 10 ** generator.uniform(-1, 1)) ** 2 / 2]))
        return np.append(ell, math.sqrt(2 * max(D.item(), 0.0)) / epsilon)

    return with_radius


def _with_bound(sample: Sampler, law: Claim) -> Sampler:
    """Random ell and delta, the latter in its law's set."""

    def with_bound(generator: np.random.Generator) -> Matrix:
        ell = sample(generator)
        return np.append(ell, law.nearest(np.array([10 ** generator.uniform(-1, 1)])))

    return with_bound


def _with_gain(sample: Sampler, place: int, law: Claim, sign: float) -> Sampler:
    """Random ell with ell_b at `place`, of the known sign, and 1/ell_b in its law's set."""

    def with_gain(generator: np.random.Generator) -> Matrix:
        inverse = law.nearest(np.array([sign * 10 ** generator.uniform(-1, 1)])).item()
        if not inverse * sign > 0:
            raise InvalidInput(
                "no gain of the sign sign_b has its inverse in the set of rho_center; give a set "
                "that holds 1/b"
            )
        return np.insert(sample(generator), place, 1 / inverse)

    return with_gain


def _with_inverse(law: Claim, rho_law: Claim, sign: float) -> Sampler:
    """Random ell with b_m of the known sign (Assumption 3), it and 1/b_m in their laws' sets."""
    reach = min(law.half_width[0], law.bound)
    low, high = sorted((sign * (law.center[0] - reach), sign * (law.center[0] + reach)))
    inverse = min(rho_law.half_width[0], rho_law.bound)
    ends = sorted(sign * (rho_law.center[0] + side * inverse) for side in (-1, 1))
    if ends[1] <= 0 or high <= 0:
        low, high = 1.0, 0.0
    else:  # of |b_m|
        low = max(low, 1 / ends[1])
        high = min(high, 1 / ends[0] if ends[0] > 0 else math.inf)
    if low > high:
        raise InvalidInput(
            "no b_m has the sign sign_b_m, is in the set of theta_center and has 1/b_m in the set "
            "of rho_center; give sets that hold [b, a] and 1/b_m"
        )
    # Without an end the sizes drawn are those about 1 and about the other end.
    low, high = max(low, min(1.0, high) / 10), min(high, max(1.0, low) * 10)
    others = _within(law)

    def sample(generator: np.random.Generator) -> Matrix:
        ell = others(generator)
        ell[0] = sign * np.exp(generator.uniform(np.log(low), np.log(high)))
        rest = ell[1:] - law.center[1:]
        left = math.sqrt(max(law.bound**2 - (ell[0] - law.center[0]) ** 2, 0.0))
        size = float(np.linalg.norm(rest))
        if size > left:
            ell[1:] = law.center[1:] + rest * (left / size)
        return ell

    return sample
