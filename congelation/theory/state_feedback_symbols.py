"""The symbols of state feedback, and what each step of its recursion holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from congelation.theory.model import Variables, matrix, optional, scalar, vector
from congelation.theory.options import Options, reference

__all__ = ["Partial", "StateFeedbackStep", "StateFeedbackSymbols", "Steps"]


@dataclass(frozen=True)
class StateFeedbackSymbols:
    """The symbols that the law is a function of; None where its options have no use for one."""

    x: Variables
    theta_hat: Variables
    c: Variables
    Gamma: Variables
    damping: Variables
    epsilon: Variables | None = None
    delta: Variables | None = None
    yr: Variables | None = None
    epsilon_r: Variables | None = None
    epsilon_d: Variables | None = None
    D_hat: Variables | None = None
    gamma_D: Variables | None = None
    rho_hat: Variables | None = None
    gamma: Variables | None = None
    sign_b: Variables | None = None
    epsilon_b: Variables | None = None
    eta: Variables | None = None
    decay: Variables | None = None
    t: Variables | None = None

    @classmethod
    def of(cls, n: int, p: int, options: Options) -> StateFeedbackSymbols:
        """The symbols of a law."""
        bound, unknown = options.bound_estimator, options.unknown_radius
        gain, tracking, structured = options.varying_gain, options.tracking, bool(options.Upsilon)
        q, about = p, "Estimate of theta, (19)"
        if structured:
            q = len(options.Upsilon[0])
            about = "Estimate of vartheta in theta(t) = Upsilon(t) vartheta + theta_u(t)"
        damping = "the bound is estimated" if bound else "Controller 1, with damping"
        D_hat = "the bound of theta(t) - ell" if bound else "epsilon^2 delta^2 / 2"
        weight = "Weight of the {} in Young's inequality"
        return cls(
            x=vector("x", n, "State x of the plant (9)"),
            theta_hat=vector("theta_hat", q, about),
            c=vector("c", n, "Decay rates c_i of (15)"),
            Gamma=matrix("Gamma", q, q, "Adaptation gain of (19)"),
            damping=scalar("damping", f"True: {damping}; false: Controller 2"),
            epsilon=optional(not bound, "epsilon", "Weight in Young's inequality, (26)"),
            delta=optional(not (bound or unknown), "delta", "Radius of theta(t), Assumption 1"),
            yr=reference(n) if tracking else None,
            epsilon_r=optional(tracking and not bound, "epsilon_r", weight.format("reference")),
            epsilon_d=optional(options.disturbance, "epsilon_d", weight.format("disturbance")),
            D_hat=optional(bound or unknown, "D_hat", f"Estimate of {D_hat}"),
            gamma_D=optional(bound or unknown, "gamma_D", "Adaptation gain of D_hat"),
            rho_hat=optional(gain, "rho_hat", "Estimate of 1/inf |b(t)|, with the sign of b"),
            gamma=optional(gain, "gamma", "Adaptation gain of rho_hat"),
            sign_b=optional(gain, "sign_b", "Sign of the input gain b(t)"),
            epsilon_b=optional(
                gain and tracking, "epsilon_b", "Weight of the reference beside the gain b(t)"
            ),
            eta=optional(bound, "eta", "Width in which tanh stands for a sign"),
            decay=optional(bound, "decay", "Rate at which eta falls, eta' = -decay eta", "1/s"),
            t=optional(structured, "t", "Time, of which Upsilon(t) is a function", "s"),
        )

    @property
    def estimates(self) -> ca.SX:
        """theta_hat, and D_hat where there is one, as one column."""
        groups = (self.theta_hat, self.D_hat)
        return ca.vertcat(*(v.symbol for v in groups if v is not None))

    @property
    def estimate_gain(self) -> ca.SX:
        """Gamma, and gamma_D, as one block diagonal matrix."""
        if self.gamma_D is None:
            return self.Gamma.symbol
        return ca.diagcat(self.Gamma.symbol, self.gamma_D.symbol)

    @property
    def width(self) -> int:
        """The length of rows: they multiply [z; y_r; ..; y_r^(n-1)], or z alone."""
        n = int(self.x.symbol.numel())
        return n if self.yr is None else 2 * n

    def row(self, *elements: int) -> ca.SX:
        """A row with ones at the given places, counted from 0."""
        row = ca.SX(1, self.width)
        for element in elements:
            row[element] = 1
        return row

    def unit(self, i: int) -> ca.SX:
        """x_i - alpha_{i-1} = z_i + y_r^(i-1) as a row, i counted from 1."""
        n = int(self.x.symbol.numel())
        return self.row(i - 1) if self.yr is None else self.row(i - 1, n + i - 1)


class Partial(NamedTuple):
    """The partial derivatives of a virtual control, as rows; empty where there is no symbol."""

    x: ca.SX
    estimates: ca.SX
    yr: ca.SX
    eta: ca.SX
    t: ca.SX


@dataclass(frozen=True)
class StateFeedbackStep:
    """Step i of the recursion. Rows multiply [z; y_r; ..; y_r^(n-1)], of length N.

    Attributes
    ----------
    z, alpha : casadi.SX, (1, 1)
        z_i of (12) and alpha_i of (15).
    m : casadi.SX, (1, n)
        e_i^T - d alpha_{i-1}/dx: z_i' holds m x'.
    w, wbar : casadi.SX, (p, 1), (p, N)
        w_i of (13); column j of wbar is wbar_{i,j} of (25): w_i = wbar [z; y_r; ..].
    v, vbar : casadi.SX, (q, 1), (q, N)
        The regressor of the estimates: w_i, or Upsilon^T w_i with structured variations. With an
        unknown radius both have one row more, the regressor of D_hat.
    tau, slope : casadi.SX, (p, 1)
        tau_i of (14), and the slope of the adaptation law there (v_i for the gradient law).
    mu, zeta : casadi.SX, (1, N)
        The corrections mu_i = mu z of (17), and the damping zeta_i = zeta z of (18).
    dalpha : Partial
        Partial derivatives of alpha_{i-1}; that with respect to y_r .. y_r^(n) has n + 1 columns.
    T : casadi.SX, (1, N)
        x_i = T [z; y_r; ..]; T depends on (x_1 .. x_{i-1}), the estimates and the reference.
    drift : casadi.SX, (1, N)
        (d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) as a row; zero for the gradient law.
    E : casadi.SX, (1, N)
        (d alpha_{i-1}/dt) at constant x, estimates and reference, as a row; zero unless Upsilon(t)
        is known.
    """

    z: ca.SX
    alpha: ca.SX
    m: ca.SX
    w: ca.SX
    wbar: ca.SX
    v: ca.SX
    vbar: ca.SX
    tau: ca.SX
    slope: ca.SX
    mu: ca.SX
    zeta: ca.SX
    dalpha: Partial
    T: ca.SX
    drift: ca.SX
    E: ca.SX


Steps = tuple[StateFeedbackStep, ...]
"""The steps 1, 2, .. of a recursion, as far as it went."""
