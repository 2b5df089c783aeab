"""The inequality (41) against the equation (43): two ways to the same filters."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from congelation.errors import InfeasibleDesign, InvalidInput
from congelation.theory.iss_riccati import iss_riccati, iss_weight, smallest_feasible_r
from congelation.theory.lmi import iss_lmi, smallest_feasible_r_lmi
from congelation.theory.matrices import filter_matrix, upper_shift

from .systems import random_definite, seeds


def left_side_of_41(X, r, Q):
    S, e_1 = upper_shift(len(X)), np.eye(len(X))[:, :1]
    return S @ X + X @ S.T - X @ (e_1 @ e_1.T - np.eye(len(X)) / r**2) @ X + Q


@pytest.mark.parametrize("Q", [iss_weight(2, 1.0), iss_weight(3, 0.5), iss_weight(3, 1, 0.7, 2)])
def test_smallest_r_of_both_ways(Q):
    assert smallest_feasible_r_lmi(Q) == pytest.approx(smallest_feasible_r(len(Q), Q), rel=1e-4)


@given(n=st.integers(1, 5), seed=seeds)
@settings(max_examples=10)
def test_smallest_r_of_random_weights(n, seed):
    """The semidefinite programme knows nothing of Riccati equations."""
    Q = random_definite(np.random.default_rng(seed), n)
    assert smallest_feasible_r(n, Q) == pytest.approx(smallest_feasible_r_lmi(Q), rel=1e-4)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_least_solution_of_41_is_the_stabilising_one_of_43(n):
    Q = iss_weight(n, 0.8)
    r = 1.5 * smallest_feasible_r(n, Q)
    X, equal = iss_lmi(r, Q), iss_riccati(r, Q)
    assert np.linalg.eigvalsh(X).min() > 0
    assert np.linalg.eigvalsh(left_side_of_41(X, r, Q)).max() < 1e-4 * np.abs(X).max()
    assert pytest.approx(equal, rel=1e-4) == X
    assert np.linalg.eigvals(filter_matrix(X[:, 0] / 2)).real.max() < 0


def test_infeasible_r_is_refused():
    with pytest.raises(InfeasibleDesign, match=r"smallest feasible r is 1\.414"):
        iss_lmi(1.2, iss_weight(2, 1.0))


def test_without_cvxpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(InvalidInput, match=r"congelation\[lmi\]"):
        iss_lmi(5.0, iss_weight(2, 1.0))
