"""The Lyapunov certificate of a run, along its recorded trajectory.

The certificate holds the congealed parameters ell, any point that theta(t) keeps within delta of;
here it is the centre of the box that theta(t) fills. Only Controller 2 of a plant of first order
has its ell elsewhere, at the end of the interval that makes the perturbation stabilising.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from congelation.export.spec_assumptions import structured
from congelation.results.record import Trajectory
from congelation.scenario.parts import Case
from congelation.verify.certify import certificate_of
from congelation.verify.reference import reference

__all__ = [
    "CERTIFICATE",
    "MOST_INTEGRATED",
    "MOST_ROWS",
    "Along",
    "along",
    "loop_states",
    "with_certificate",
]

Floats = npt.NDArray[np.float64]

MOST_ROWS = 1000
"""Rows at which the certificate is evaluated: it takes 20 us at each, a run has 100,000."""

CERTIFICATE = "certificate"
"""Beginning of the names of the certificate's columns."""

MOST_INTEGRATED = 50_000
"""The same for integrals, which need the rows in between."""


@dataclass(frozen=True)
class Along:
    """The certificate at some rows of a run.

    Parameters
    ----------
    time : ndarray, shape (K,)
        Seconds.
    V : ndarray, shape (K,)
        The Lyapunov function.
    margin : ndarray, shape (K,)
        The largest V' that the radii allow plus the claimed rate of decay, relative to the sum of
        the magnitudes of their terms: positive, beyond rounding, where the claim fails.
    rate : ndarray, shape (K,)
        The largest V' that the radii allow.
    claimed, residue : ndarray, shape (K,)
        The claimed rate of decay, and what V' may exceed it by.
    decay : float
        a > 0 where the claimed rate is at least a V; else 0.
    """

    time: Floats
    V: Floats
    margin: Floats
    rate: Floats
    claimed: Floats
    residue: Floats
    decay: float

    @property
    def ultimate(self) -> float:
        """b/a, b the largest residue of the run: what V ends below; nan where a = 0."""
        return float(np.max(self.residue) / self.decay) if self.decay > 0 else float("nan")

    @property
    def ultimate_share(self) -> float:
        """max_t V(t) / (e^(-a t) V(0) + (1 - e^(-a t)) b/a), at most 1 where the certificate holds;
        nan where a = 0."""
        fallen = np.exp(-self.decay * (self.time - self.time[0]))
        bound = fallen * self.V[0] + (1 - fallen) * self.ultimate
        return float(np.max(self.V / bound))

    @property
    def worst(self) -> float:
        """The largest margin."""
        return float(np.max(self.margin))

    @property
    def share(self) -> float:
        """(V(T) + int claimed dt)/(V(0) + int residue dt), which the certificate keeps below 1."""
        spent = self.V[-1] + np.trapezoid(self.claimed, self.time)
        had = self.V[0] + np.trapezoid(self.residue, self.time)
        return float(spent / had) if had > 0 else 0.0


def loop_states(case: Case) -> tuple[str, ...]:
    """The states of the closed loop of a case, as ``component.variable``.

    Raises
    ------
    InvalidInput
        If the system is no loop of a plant and its controller, both from `congelation build`.
    """
    return reference(case).certified_names


def along(
    case: Case, time: Floats, columns: Sequence[str], values: Floats, most: int = MOST_ROWS
) -> Along:
    """Evaluate the certificate along a run, at `most` rows or fewer.

    Parameters
    ----------
    case : Case
    time : ndarray, shape (N,)
    columns : sequence of str
        M names, `loop_states` among them.
    values : ndarray, shape (N, M)
    most : int

    Raises
    ------
    InvalidInput
        If the system is no loop of a plant and its controller, both from `congelation build`.
    """
    found = reference(case)
    certificate = certificate_of(found.certified)
    rows = np.linspace(0, len(time) - 1, min(len(time), most)).round().astype(int)
    picked = [columns.index(name) for name in found.certified_names]
    states = values[rows][:, picked]
    split = structured(
        found.loop.controller,
        found.profiles,
        found.offsets,
        case.experiment.start_time,
        case.experiment.stop_time,
    )
    middle, half = found.center, found.radii
    if split is not None:
        p = len(split.radii)  # b(t) may follow
        middle = np.concatenate([split.vartheta, middle[p:]])
        half = np.concatenate([split.radii, half[p:]])
    ell = certificate.perturbations.ell(middle, half)
    margins = certificate.along(states, ell)
    return Along(
        time[rows],
        np.array([margin.V for margin in margins]),
        np.array([margin.relative for margin in margins]),
        np.array([margin.rate for margin in margins]),
        np.array([margin.claimed for margin in margins]),
        np.array([margin.residue for margin in margins]),
        certificate.terms.decay,
    )


def with_certificate(case: Case, run: Trajectory) -> Trajectory:
    """A run with the columns ``certificate.V``, ``certificate.rate`` and ``certificate.bound``.

    The Lyapunov function, the largest V' that the radii allow, and what the certificate says that
    it is at most: minus the claimed rate, plus the residue.

    Raises
    ------
    InvalidInput
        If the system is no loop of a plant and its controller, both from `congelation build`.
    """
    found = along(case, run.time, run.columns, run.values, len(run.time))
    added = {"V": found.V, "rate": found.rate, "bound": found.residue - found.claimed}
    names = tuple(f"{CERTIFICATE}.{name}" for name in added)
    values = np.column_stack([run.values, *added.values()])
    units = dict(run.units) | dict.fromkeys(names, "")
    return replace(run, columns=(*run.columns, *names), values=values, units=units)
