"""The Python written from an expression graph computes what CasADi computes."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.export.equations import equations_module
from congelation.export.straight_line import Block, constants_and_functions
from congelation.theory.model import Model, Variables
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import strict_feedback_plant

UNARY = (ca.sqrt, ca.exp, ca.log, ca.sin, ca.cos, ca.tan, ca.tanh, ca.fabs, ca.sign)
BINARY = (
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / b,
    lambda a, b: a**b,
    lambda a, b: a**3 - b**2,
    ca.fmin,
    ca.fmax,
    ca.atan2,
    lambda a, b: ca.if_else(a < b, a, b),
    lambda a, b: ca.if_else(ca.logic_and(a <= b, b > 1), 1 / a, -b),
    lambda a, b: -(a - b) * -(b - a) - (-a) ** 2,
)


def written(constants, block):
    """The function of a block, bound to nothing but the standard library."""
    names = [name for name, _ in constants]
    body = [*constants_and_functions(constants, [block]), f"return {block.name}"]
    source = f"def bind({', '.join(names)}):\n" + "\n".join(f"    {line}" for line in body)
    scope = {name: getattr(math, name) for name in dir(math) if not name.startswith("_")}
    exec(source, scope)  # the text under test is a program
    return scope["bind"]


@pytest.mark.parametrize("operation", UNARY)
@given(st.floats(0.1, 5.0))
def test_unary(operation, value):
    x = ca.SX.sym("x")
    block = Block("f", (("x", (x,)),), (operation(x), operation(x * x) + x), "Test.")
    expected = ca.Function("f", [x], [operation(x), operation(x * x) + x])(value)
    np.testing.assert_allclose(written([], block)()((value,)), [float(e) for e in expected])


@pytest.mark.parametrize("operation", BINARY)
@given(st.floats(0.1, 5.0), st.floats(0.1, 5.0))
def test_binary(operation, left, right):
    """With one operand a constant that is bound first, and with both varying."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    expected = float(ca.Function("f", [a, b], [operation(a, b)])(left, right))
    varying = Block("f", (("x", (a, b)),), (operation(a, b),), "Test.")
    fixed = Block("f", (("x", (b,)),), (operation(a, b),), "Test.")
    np.testing.assert_allclose(written([], varying)()((left, right)), [expected])
    np.testing.assert_allclose(written([("a", a)], fixed)(left)((right,)), [expected])


def test_branch_not_taken_may_be_infinite():
    a = ca.SX.sym("a")
    block = Block("f", (("x", (a,)),), (ca.if_else(a > 1e-300, a, 2.0),), "Test.")
    assert written([], block)()((0.0,)) == (2.0,)


def test_free_symbols_are_refused():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    with pytest.raises(RuntimeError, match="free"):
        constants_and_functions([], [Block("f", (("x", (a,)),), (a + b,), "Test.")])


def test_unknown_operations_are_refused():
    a = ca.SX.sym("a")
    with pytest.raises(ValueError, match="no Python form"):
        constants_and_functions([], [Block("f", (("x", (a,)),), (ca.erf(a),), "Test.")])


PHIBAR = np.random.default_rng(3).normal(size=(3, 3, 2)) * np.tril(np.ones((3, 3)))[:, :, None]
MODELS = (
    strict_feedback_plant(PHIBAR),
    state_feedback_controller(PHIBAR),
    output_feedback_controller(2, 0),
    output_feedback_controller(3, 1),
    output_feedback_controller(2, 1),
)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.description)
def test_models(model: Model):
    """Rates, outputs and exact derivatives of whole models, at random points."""
    random = np.random.default_rng(0)
    scope: dict = {}
    exec(equations_module(model), scope)
    values = {name: random.uniform(0.2, 1.0, s.shape) for name, s in model.arguments().items()}
    groups = [p.variables for p in model.parameters] + [g.variables for g in model.gains]
    constants = [x for g in groups for x in values[g.name].ravel()]
    rates, outputs, derivatives, _ = scope["bind"](*constants)
    x = [v for s in model.states for v in values[s.variables.name].ravel()]
    v = [v for i in model.inputs for v in values[i.variables.name].ravel()]
    d = [v for i in model.inputs for v in values[f"der({i.variables.name})"].ravel()]
    theta = [] if model.theta is None else [list(values[model.theta.name].ravel())]
    slopes = [model.total_derivative(y.variables.symbol) for y in model.outputs if y.differentiated]
    compare(model, rates(x, v, *theta), [s.rate for s in model.states], values)
    compare(model, derivatives(x, v, d, *theta), slopes, values)
    shown = [y.variables.symbol for y in model.outputs]
    count = sum(len(Variables("", e, "").elements) for e in shown)
    compare(model, outputs(x, v, *theta)[:count], shown, values)


def compare(model, found, expressions, values):
    expected = np.concatenate([e.ravel() for e in model.evaluate(expressions, values)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_text_needs_nothing_but_math():
    for model in MODELS:
        text = equations_module(model)
        imports = [
            line for line in text.splitlines() if "import" in line and "Generated" not in line
        ]
        assert set(imports) <= {"from __future__ import annotations"} | {
            line for line in imports if line.startswith("from math import ")
        }
