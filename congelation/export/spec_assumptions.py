"""What the theorem does not allow of a design that FMUs are to be built of."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from congelation.export.spec import Spec
from congelation.fmi.units import unit_named
from congelation.signals import Profile
from congelation.theory.assumptions import KnownTheta, Remark, remarks_on
from congelation.theory.model import Model

__all__ = [
    "HORIZON",
    "Structured",
    "degree_of",
    "known_theta",
    "of_rest",
    "spec_assumptions",
    "spec_warnings",
    "structured",
]

Floats = NDArray[np.float64]

_UNSURE = {
    "table": "is read from a table, which may be exchanged",
    "telegraph": "has a random term",
    "noise": "has a random term",
}
"""Terms whose values are not in the formula of the profile, and what is said of them."""

HORIZON = 100.0
"""Seconds over which theta(t) is compared with Upsilon(t) vartheta where no stop time is stated."""

FITTED, COMPARED = 400, 8000
"""Times at which vartheta is fitted, and at which the size of the rest is looked at."""

FIT_ROUNDING = 1e-9
"""A rest of this size, relative to theta(t), is the rounding of the fit and not a rest."""


@dataclass(frozen=True)
class Structured:
    """theta(t) = Upsilon(t) vartheta + theta_u(t), with the vartheta that leaves least of theta_u.

    Attributes
    ----------
    vartheta : ndarray, shape (q,)
    radii : ndarray, shape (p,)
        The largest |theta_u| of each element, as far as the times looked at show.
    """

    vartheta: Floats
    radii: Floats


def spec_assumptions(spec: Spec) -> tuple[Remark, ...]:
    """The assumptions that a spec breaks, and what cannot be known of them."""
    profiles = [slots.profile for slots in spec.plant.profiles]
    absent = [j for j in range(len(profiles)) if f"theta[{j + 1}]" not in spec.plant.stated]

    def place(name: str) -> str:
        if name.startswith("theta["):
            return f'plant.profile."{name}"'
        return f"controller.start.{name}"

    model, offsets = spec.controller.model, (0.0,) * len(profiles)
    known = known_theta(profiles, offsets, absent)
    split = structured(model, profiles, offsets)
    return remarks_on(
        model.defaults() | {f"{s.variables.name}0": s.start for s in model.states},
        known if split is None else of_rest(known, split),
        degree_of(spec.form, spec.structure),
        place,
        spec.controller.stated,
        varying_gain=spec.structure.get("gain") == "varying",
        constants=None if split is None else split.vartheta,
    )


def spec_warnings(spec: Spec) -> tuple[str, ...]:
    """One line for each remark on a spec: where, what, and what would do."""
    remarks = tuple(str(remark) for remark in spec_assumptions(spec))
    theta = spec.plant.model.theta
    kinds: dict[tuple[int, ...], dict[float, str]] = {}
    for name in () if theta is None else filter(None, theta.units):
        unit = unit_named(name)
        if unit.exponents is not None:
            kinds.setdefault(unit.exponents, {}).setdefault(unit.factor, name)
    mixed = tuple(
        f"units.theta: {' and '.join(map(repr, same.values()))} measure the same, and delta is the "
        "radius over the numbers of all; give one of them"
        for same in kinds.values()
        if len(same) > 1
    )
    return (*remarks, *mixed)


def degree_of(form: str, structure: Mapping[str, object]) -> int | None:
    """m of the plant (27), or None for the forms that have no b."""
    return int(str(structure["m"])) if form == "observer" else None


def structured(
    controller: Model,
    profiles: Sequence[Profile],
    offsets: Sequence[float],
    start: float = 0.0,
    stop: float = HORIZON,
) -> Structured | None:
    """The split of theta(t) for a law that knows Upsilon(t); None for any other.

    vartheta is the one of the least sum of the largest |theta_u| of each element, by linear
    programming, or by least squares where that leaves nothing.

    Parameters
    ----------
    controller : Model
    profiles, offsets : sequence
        Of each element of the plant's theta, and the constant dtheta added to it.
    start, stop : float
        Seconds.
    """
    if controller.Upsilon is None:
        return None
    (t,) = (s.variables.symbol for s in controller.states if s.variables.name == "t")
    p, q = controller.Upsilon.shape
    function = ca.Function("Upsilon", [t], [ca.densify(controller.Upsilon)])
    # Times at irrational distances, so that no period is met at the same phase again and again.
    times = start + (stop - start) * np.sort(np.arange(COMPARED) * 0.6180339887498949 % 1.0)
    Upsilon = np.array([np.asarray(function(time)).reshape(p, q) for time in times])
    theta = np.array(
        [[profiles[i].value(time) + offsets[i] for i in range(p)] for time in times.tolist()]
    )
    fitted = slice(None, None, COMPARED // FITTED)
    A, b = Upsilon[fitted].reshape(-1, q), theta[fitted].ravel()
    vartheta = np.linalg.lstsq(A, b, rcond=None)[0]
    rest = np.abs(theta - Upsilon @ vartheta).max(axis=0)
    if not (rest > FIT_ROUNDING * (1 + np.abs(theta).max())).any():
        return Structured(vartheta, np.zeros(p))
    # Unknowns: vartheta, then the largest |theta_u| of each element.
    reach = np.tile(np.eye(p), (len(A) // p, 1))
    found = scipy.optimize.linprog(
        np.concatenate([np.zeros(q), np.ones(p)]),
        A_ub=np.block([[A, -reach], [-A, -reach]]),
        b_ub=np.concatenate([b, -b]),
        bounds=[(None, None)] * q + [(0, None)] * p,
    )
    if found.success:
        vartheta = found.x[:q]
    return Structured(vartheta, np.abs(theta - Upsilon @ vartheta).max(axis=0))


def of_rest(known: KnownTheta, split: Structured) -> KnownTheta:
    """What is known of theta_u(t), and of the input gain b(t) where theta ends with one."""
    p = len(split.radii)
    return replace(
        known,
        low=(*(-split.radii).tolist(), *known.low[p:]),
        high=(*split.radii.tolist(), *known.high[p:]),
    )


def known_theta(
    profiles: Sequence[Profile],
    offsets: Sequence[float],
    absent: Collection[int],
    driven: Collection[int] = (),
) -> KnownTheta:
    """What is known of theta(t) from its profiles.

    Parameters
    ----------
    profiles, offsets : sequence
        Of each element, and the constant dtheta added to it.
    absent, driven : collection of int
        Elements (from 0) without a profile, and those whose dtheta comes from another component.
    """
    bounds = [
        (low + offset, high + offset)
        for (low, high), offset in zip((p.bounds() for p in profiles), offsets, strict=True)
    ]
    unsure = {}
    for j, p in enumerate(profiles):
        reasons = [_UNSURE[kind] for kind in _UNSURE if kind in {t.kind for t in p.terms}]
        reasons += ["has an input, dtheta, that another component drives"] if j in driven else []
        if reasons:
            unsure[j] = " and ".join(reasons)
    low, high = zip(*bounds, strict=True) if bounds else ((), ())
    missing = frozenset(absent).difference(driven)
    return KnownTheta(tuple(low), tuple(high), missing, unsure, frozenset(driven))
