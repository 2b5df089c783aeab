"""The symbols of output feedback, and what each step of its recursion holds."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from congelation.theory.model import Variables, matrix, optional, scalar, vector
from congelation.theory.options import Options, reference

__all__ = ["OutputFeedbackStep", "OutputFeedbackSymbols", "Partial"]


@dataclass(frozen=True)
class OutputFeedbackSymbols:
    """The symbols that the law is a function of, beside those of the K-filter.

    None where the options of the law have no use for one.
    """

    y: Variables
    theta_hat: Variables
    rho_hat: Variables
    c: Variables
    d: Variables
    Gamma: Variables
    gamma: Variables
    damping: Variables
    sign_b_m: Variables
    delta: Variables | None = None
    delta_1: Variables | None = None
    corrected: Variables | None = None
    yr: Variables | None = None
    q: Variables | None = None
    q_d: Variables | None = None
    D_hat: Variables | None = None
    gamma_D: Variables | None = None

    @classmethod
    def of(cls, rho: int, q: int, options: Options) -> OutputFeedbackSymbols:
        """The symbols of a law of relative degree rho with q = m + 1 + n parameters."""
        unknown, known = options.unknown_radius, not options.unknown_radius
        corrected = "True: corrected damping; false: as printed in (59)"
        D_hat = "Estimate of the damping that the unknown radius needs"
        weight = "Weight of the {} in Young's inequality"
        return cls(
            y=scalar("y", "Output y of the plant (27)"),
            theta_hat=vector("theta_hat", q, "Estimate of [b, ell_a], (55)"),
            rho_hat=scalar("rho_hat", "Estimate of 1/b_m, (54)"),
            c=vector("c", rho, "Decay rates c_i of (49)-(51)"),
            d=vector("d", rho, "Damping d_i against the estimation error, (49)-(51)"),
            Gamma=matrix("Gamma", q, q, "Adaptation gain of (55)"),
            gamma=scalar("gamma", "Adaptation gain of (54)"),
            damping=scalar("damping", "True: Controller 1, with damping; false: Controller 2"),
            sign_b_m=scalar("sign_b_m", "Sign of the high-frequency gain b_m, Assumption 3"),
            delta=optional(known, "delta", "Radius of a(t), Assumption 2"),
            delta_1=optional(known, "delta_1", "Radius of a_(n-1)(t) alone, at most delta"),
            corrected=optional(known, "corrected", corrected),
            yr=reference(rho) if options.tracking else None,
            q=optional(known and options.tracking, "q", weight.format("reference")),
            q_d=optional(known and options.disturbance, "q_d", weight.format("disturbance")),
            D_hat=optional(unknown, "D_hat", D_hat),
            gamma_D=optional(unknown, "gamma_D", "Adaptation gain of D_hat"),
        )

    @property
    def z_1(self) -> ca.SX:
        """z_1 of (45): y, or y - y_r."""
        y = ca.SX(self.y.symbol)
        return y if self.yr is None else y - self.yr.symbol[0]

    def reference(self, order: int) -> ca.SX:
        """y_r^(order), 0 without a reference."""
        return ca.SX(0) if self.yr is None else self.yr.symbol[order]


@dataclass(frozen=True)
class Partial:
    """The partial derivatives of a virtual control, as rows."""

    y: ca.SX
    eta: ca.SX
    lambda_: ca.SX
    theta_hat: ca.SX
    rho_hat: ca.SX
    D_hat: ca.SX
    yr: ca.SX


@dataclass(frozen=True)
class OutputFeedbackStep:
    """Step i of the recursion.

    Attributes
    ----------
    z, alpha : casadi.SX, (1, 1)
        z_i of (45)-(46), alpha_i of (49)-(51).
    w : casadi.SX, (m + 1 + n, 1)
        Row i of W_theta^T in (57): what multiplies ell - theta_hat in z_i'.
    tau, slope : casadi.SX, (m + 1 + n, 1)
        tau_i of (47)-(48), and the slope of the adaptation law there (w for the gradient law).
    dalpha : Partial
        Partial derivatives of alpha_{i-1}.
    """

    z: ca.SX
    alpha: ca.SX
    w: ca.SX
    tau: ca.SX
    slope: ca.SX
    dalpha: Partial
