"""A rival by output feedback: adaptive high gain on filtered transformations, any n and m.

Reconstructed as a regulator after [13] and [15]; the text of [14] was not at hand. It knows neither
the radius of a(t) nor any bound; b is constant and Hurwitz and the sign of b_m is known. Its gains
have no bound that could be computed beforehand, so no certificate is offered.

References
----------
.. [13] R. Marino and P. Tomei, "Global adaptive output-feedback control of nonlinear systems, part
   I", IEEE Trans. Automat. Contr. 38(1), 1993: filtered transformations.
.. [15] R. Marino and P. Tomei, "Adaptive control of linear time-varying systems", Automatica 39(4),
   2003 (abstract).
"""

from __future__ import annotations

import casadi as ca

from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    Variables,
    control,
    scalar,
    vector,
)
from congelation.theory.observer_form import checked_orders

__all__ = ["filtered_transformation_controller"]


def filtered_transformation_controller(n: int = 2, m: int = 0) -> Model:
    """The regulator for the plant (27), of relative degree rho = n - m.

    Filters mu_i' = -lam_i mu_i + mu_{i+1}, mu_rho = u, make the plant one of relative degree 1 from
    mu_1 to y; backstepping leads from mu_1 to u. With e_1 = y and v_1 = -sign_b_m k_hat y,

        k_hat' = gamma y^2,   e_i = mu_{i-1} - v_{i-1},   h_i = d v_{i-1}/dy,
        q_i = 1 + h_i^2 (1 + k_hat^2),   p_i' = gamma_p q_i e_i^2,
        v_i = lam_{i-1} mu_{i-1} - p_i q_i e_i - [i > 2] e_{i-1} + (what of v_{i-1}' is known),

    2 <= i <= rho, and u = v_rho. The leakage sigma is added to k_hat' and p_i'.

    Parameters
    ----------
    n, m : int
        Order of the plant (27) and degree of its numerator.
    """
    rho = checked_orders(n, m)
    y = scalar("y", "Output y of the plant (27)")
    k_hat = scalar("k_hat", "Gain of y, which grows with it")
    gamma = scalar("gamma", "Adaptation gain of k_hat")
    sigma = scalar("sigma", "Leakage of k_hat and p")
    sign_b_m = scalar("sign_b_m", "Sign of the high-frequency gain b_m")
    parameters = [
        Parameter(gamma, (1.0,), Domain.POSITIVE),
        Parameter(sigma, (0.0,), Domain.NONNEGATIVE),
        Parameter(sign_b_m, (1.0,), Domain.SIGN),
    ]
    k_rate = gamma.symbol * y.symbol**2 - sigma.symbol * k_hat.symbol
    states = [State(k_hat, k_rate, start=(0.0,))]
    e, v = [y.symbol], -sign_b_m.symbol * k_hat.symbol * y.symbol
    if rho > 1:
        mu = vector("mu", rho - 1, "Filter state mu of the transformation")
        p = vector("p", rho - 1, "Gains p_2 .. p_rho, which grow with e_2 .. e_rho")
        lam = vector("lam", rho - 1, "Rates of the filters")
        gamma_p = scalar("gamma_p", "Adaptation gain of p")
        parameters += [
            Parameter(lam, (1.0,) * (rho - 1), Domain.POSITIVE),
            Parameter(gamma_p, (1.0,), Domain.POSITIVE),
        ]
        p_rates: list[ca.SX] = []
        mu_rates = [-lam.symbol[i] * mu.symbol[i] + mu.symbol[i + 1] for i in range(rho - 2)]
        for i in range(2, rho + 1):
            e_i = mu.symbol[i - 2] - v
            h = ca.jacobian(v, y.symbol)
            q = 1 + h**2 * (1 + k_hat.symbol**2)
            # The parts of v_{i-1}' but that of y', which is not known.
            moving = [(k_hat.symbol, k_rate)]
            moving += [(p.symbol[j], rate) for j, rate in enumerate(p_rates)]
            moving += [(mu.symbol[j], mu_rates[j]) for j in range(i - 2)]
            drift = sum((ca.jacobian(v, s) * rate for s, rate in moving), ca.SX(0))
            v = lam.symbol[i - 2] * mu.symbol[i - 2] - p.symbol[i - 2] * q * e_i + drift
            if i > 2:
                v -= e[-1]
            p_rates.append(gamma_p.symbol * q * e_i**2 - sigma.symbol * p.symbol[i - 2])
            e.append(e_i)
        mu_rates.append(-lam.symbol[rho - 2] * mu.symbol[rho - 2] + v)
        zeros = (0.0,) * (rho - 1)
        states.append(State(p, ca.vertcat(*p_rates), start=zeros))
        states.append(State(mu, ca.vertcat(*mu_rates), start=zeros))
    return Model(
        name="FilteredTransformationController",
        description=f"Filtered transformation regulator for the plant (27), n = {n}, m = {m}",
        inputs=(Input.of(y),),
        states=tuple(states),
        parameters=tuple(parameters),
        outputs=(
            control(v, "Control u"),
            *(Output(s.variables) for s in states[:2]),
            Output(Variables("e", ca.vertcat(*e), "Errors e of the backstepping")),
        ),
    )
