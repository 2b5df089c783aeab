"""Plants in parametric strict-feedback form (9), linear and nonlinear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput
from congelation.theory.expressions import parse
from congelation.theory.matrices import upper_shift
from congelation.theory.model import Input, Model, Output, State, scalar, vector
from congelation.theory.options import disturbance as disturbance_of

__all__ = [
    "SYSTEM_60",
    "Linear",
    "Nonlinear",
    "Regressors",
    "checked_phibar",
    "hadamard_defect",
    "regressors_of",
    "strict_feedback_plant",
]

SYSTEM_60 = (((-1.0, 0.0), (0.0, 0.0)), ((0.0, -1.0), (0.0, 0.0)))
"""phibar of the system (60) of Sec. V: x_1' = -theta_1 x_1 + x_2, x_2' = -theta_2 x_1 + u."""

NODES = (2, 4, 8, 12, 16, 24, 32, 48)
"""Numbers of Gauss-Legendre nodes of the Hadamard factor, of which the least that does is taken: N
are exact for polynomials phi_i of degree 2 N, and more make the law longer."""

LARGEST_DEFECT = 1e-9
"""What phi_i - sum_j phibar_{i,j} x_j may amount to, relative to phi_i: it adds |z_i e_i| delta to
V', which then stays within the rounding that the certificate allows."""

REACH = 3.0
"""The defect is checked at random states whose elements are of this size and less."""


def checked_phibar(phibar: ArrayLike) -> NDArray[np.float64]:
    """phibar as an array of shape (n, n, p), refused if it is not lower block triangular.

    Parameters
    ----------
    phibar : array_like, shape (n, n, p)
        phibar[i-1, j-1] is the vector phibar_{i,j} of (10), zero for j > i.
    """
    array = np.asarray(phibar, dtype=float)
    if array.ndim != 3 or array.shape[0] != array.shape[1] or 0 in array.shape:
        raise InvalidInput(f"phibar has shape {array.shape}; valid: (n, n, p) with n, p >= 1")
    if not np.isfinite(array).all():
        raise InvalidInput("phibar has an element that is not finite; valid: finite numbers")
    above = np.argwhere(array.any(axis=2) & ~np.tri(len(array), dtype=bool))
    if above.size:
        i, j = above[0] + 1
        raise InvalidInput(
            f"phibar_{{{i},{j}}} is not zero; valid: zero above the diagonal, because row i of the "
            "strict-feedback form (9) holds x_1 .. x_i only"
        )
    return array


@dataclass(frozen=True)
class Linear:
    """phi_i = sum_{j<=i} phibar_{i,j} x_j, (10).

    Attributes
    ----------
    phibar : ndarray, shape (n, n, p)
        See `checked_phibar`.
    """

    phibar: NDArray[np.float64]

    @property
    def orders(self) -> tuple[int, int]:
        """(n, p)."""
        n, _, p = self.phibar.shape
        return n, p

    def at(self, x: ca.SX) -> tuple[ca.SX, ...]:
        """phi_1(x_1) .. phi_n(x), each of shape (p, 1)."""
        return tuple(factor @ x[: factor.shape[1]] for factor in self.factors(x))

    def factors(self, x: ca.SX) -> tuple[ca.SX | ca.DM, ...]:
        """[phibar_{i,1} .. phibar_{i,i}] for each i, of shape (p, i)."""
        return tuple(ca.DM(row[: i + 1].T) for i, row in enumerate(self.phibar))


@dataclass(frozen=True)
class Nonlinear:
    """phi_i(x_1 .. x_i) smooth, with phi_i(0) = 0.

    Its factors are those of Hadamard's lemma, phibar_{i,j} = int_0^1 (d phi_i/d x_j)(s x) ds, for
    which phi_i(x) = sum_j phibar_{i,j}(x) x_j: a factor for the recursion as constant ones are.
    What the quadrature of the integral misses far from 0 is given back to them (`factors`).

    Parameters
    ----------
    phi : tuple of tuple of str, n of p
        Expressions in ``x[1]`` .. ``x[i]``, see `congelation.theory.expressions.parse`.
    nodes : int
        Of the quadrature; `regressors_of` finds the number.
    """

    phi: tuple[tuple[str, ...], ...]
    nodes: int = NODES[-1]

    @property
    def orders(self) -> tuple[int, int]:
        """(n, p)."""
        return len(self.phi), len(self.phi[0])

    def at(self, x: ca.SX) -> tuple[ca.SX, ...]:
        """phi_1(x_1) .. phi_n(x), each of shape (p, 1)."""
        return tuple(
            ca.vertcat(*(parse(text, x, i) for text in row))
            for i, row in enumerate(self.phi, start=1)
        )

    def factors(self, x: ca.SX) -> tuple[ca.SX | ca.DM, ...]:
        """[phibar_{i,1} .. phibar_{i,i}] for each i, for which phi_i = sum_j phibar_{i,j} x_j.

        The quadrature q_{i,j} of `means` misses phi_i by e = phi_i - sum_j q_{i,j} x_j, which is
        rounding for |x| <= 1 and grows without bound beyond, unless phi_i is a polynomial. With
        q_{i,j} + e x_j / max(|x|^2, 1) nothing is missing where |x| >= 1, and the factor has a
        kink of the size of rounding at |x| = 1. |x| is that of the x_j that are in phi_i.
        """
        factors: list[ca.SX | ca.DM] = []
        for phi, mean in zip(self.at(x), self.means(x), strict=True):
            own = x[: mean.shape[1]]
            for k in range(phi.numel()):
                if _degree(phi[k], x) <= 2 * self.nodes:
                    continue  # the quadrature is exact
                inside = ca.vertcat(*(v if ca.depends_on(phi[k], v) else 0 for v in own.nz))
                missed = phi[k] - mean[k, :] @ own
                mean[k, :] += missed / ca.fmax(ca.sumsqr(inside), 1) * inside.T
            factors.append(mean)
        return tuple(factors)

    def means(self, x: ca.SX) -> list[ca.SX]:
        """The integrals of Hadamard's lemma by Gauss-Legendre quadrature, shaped as `factors`."""
        _, p = self.orders
        nodes, weights = np.polynomial.legendre.leggauss(self.nodes)
        means = []
        for i, phi in enumerate(self.at(x), start=1):
            slope = ca.jacobian(phi, x)[:, :i]
            function = ca.Function("slope", [x], [slope])
            mean = ca.SX(phi.numel(), i)
            for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
                mean += weight * function(node * x)
            # A slope that is constant is its own mean, without the rounding of the sum.
            for k in range(p):
                for j in range(i):
                    if not ca.depends_on(slope[k, j], x):
                        mean[k, j] = slope[k, j]
            means.append(mean)
        return means


Regressors = Linear | Nonlinear


def regressors_of(structure: ArrayLike | Regressors) -> Regressors:
    """The regressors of a plant: themselves, or those of the array phibar; checked.

    Raises
    ------
    InvalidInput
        An array that is no phibar; expressions that are not as many in each row, that are not 0 at
        x = 0, or whose Hadamard factor misses them by more than `LARGEST_DEFECT`.
    """
    if isinstance(structure, Linear):
        return structure
    if not isinstance(structure, Nonlinear):
        return Linear(checked_phibar(structure))
    n, _ = structure.orders
    x = ca.SX.sym("x", n)
    for i, phi in enumerate(structure.at(x), start=1):
        values, slopes = (
            np.asarray(ca.DM(v)).reshape(phi.numel(), -1)
            for v in ca.substitute([phi, ca.densify(ca.jacobian(phi, x))], [x], [ca.SX.zeros(n)])
        )
        for text, value, slope in zip(structure.phi[i - 1], values, slopes, strict=True):
            if not abs(value.item()) <= 0:
                raise InvalidInput(
                    f"phi_{i} = {text} is {value.item():.6g} at x = 0; valid: 0 there, so that "
                    "x = 0 can be kept without knowing theta (docs/theory.md, 'Nonlinear "
                    "regressors')"
                )
            # CasADi makes |x_1| of sqrt(x[1]**2), and gives it the slope 0 at 0.
            if not np.isfinite(slope).all() or "fabs" in str(phi):
                raise InvalidInput(
                    f"phi_{i} = {text} has no derivative at x = 0; the recursion differentiates "
                    "it: give a smooth function (docs/theory.md, 'Nonlinear regressors')"
                )
    for nodes in NODES:
        structure = replace(structure, nodes=nodes)
        i, defect = hadamard_defect(structure)
        if defect <= LARGEST_DEFECT:
            return structure
    raise InvalidInput(
        f"phi_{i} misses its Hadamard factor by {defect:.2g} of its size for |x_j| <= {REACH:g}; "
        f"valid: {LARGEST_DEFECT:g} at most, as the certificate rests on it: give functions that "
        "are smoother there (docs/theory.md, 'Nonlinear regressors')"
    )


def hadamard_defect(regressors: Nonlinear) -> tuple[int, float]:
    """The row i with the largest |phi_i - sum_j q_{i,j} x_j| / (1 + |phi_i|), and that ratio.

    q_{i,j} is the quadrature (`Nonlinear.means`). The largest at 200 random x with
    |x_j| <= `REACH`, nan where something is not finite.
    """
    n, _ = regressors.orders
    x = ca.SX.sym("x", n)
    error = [
        ca.norm_inf(phi - mean @ x[: mean.shape[1]]) / (1 + ca.norm_inf(phi))
        for phi, mean in zip(regressors.at(x), regressors.means(x), strict=True)
    ]
    function = ca.Function("defect", [x], [ca.vertcat(*error)])
    drawn = np.random.default_rng(0).uniform(-REACH, REACH, (200, n))
    found = np.array([np.asarray(function(row)).ravel() for row in drawn]).max(axis=0)
    worst = int(np.argmax(np.where(np.isfinite(found), found, np.inf)))
    return worst + 1, float(found[worst])


def _degree(formula: ca.SX, x: ca.SX) -> float:
    """The degree of a polynomial in x, or a bound of it; infinity for any other function."""
    function = ca.Function("formula", [x], [formula])
    degree, constant, found = dict[int, float](), dict[int, float](), 0.0
    for k in range(function.n_instructions()):
        operation, places = function.instruction_id(k), function.instruction_input(k)
        of = [degree.get(place, 0.0) for place in places]
        if operation == ca.OP_OUTPUT:
            found = of[0]
            continue
        power = constant.get(places[-1], math.nan) if places else math.nan
        (at,) = function.instruction_output(k)
        constant.pop(at, None)  # places are used again
        if operation == ca.OP_CONST:
            degree[at], constant[at] = 0.0, function.instruction_constant(k)
        elif operation == ca.OP_INPUT:
            degree[at] = 1.0
        elif operation in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE):
            degree[at] = max(of)
        elif operation == ca.OP_MUL:
            degree[at] = sum(of)
        elif operation == ca.OP_SQ:
            degree[at] = 2 * of[0]
        elif operation == ca.OP_DIV and of[1] == 0:
            degree[at] = of[0]
        elif operation in (ca.OP_POW, ca.OP_CONSTPOW) and power in range(2 * NODES[-1]):
            degree[at] = of[0] * power
        else:
            degree[at] = math.inf if any(of) else 0.0
    return found


def strict_feedback_plant(
    phibar: ArrayLike | Regressors = SYSTEM_60,
    varying_gain: bool = False,
    disturbance: bool = False,
) -> Model:
    """The plant (9), x' = S x + Phi^T(x) theta + e_n u, for any n and p.

    Parameters
    ----------
    phibar : array_like, shape (n, n, p), or Regressors
        See `regressors_of`.
    varying_gain : bool
        With the input gain b(t), x_n' = b(t) u + .., which is then the last element of theta.
    disturbance : bool
        With the input d, x' = .. + d.
    """
    regressors = regressors_of(phibar)
    n, p = regressors.orders
    x = vector("x", n, "State x of (9)")
    u = scalar("u", "Input u of (9)")
    theta = vector("theta", p, "Unknown parameters theta(t) of (9)")
    gain = ca.SX(1)
    if varying_gain:
        theta = vector("theta", p + 1, "Unknown parameters theta(t) of (9), then the gain b(t)")
        gain = theta.symbol[p]
    Phi = ca.horzcat(*regressors.at(x.symbol))
    e_n = ca.DM(np.eye(n)[:, -1:])
    rate = ca.DM(upper_shift(n)) @ x.symbol + Phi.T @ theta.symbol[:p] + e_n @ (gain * u.symbol)
    inputs = [Input.of(u)]
    if disturbance:
        d = disturbance_of(n)
        inputs.append(Input.of(d, "disturbance"))
        rate += d.symbol
    about = "with the input gain b(t), " if varying_gain else ""
    about += "disturbed, " if disturbance else ""
    return Model(
        name="StrictFeedbackPlant",
        description=f"Plant (9) in parametric strict-feedback form, {about}n = {n}, p = {p}",
        inputs=tuple(inputs),
        states=(State(x, rate, start=(1.0,) + (0.0,) * (n - 1)),),
        parameters=(),
        outputs=(Output(x, differentiated=True),),
        theta=theta,
    )
