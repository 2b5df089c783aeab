"""The units of a spec's variables, checked against the equations of its form.

The equations are in seconds and convert nothing, so that the units on their two sides have to be
equal, factors included; an angle in rad counts as a number. Of the numbers that a spec gives (A, B,
phibar, constants in phi) nothing says what they measure: 1 and -1 are taken for signs, a term with
any other number is not checked, and neither is one with a variable whose unit is not stated.
"""

from __future__ import annotations

import ast
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from congelation.export.forms import Structure
from congelation.fmi.units import base_unit, factors, unit_of_factors
from congelation.theory.model import Model
from congelation.toml import Section

__all__ = ["read_units"]

Units = Mapping[str, str | list[str]]

Powers = Mapping[str, int]
"""A unit as powers of the names in it: m/s2 as {m: 1, s: -2}."""


class Fit(NamedTuple):
    """What the unit of one variable has to be; None where no stated unit says so."""

    name: str
    unit: Powers | None
    equation: str


def read_units(section: Section, form: str, structure: Structure, *models: Model) -> Units:
    """The units of variables by name; those of theta hold for its estimate too.

    Parameters
    ----------
    section : Section
        The table ``[units]``.
    form, structure
        What the models are derived from.
    models : Model
        Those of the FMUs to build.

    Raises
    ------
    InvalidInput
        An unknown variable or unit, or a unit that the equations of the form do not admit; the
        text says which one they do.
    """
    scalars: dict[str, tuple[str, ...]] = {}
    for model in models:
        groups = [i.variables for i in model.inputs] + [y.variables for y in model.outputs]
        groups += [] if model.profiled is None else [model.profiled]
        scalars.update({v.name: v.names for v in groups})
    units: dict[str, str | list[str]] = {}
    stated: dict[str, str] = {}
    for name, value in section.only(scalars).data.items():
        size = len(scalars[name])
        names = [value] * size if isinstance(value, str) else value
        if not isinstance(names, list) or len(names) != size:
            raise section.wrong(name, f"a unit, or {size} of them")
        names = [str(unit) for unit in names]
        for unit in names:
            section.attempt(name, partial(base_unit, unit or "1"))
        units[name] = value if isinstance(value, str) else names
        stated |= {n: unit for n, unit in zip(scalars[name], names, strict=True) if unit}
    followed: dict[str, str] = {}
    powers = {name: factors(unit) for name, unit in stated.items()}
    for fit in _FITS[form](structure, powers) if form in _FITS else ():
        expected = "" if fit.unit is None else unit_of_factors(fit.unit)
        if fit.unit is not None and fit.name not in stated:
            followed[fit.name] = expected
        elif fit.unit is not None and not _equal(stated[fit.name], expected):
            name = fit.name if fit.name in section.data else fit.name.partition("[")[0]
            shown = "" if name == fit.name else f"{fit.name} "
            raise section.error(
                name,
                f"= '{stated[fit.name]}' does not fit the equation {fit.equation} of the form "
                f"'{form}'; give {shown}the unit '{expected}'",
            )
    if "theta" in units and "theta_hat" in scalars and "Upsilon" not in structure:
        # An input gain b(t) is an element of theta, but none of theta_hat. With Upsilon, estimated
        # is vartheta, whose units are not those of theta.
        shared = units["theta"]
        own = shared if isinstance(shared, str) else shared[: len(scalars["theta_hat"])]
        units = {"theta_hat": own, **units}
    # Where all that a radius is over is measured alike, it is measured so, too. Of the plant (27),
    # delta is that of a, which follows b_m .. b_0.
    before = int(structure["m"]) + 1 if form == "observer" else 0
    of = units.get("theta_hat", "")
    for name, first in (("theta_bound", 0), ("delta", before)):
        alike = {of} if isinstance(of, str) else set(of[first:])
        if len(alike) == 1 and alike != {""} and "Upsilon" not in structure:
            units |= {name: alike.pop()}
    z = scalars.get("z", ())
    if z and all(name in followed for name in z):
        units["z"] = [followed[name] for name in z]
    if stated and form in ("strict-feedback", "observer"):
        units["c"] = "1/s"  # z_i' = -c_i z_i + ..
    for name, source in _FOLLOWERS.items():
        if source in units and name not in scalars:
            units[name] = units[source]
    if form == "reference" and "yr" in units:
        units |= {"q": units["yr"]}
        units |= dict.fromkeys(("r", "offset", "amplitude"), stated["yr[0]"])
    return units


_FOLLOWERS = {
    "theta_center": "theta_hat",
    "theta_half_width": "theta_hat",
    "limit": "y",
    "centre": "y",
    "before": "y",
}
"""Parameters that are measured as a variable is whose unit a spec states."""


def _equal(one: str, other: str) -> bool:
    """Whether two units are the same but for radians."""
    a, b = ({k: v for k, v in base_unit(name).items() if k != "rad"} for name in (one, other))
    sizes = [float(unit.pop("factor", 1.0)) for unit in (a, b)]
    return a == b and math.isclose(*sizes, rel_tol=1e-12)


def _product(*parts: tuple[Powers | None, int]) -> Powers | None:
    """The product of powers of units; None where one of them is not known."""
    found: Counter[str] = Counter()
    for unit, power in parts:
        if unit is None:
            return None
        for name, exponent in unit.items():
            found[name] += power * exponent
    return found


_SECOND: Powers = {"s": 1}


def _rate(unit: Powers | None, order: int = 1) -> Powers | None:
    """The unit of a derivative."""
    return _product((unit, 1), (_SECOND, -order))


def _scalar(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """x' = -theta x + u: (2)."""
    equation = "x' = -theta[1] x + u"
    yield Fit("u", _rate(unit.get("x")), equation)
    yield Fit("theta[1]", _rate({}), equation)


def _matched(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """x' = A x + B (u + theta^T x); a row with one 1 in A and none in B is a chain."""
    for i, (row, b) in enumerate(zip(structure["A"], structure["B"], strict=True), start=1):
        chained = [j for j, a in enumerate(row, start=1) if a != 0.0]
        if len(chained) == 1 and row[chained[0] - 1] == 1.0 and not _any(b):
            j = chained[0]
            yield Fit(f"x[{j}]", _rate(unit.get(f"x[{i}]")), f"x[{i}]' = x[{j}]")
    for j in range(1, len(structure["A"]) + 1):
        expected = _product((unit.get("u"), 1), (unit.get(f"x[{j}]"), -1))
        yield Fit(f"theta[{j}]", expected, "x' = A x + B (u + theta^T x)")


def _any(entry: float | Sequence[float]) -> bool:
    """Whether a number, or one of a row, is not 0."""
    return any(entry) if isinstance(entry, Sequence) else entry != 0.0


def _strict_feedback(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """x_i' = x_{i+1} + phi_i^T theta, with u or b u in place of x_{n+1}: (9)."""
    n, p = int(structure["n"]), int(structure["p"])
    yield from _reference_of("x[1]", n, unit)
    for i in range(1, n):
        yield Fit(f"x[{i + 1}]", _rate(unit.get(f"x[{i}]")), f"x[{i}]' = x[{i + 1}] + ..")
    yield from _disturbed(n, unit)
    last = _rate(unit.get(f"x[{n}]"))
    if structure.get("gain") == "varying":
        b = f"theta[{p + 1}]"
        yield Fit(b, _product((last, 1), (unit.get("u"), -1)), f"x[{n}]' = {b} u + ..")
    else:
        yield Fit("u", last, f"x[{n}]' = u + ..")
    for i in range(1, n + 1):
        for k in range(1, p + 1):
            for term, powers in _regressor(structure, i, k, unit):
                equation = f"x[{i}]' = .. + theta[{k}] {term}"
                yield Fit(f"theta[{k}]", powers, equation)
        yield Fit(f"z[{i}]", unit.get(f"x[{i}]"), f"z[{i}] = x[{i}] - alpha[{i - 1}]")


def _regressor(
    structure: Structure, i: int, k: int, unit: Mapping[str, Powers]
) -> Iterator[tuple[str, Powers | None]]:
    """The terms that theta_k has in the row i, each with the unit that theta_k gets by it."""
    if "phibar" in structure:
        for j in range(1, i + 1):
            if abs(structure["phibar"][i - 1][j - 1][k - 1]) == 1.0:
                yield f"x[{j}]", _rate({}, i - j + 1)  # x_i is in the unit of x_j over s^(i-j)
        return
    text = structure["phi"][i - 1][k - 1]
    of_term = _unit_of(ast.parse(text.strip(), mode="eval").body, unit)
    yield f"({text})", _product((_rate(unit.get(f"x[{i}]")), 1), (of_term, -1))


def _unit_of(node: ast.expr, unit: Mapping[str, Powers]) -> Powers | None:
    """The unit of a formula in x; None where its numbers or functions leave it open."""
    match node:
        case ast.Constant(value=1 | 1.0):
            return {}
        case ast.Subscript():
            return unit.get(ast.unparse(node))
        case ast.UnaryOp(operand=operand):
            return _unit_of(operand, unit)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            power = 1 if isinstance(op, ast.Mult) else -1
            return _product((_unit_of(left, unit), 1), (_unit_of(right, unit), power))
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))):
            return _product((_unit_of(left, unit), power))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            sides = [_unit_of(side, unit) for side in (left, right)]
            same = None not in sides and Counter(sides[0]) == Counter(sides[1])
            return sides[0] if same else None
        case ast.Call(args=[argument]):  # sin(x[1]) of an angle is a number
            found = _unit_of(argument, unit)
            plain = found is not None and _equal(unit_of_factors(found), "1")
            return {} if plain else None
        case _:
            return None


def _observer(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """x_i' = x_{i+1} - a_{n-i} y, and from i = rho = n - m on + b_{n-i} u; y = x_1: (27)."""
    n, m = int(structure["n"]), int(structure["m"])
    rho, u = n - m, unit.get("u")
    y = unit.get("y", unit.get("x[1]"))
    yield Fit("x[1]", y, "y = x[1]")
    yield from _disturbed(n, unit)
    yield from _reference_of("y", rho, {**unit, **({} if y is None else {"y": y})})
    for i in range(1, n):
        yield Fit(f"x[{i + 1}]", _rate(y, i), f"x[{i}]' = x[{i + 1}] + ..")
    for j in range(m + 1):
        row, b = rho + j, f"theta[{j + 1}]"
        yield Fit(b, _product((_rate(y, row), 1), (u, -1)), f"x[{row}]' = {b} u + ..")
    for i in range(1, n + 1):
        a = f"theta[{m + 1 + i}]"
        yield Fit(a, _rate({}, i), f"x[{i}]' = .. - {a} y")
    yield Fit("rho_hat", _product((u, 1), (_rate(y, rho), -1)), "rho = 1/theta[1]")
    yield Fit("z[1]", y, "z[1] = y - ..")
    for i in range(2, rho + 1):  # of the input, filtered
        yield Fit(f"z[{i}]", _rate(u, i - rho - 1), f"z[{i}] = v[{i}] - alpha[{i - 1}]")


def _reference_of(name: str, order: int, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """The reference that an output follows, and its derivatives."""
    for k in range(order + 1):
        yield Fit(f"yr[{k}]", _rate(unit.get(name), k), f"yr[{k}] = d^{k} {name} / dt^{k}")


def _disturbed(n: int, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """What is added to x'."""
    for i in range(1, n + 1):
        yield Fit(f"d[{i}]", _rate(unit.get(f"x[{i}]")), f"x[{i}]' = .. + d[{i}]")


def _reference(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """yr[k] is the k-th derivative of yr[0]."""
    yield Fit("r", unit.get("yr[0]"), "yr[0] = offset + r, filtered")
    yield from _reference_of("yr[0]", int(structure["n"]), unit)


def _passing(structure: Structure, unit: Mapping[str, Powers]) -> Iterator[Fit]:
    """y = u, changed by what is of the same unit."""
    for i in range(1, int(structure["size"]) + 1):
        for name in (f"y[{i}]", f"n[{i}]"):
            yield Fit(name, unit.get(f"u[{i}]"), f"y[{i}] = u[{i}] + ..")


_FITS = {
    "scalar": _scalar,
    "matched": _matched,
    "strict-feedback": _strict_feedback,
    "observer": _observer,
    "reference": _reference,
    "noise": _passing,
    "saturation": _passing,
    "delay": _passing,
}
