"""The assumptions of the theorems, checked on what is known of theta(t) and of the parameters.

Assumption 1: theta(t) stays in a ball of known radius delta. Assumption 2 (output feedback): so
does a(t), b is constant, and b_m s^m + .. + b_0 is Hurwitz. Assumption 3: the sign of b_m is known.
A law with a set keeps the certificate for ell (and 1/b_m) in that set.

The Lyapunov inequality shows Assumption 1 alone: V' <= -sum c_i z_i^2 holds for a plant with
unstable zeros too, whose state leaves every bound while z tends to 0.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.theory.adaptation import Claim, claim_of

__all__ = ["BALL_ROUNDING", "KnownTheta", "Remark", "remarks_on"]

Vector = NDArray[np.float64]

BALL_ROUNDING = 1e-4
"""Relative excess of a radius over delta that counts as rounding of the written delta."""

ZERO_ROUNDING = 1e-9
"""A zero whose real part is above minus this fraction of its size is not in the left half-plane:
the roots of a polynomial are found to about this accuracy."""

CONSTANT_ROUNDING = 1e-12
"""Relative radius up to which an element is constant: sums of terms are rounded."""


@dataclass(frozen=True)
class Remark:
    """Something about a design that the theorem does not allow, or that nobody can know.

    Attributes
    ----------
    where : str
        The key or variable.
    what, remedy : str
    broken : bool
        Whether an assumption is known to fail; else the remark is a warning.
    excess : float
        Of a radius that is larger than the controller knows: by how much; else 0.
    """

    where: str
    what: str
    remedy: str
    broken: bool
    excess: float = 0.0

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.remedy}"


@dataclass(frozen=True)
class KnownTheta:
    """What is known of theta(t), element by element.

    Attributes
    ----------
    low, high : tuple of float
        Bounds over all time.
    absent : frozenset of int
        Elements (from 0) that have no profile; their bounds are 0.
    unsure : mapping of int to str
        Elements that may leave the bounds, or reach them at times that nobody knows, and why:
        ``is read from a table``.
    driven : frozenset of int
        Those of them to which another component adds what it will: the bounds say nothing.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    absent: frozenset[int] = frozenset()
    unsure: Mapping[int, str] = field(default_factory=dict)
    driven: frozenset[int] = frozenset()

    @property
    def center(self) -> Vector:
        """The centre of the box."""
        return np.array(self.low) / 2 + np.array(self.high) / 2

    @property
    def radii(self) -> Vector:
        """Half the sides of the box."""
        return np.array(self.high) / 2 - np.array(self.low) / 2


def remarks_on(
    values: Mapping[str, ArrayLike],
    theta: KnownTheta,
    degree: int | None,
    place: Callable[[str], str],
    stated: Collection[str] | None = None,
    *,
    varying_gain: bool = False,
    constants: Vector | None = None,
) -> tuple[Remark, ...]:
    """Everything that the theorem of a design does not allow, and what cannot be known.

    Parameters
    ----------
    values : mapping
        The controller's parameters by name.
    theta : KnownTheta
    degree : int or None
        m of the plant (27), whose theta is [b_m .. b_0, a_{n-1} .. a_0]; None: there is no b.
    place : callable
        From ``delta`` or ``theta[2]`` to where the user writes it.
    stated : collection of str, optional
        Names of the parameters that the user gave; None: not known.
    varying_gain : bool
        Whether the last element of theta is an input gain b(t), of which only the sign is known.
    constants : ndarray, optional
        vartheta of structured variations; `theta` then holds what is known of theta_u.

    Returns
    -------
    tuple of Remark
        Broken assumptions first.
    """
    design = _Design(values, theta, degree, place, stated, varying_gain, constants)
    return tuple(sorted(design.remarks(), key=lambda remark: not remark.broken))


@dataclass(frozen=True)
class _Design:
    """A design with what is known of its theta(t), as `remarks_on` takes both."""

    values: Mapping[str, ArrayLike]
    theta: KnownTheta
    degree: int | None
    place: Callable[[str], str]
    stated: Collection[str] | None
    varying_gain: bool
    constants: Vector | None

    @property
    def first(self) -> int:
        """The elements of theta that are b, which come first."""
        return 0 if self.degree is None else self.degree + 1

    @property
    def p(self) -> int:
        """The elements of theta but for an input gain b(t), which comes last."""
        return len(self.theta.low) - self.varying_gain

    def number(self, name: str, otherwise: float | None = None) -> float:
        """A parameter that is one number; `otherwise` where the law has no such parameter."""
        value = self.values[name] if otherwise is None else self.values.get(name, otherwise)
        return float(np.asarray(value, float).item())

    def remarks(self) -> Iterator[Remark]:
        """All of them."""
        theta, first, structured = self.theta, self.first, self.constants is not None
        yield from self._without_profile()
        yield from self._not_known()
        of = "theta_u(t) = theta(t) - Upsilon(t) vartheta" if structured else "theta(t)"
        yield from self._radius("delta", _norm(theta.radii[first : self.p]), of)
        yield from self._sets()
        if self.varying_gain:
            yield from self._gain()
        eta = float(np.asarray(self.values.get("eta0", 1.0), float).ravel()[0])
        if {"gamma_D", "decay"} <= self.values.keys() and not eta > 0:  # the bound estimator
            what = f"{eta:.6g} is no width of the bound estimator's tanh"
            remedy = "give a positive one, such as 0.1"
            yield Remark(self.place("eta0"), what, remedy, broken=True)
        if self.degree is not None:
            of = f"a_(n-1)(t) = theta[{first + 1}]"
            yield from self._radius("delta_1", float(theta.radii[first]), of)
            yield from self._numerator()

    def _without_profile(self) -> Iterator[Remark]:
        names = [f"theta[{j + 1}]" for j in sorted(self.theta.absent)]
        if not names:
            return
        what = "it has no profile, and is 0 throughout"
        if len(names) > 1:
            what = f"it and {', '.join(names[1:])} have no profile, and are 0 throughout"
        yield Remark(
            self.place(names[0]),
            what,
            "give one, such as [{constant = 1.0}], or [{constant = 0.0}] where 0 is meant",
            broken=False,
        )

    def _not_known(self) -> Iterator[Remark]:
        """One warning for all elements whose values cannot be known here."""
        unsure = self.theta.unsure
        if not unsure:
            return
        reasons = ", ".join(f"theta[{j + 1}] {why}" for j, why in sorted(unsure.items()))
        yield Remark(
            self.place(f"theta[{min(unsure) + 1}]"),
            f"that theta(t) keeps to the assumptions cannot be known for sure: {reasons}",
            "keep it within delta of the centre, and b constant and Hurwitz where there is one",
            broken=False,
        )

    def _radius(self, name: str, radius: float, of: str) -> Iterator[Remark]:
        """Assumption 1, or 2: delta against the radius of what varies."""
        if name not in self.values:  # the law does not ask for it
            return
        given = self.number(name)
        outside = not radius <= given * (1.0 + BALL_ROUNDING)
        left_out = self.stated is not None and name not in self.stated
        if not outside and not left_out:
            return
        given_as = f"it is left out, and so {given:.6g}, which" if left_out else f"{given:.6g}"
        compared = "is less than" if outside else "covers"
        side = "box" if name == "delta" else "interval"
        remedy = f"give {name} = {radius:.6g}"
        remedy += ", or narrow the profile" if outside else ", or more"
        if left_out:
            section = "The idea" if self.degree is None else "Output feedback"
            remedy += f" (docs/theory.md, '{section}')"
        yield Remark(
            self.place(name),
            f"{given_as} {compared} {radius:.6g}, the radius of the {side} that {of} fills",
            remedy,
            broken=outside,
            excess=radius - given if outside else 0.0,
        )

    def _numerator(self) -> Iterator[Remark]:
        """Assumptions 2 and 3: b constant, b_m s^m + .. + b_0 Hurwitz, its sign as stated."""
        theta, first = self.theta, self.first
        b, m = theta.center[:first], first - 1
        known = [j for j in range(first) if j not in theta.driven]
        varying = [j for j in known if theta.radii[j] > CONSTANT_ROUNDING * abs(b[j])]
        for j in varying:
            yield Remark(
                self.place(f"theta[{j + 1}]"),
                f"b_{m - j} varies between {theta.low[j]:.6g} and {theta.high[j]:.6g}, and output "
                "feedback is proved for constant b (Assumption 2)",
                f"make it constant, such as [{{constant = {b[j]:.6g}}}]",
                broken=True,
            )
        if len(theta.absent) == len(theta.low):  # nothing is known of b
            return
        sign = self.number("sign_b_m")
        ends = sign * theta.low[0], sign * theta.high[0]
        if 0 in known and min(ends) <= 0:
            opposite = max(ends) < 0
            if opposite:
                actual = "negative" if sign > 0 else "positive"
                what = f"it is {sign:+.0f}, while b_{m} = theta[1] is {actual}, {b[0]:.6g}"
                remedy = f"give sign_b_m = {-sign:.0f}"
            else:
                what = f"b_{m} is 0 or passes through 0, and has no sign"
                remedy = f"give a b_{m} that is not 0, or a form of smaller m"
            where = self.place("sign_b_m" if opposite else "theta[1]")
            yield Remark(where, f"{what} (Assumption 3)", remedy, broken=True)
        zeros = np.roots(b) if len(known) == first and b.any() else np.zeros(0)
        unstable = [s for s in zeros if s.real >= -ZERO_ROUNDING * abs(s)]
        if unstable:
            listed = ", ".join(_complex(s) for s in unstable if s.imag >= 0)
            yield Remark(
                self.place(f"theta[{first}]"),
                f"{_polynomial(b)} is not Hurwitz (Assumption 2): the plant has a zero at "
                f"s = {listed}, so that u and x grow without bound while y tends to 0",
                "give b with all zeros in the open left half-plane, or use state feedback",
                broken=True,
            )

    def _gain(self) -> Iterator[Remark]:
        """b(t), the last element of theta, keeps away from 0 and has the stated sign."""
        theta, p = self.theta, self.p
        sign, start = self.number("sign_b"), self.number("rho_hat0", 0.0)
        if sign * start < 0:
            yield Remark(
                self.place("rho_hat0"),
                f"{start:.6g} has not the sign of b(t), sign_b = {sign:+.0f}, and the law is "
                "proved for estimates of that sign",
                f"give rho_hat0 = 0, or one of the sign {sign:+.0f}",
                broken=True,
            )
        if p in theta.absent or p in theta.driven:
            return
        low, high = theta.low[p], theta.high[p]
        if low <= 0 <= high:
            yield Remark(
                self.place(f"theta[{p + 1}]"),
                f"the input gain b(t) is between {low:.6g} and {high:.6g}, and so may be 0, where "
                "nothing controls the plant (docs/theory.md, 'Varying input gain')",
                "give a profile that keeps away from 0",
                broken=True,
            )
        elif sign * low < 0:
            yield Remark(
                self.place("sign_b"),
                f"it is {sign:+.0f}, while b(t) = theta[{p + 1}] is between {low:.6g} and "
                f"{high:.6g}",
                f"give sign_b = {-sign:.0f}",
                broken=True,
            )

    def _sets(self) -> Iterator[Remark]:
        """The sets of projection and switching leakage have to hold ell, and 1/b_m."""
        theta, first, p, constants = self.theta, self.first, self.p, self.constants
        if len(theta.absent) == len(theta.low):
            return
        law = claim_of(self.values, "theta_hat", p if constants is None else len(constants))
        if constants is not None:
            off = _norm(law.nearest(constants) - constants)
            missed = off > BALL_ROUNDING * (1 + _norm(constants))
            if not law.leaves_open and law.restricts and missed:
                yield self._outside(law, constants, "vartheta")
        elif not law.leaves_open and law.restricts:
            center = theta.center[:p]
            ell = law.nearest(center)
            # Where delta is estimated, a larger one is only a larger estimate.
            delta = self.number("delta", np.inf)
            apart = np.abs(center - ell)
            reach = _norm((apart + theta.radii[:p])[first:])
            if reach > delta * (1 + BALL_ROUNDING) or _norm(apart[:first]) > BALL_ROUNDING:
                yield self._outside(law, center, "the centre of theta(t)")
        if not first:
            return
        rho_law = claim_of(self.values, "rho_hat", 1)
        if theta.center[0] != 0 and rho_law.restricts and not rho_law.leaves_open:
            inverse = np.array([1 / theta.center[0]])
            if _norm(rho_law.nearest(inverse) - inverse) > BALL_ROUNDING * _norm(inverse):
                yield self._outside(rho_law, inverse, f"1/b_{first - 1}")

    def _outside(self, law: Claim, value: Vector, of: str) -> Remark:
        base = law.estimate.removesuffix("_hat")
        needed = np.abs(value - law.center)
        changes = []
        if _norm(needed) > law.bound:
            changes.append(f"{base}_bound = {_norm(needed):.6g} or more")
        if (needed > law.half_width).any():
            own = np.where(np.isfinite(law.half_width), law.half_width, needed)
            widths = np.maximum(needed, own)
            listed = ", ".join(f"{w:.6g}" for w in widths)
            changes.append(f"{base}_half_width = [{listed}] or more")
        listed = ", ".join(f"{v:.6g}" for v in value)
        return Remark(
            self.place(f"{base}_center"),
            f"the set of the adaptation law does not hold {of}, ({listed}), and the certificate "
            "is one for constants in the set",
            f"give {' and '.join(changes)}, or {base}_center = [{listed}]",
            broken=True,
        )


def _norm(v: Vector) -> float:
    return float(np.linalg.norm(v))


def _complex(s: complex) -> str:
    if abs(s.imag) <= ZERO_ROUNDING * abs(s):
        return f"{s.real + 0.0:.6g}"
    real = 0.0 if abs(s.real) <= ZERO_ROUNDING * abs(s) else s.real
    return f"{real:.6g} +- {abs(s.imag):.6g}i"


def _polynomial(b: Vector) -> str:
    """0.5 s - 1."""
    text = ""
    for power, value in zip(range(len(b) - 1, -1, -1), b, strict=True):
        if value == 0 and len(b) > 1:
            continue
        factor = "" if power == 0 else " s" if power == 1 else f" s^{power}"
        lead = ("-" if value < 0 else "") if not text else " - " if value < 0 else " + "
        text += f"{lead}{abs(value):.6g}{factor}"
    return text
