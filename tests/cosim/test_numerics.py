"""The pieces that are plain mathematics."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.cosim.broyden import broyden_step, learnt
from congelation.cosim.coupling.points import KEPT, Points
from congelation.cosim.coupling.polynomial import (
    differentiation,
    hermite,
    interpolation,
    matched,
)
from congelation.cosim.exchange import strong_components
from congelation.cosim.step_size import StepSize

coefficients = st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4)
lengths = st.floats(1e-3, 10.0)


def ends(cubic, h):
    slope = cubic.deriv()
    return np.array([cubic(0.0), slope(0.0), cubic(h), slope(h)])


@given(coefficients, lengths)
def test_a_cubic_is_found_from_its_ends(c, h):
    cubic = np.polynomial.Polynomial(c)
    taylor = [cubic.deriv(k)(0.0) if k else cubic(0.0) for k in range(4)]
    scale = np.abs(c) @ np.array([1.0, h, h**2, h**3]) + 1e-300
    found = hermite(h) @ ends(cubic, h)
    assert np.abs(found - taylor) * np.array([1.0, h, h**2, h**3]) == pytest.approx(
        0.0, abs=1e-13 * scale
    )


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    st.floats(1e-2, 10.0),
    st.floats(0.06, 20.0),
)
def test_the_matched_cubic_acts_like_the_quintic(c, h, ratio):
    """Same end, same derivative there, same integral and first moment: all by polynomials."""
    P = np.polynomial.Polynomial
    # In sigma = s / h, so that sizes are comparable.
    quintic = P(c)
    slope = quintic.deriv()
    data = [quintic(0), slope(0) / h, quintic(1), slope(1) / h, quintic(-ratio), slope(-ratio) / h]
    taylor = matched(h, ratio * h) @ data
    cubic = P(taylor * [1.0, h, h**2 / 2.0, h**3 / 6.0])
    # The data far back are large, and weigh little.
    scale = 1e-10 * (1.0 + np.abs(c) @ (1.0 + ratio) ** np.arange(6))
    assert cubic(1) == pytest.approx(quintic(1), abs=scale)
    assert cubic.deriv()(1) == pytest.approx(slope(1), abs=scale)
    for weight in (P([1.0]), P([0.0, 1.0])):
        moment = ((cubic - quintic) * weight).integ()
        assert moment(1) - moment(0) == pytest.approx(0.0, abs=scale)


@pytest.mark.parametrize("rate", [0.1, 1.0, 10.0, 100.0, 1000.0])
@pytest.mark.parametrize("h", [0.5, 0.2])
def test_the_matched_cubic_moves_slow_and_fast_slaves_better_than_the_hermite_cubic(h, rate):
    """x' = rate (u - x), u a sine: what the error of the input does to x after a step."""
    start = 0.3
    u, slope = np.sin, np.cos
    near = [u(start), slope(start), u(start + h), slope(start + h)]
    before = [u(start - h), slope(start - h)]
    s, weight = np.polynomial.legendre.leggauss(200)
    s = (s + 1.0) * h / 2.0
    kernel = weight * h / 2.0 * rate * np.exp(-rate * (h - s))
    powers = np.array([np.ones_like(s), s, s**2 / 2.0, s**3 / 6.0])
    errors = [
        abs(kernel @ (C @ powers - u(start + s)))
        for C in (hermite(h) @ near, matched(h, h) @ [*near, *before])
    ]
    assert errors[1] < errors[0] / 2.0
    if rate * h < 1.0:
        assert errors[1] < errors[0] / 60.0


@given(st.integers(1, 4), st.integers(0, 10**6), st.floats(0.1, 1.5))
def test_a_polynomial_is_extrapolated_from_values_and_derivatives(count, seed, ahead):
    """n nodes carry degree 2 n - 1, here against polynomials of that degree with known roots."""
    generator = np.random.default_rng(seed)
    polynomial = np.polynomial.Polynomial(generator.normal(size=2 * count))
    nodes = -np.arange(count)[::-1] - 0.3 * generator.random(count)
    data = np.concatenate([polynomial(nodes), polynomial.deriv()(nodes)])
    value, slope = interpolation(nodes.tolist(), ahead) @ data
    scale = 1e-10 * np.abs(interpolation(nodes.tolist(), ahead)).max() * np.abs(data).max()
    assert value == pytest.approx(polynomial(ahead), abs=scale)
    assert slope == pytest.approx(polynomial.deriv()(ahead), abs=scale)


def test_one_node_extrapolates_along_its_derivative():
    assert interpolation([0.0], 0.25).tolist() == [[1.0, 0.25], [0.0, 1.0]]


@given(coefficients, st.floats(-1.0, 1.0))
def test_weights_differentiate_cubics_exactly(c, at):
    cubic = np.polynomial.Polynomial(c)
    nodes = np.array([-0.8, -0.3, 0.1, 0.6])
    value, slope = differentiation(nodes, at)
    assert value @ cubic(nodes) == pytest.approx(cubic(at), abs=1e-11)
    assert slope @ cubic(nodes) == pytest.approx(cubic.deriv()(at), abs=1e-11)


def test_points_carry_values_without_derivatives_as_far_as_a_cubic():
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    links = np.array([1])

    def at(time):
        return np.array([[np.nan, cubic(time)], [np.nan, np.nan]])

    points = Points.begun(0.0, at(0.0))
    assert points.predicted(0.0, links)[1] == 0.0
    points = points.followed(0.5, at(0.5))
    slope = (cubic(0.5) - cubic(0.0)) / 0.5
    assert points.predicted(0.5, links)[1] == pytest.approx(slope)
    points = points.followed(0.8, at(0.8))
    start, end = points.slopes(1.0, links, np.array([cubic(1.0)]))
    assert start == pytest.approx(cubic.deriv()(0.8))
    assert end == pytest.approx(cubic.deriv()(1.0))


def test_points_drop_the_oldest_and_are_never_changed():
    first = Points.begun(0.0, np.array([[1.0], [0.5]]))
    kept, table = first, first.table.copy()
    for k in range(1, 5):
        kept = kept.followed(float(k), np.array([[1.0 + k], [0.5]]))
    assert kept.times == (2.0, 3.0, 4.0)
    assert kept.table.shape == (2, KEPT, 1)
    assert kept.now.tolist() == [[5.0], [0.5]]
    assert first.times == (0.0,)
    assert np.array_equal(first.table, table)


@given(st.integers(0, 10**6), st.integers(1, 6), st.floats(0.1, 1e3))
def test_broyden_solves_affine_problems_in_twice_their_size(seed, size, gain):
    generator = np.random.default_rng(seed)
    A = gain * generator.normal(size=(size, size))
    b = generator.normal(size=size)
    solution = np.linalg.solve(np.eye(size) - A, b)
    J, z = np.zeros((size, size)), np.zeros(size)
    r = A @ z + b - z
    for _ in range(2 * size + 1):
        dz = broyden_step(J, r)
        r_before, z = r, z + dz
        r = A @ z + b - z
        J = learnt(J, dz, r - r_before)
    condition = np.linalg.cond(np.eye(size) - A) * (1.0 + gain)
    assert z == pytest.approx(solution, abs=1e-9 * condition * (1.0 + np.abs(solution).max()))


def test_broyden_begins_with_the_plain_iteration_and_keeps_what_it_learnt():
    """G(z) = 12 - 5 z, whose fixed point is 2."""

    def residual(z):
        return 12.0 - 5.0 * z - z

    J, z = np.zeros((1, 1)), np.array([0.0])
    after = z + broyden_step(J, residual(z))
    assert after == 12.0
    J = learnt(J, after - z, residual(after) - residual(z))
    assert J.tolist() == [[-5.0]]
    for start in (1.0, 12.0):
        z = np.array([start])
        assert z + broyden_step(J, residual(z)) == pytest.approx(2.0)


def test_broyden_learns_nothing_from_an_iterate_that_did_not_move():
    J = np.array([[0.5]])
    assert learnt(J, np.zeros(1), np.zeros(1)) is J


def test_broyden_falls_back_to_the_plain_step_where_the_jacobian_is_singular():
    """G(z) = z + 1 has no fixed point."""
    J = learnt(np.zeros((1, 1)), np.array([1.0]), np.array([0.0]))
    assert J.tolist() == [[1.0]]
    assert broyden_step(J, np.array([1.0])).tolist() == [1.0]


@given(st.dictionaries(st.integers(0, 8), st.sets(st.integers(0, 8))))
def test_strong_components_against_reachability(edges):
    nodes = range(9)
    graph = {node: sorted(edges.get(node, ())) for node in nodes}
    reaches = np.eye(9, dtype=bool)
    for _ in nodes:
        for node in nodes:
            for after in graph[node]:
                reaches[node] |= reaches[after]
    components = strong_components(graph)
    assert sorted(node for component in components for node in component) == list(nodes)
    place = {node: k for k, component in enumerate(components) for node in component}
    for a in nodes:
        for b in nodes:
            assert (place[a] == place[b]) == (reaches[a, b] and reaches[b, a])
            if reaches[a, b]:
                assert place[a] <= place[b]


def test_the_step_settles_where_the_error_meets_the_tolerance():
    """error = (h / 0.02)^4: the controller ends a little below h = 0.02, without a rejection."""
    size = StepSize(0.001)
    for _ in range(60):
        error = (size.length / 0.02) ** 4
        assert error <= 1.0
        size = size.accepted(error, size.length, 4)
    assert 0.013 < size.length < 0.02


@given(st.floats(0.0, 1.0))
def test_the_step_does_not_grow_right_after_a_rejection(error):
    size = StepSize(1.0).refused(16.0, 1.0, 4)
    assert size.length == pytest.approx(0.45)
    after = size.accepted(error, size.length, 4)
    assert after.length <= size.length
    assert not after.rejected


@given(st.floats(1.0, 1e9))
def test_a_refused_step_shrinks_within_bounds(error):
    assert 0.2 <= StepSize(1.0).refused(error, 1.0, 4).length <= 0.9
    assert StepSize(1.0).refused(math.inf, 1.0, 4).length == 0.2
