"""One Dormand-Prince step written out for a given number of states and inputs.

The FMU's integrator (fmu_src/_shared/integrator.py) calls it in its step-size control. Written
out, a step costs its six evaluations of the rates and little else.
"""

from __future__ import annotations

__all__ = ["dormand_prince_step"]

# J. R. Dormand and P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl.
# Math. 6 (1980) 19-26: nodes c_i, coefficients a_ij (the last row is b, order 5) and the
# coefficients e = b - b_hat of the error estimate (order 4).
_C = ("1/5", "3/10", "4/5", "8/9", "1", "1")
_A = (
    ("1/5",),
    ("3/40", "9/40"),
    ("44/45", "-56/15", "32/9"),
    ("19372/6561", "-25360/2187", "64448/6561", "-212/729"),
    ("9017/3168", "-355/33", "46732/5247", "49/176", "-5103/18656"),
    ("35/384", "0", "500/1113", "125/192", "-2187/6784", "11/84"),
)
_E = ("71/57600", "0", "-71/16695", "71/1920", "-17253/339200", "22/525", "-1/40")


def dormand_prince_step(states: int, inputs: int, varying: bool) -> list[str]:
    """Source lines of ``step(t, s, h, x, k, v, theta, absolute, relative)``.

    Parameters
    ----------
    states : int
        Number of states n, at least 1.
    inputs : int
        Number of inputs; each is a cubic in the time s since the last communication point.
    varying : bool
        Whether the rates also take theta(t), given as a function of time.

    Returns
    -------
    list of str
        The step returns (x at s + h, rates there, weighted error): the error is at most 1 where
        the step meets the tolerance. It expects ``rates(x, v[, theta])`` in scope.
    """
    x = _row("x", states)
    lines = [
        "def step(t, s, h, x, k, v, theta, absolute, relative):",
        '    """One Dormand-Prince 5(4) step of length h from s, t being the time at s = 0."""',
        f"    ({', '.join(x)},) = x",
        f"    ({', '.join(_row('k1_', states))},) = k",
    ]
    for j in range(1, inputs + 1):
        lines.append(f"    (v{j}, a{j}, b{j}, c{j}) = v[{j - 1}]")
    for stage, (node, row) in enumerate(zip(_C, _A, strict=True), start=2):
        lines += _stage(stage, node, row, x, inputs, varying)
    lines += _error(x)
    lines.append("    return y, k7, error")
    return lines


def _row(name: str, n: int) -> list[str]:
    return [f"{name}{i + 1}" for i in range(n)]


def _number(fraction: str) -> str:
    numerator, _, denominator = fraction.partition("/")
    return repr(int(numerator) / int(denominator or 1))


def _combination(weights: tuple[str, ...], i: int) -> str:
    """sum_j weights_j k_j of component i, zero weights left out."""
    terms = [f"{_number(w)} * k{j}_{i}" for j, w in enumerate(weights, start=1) if w != "0"]
    return " + ".join(terms).replace("+ -", "- ")


def _stage(
    stage: int, node: str, row: tuple[str, ...], x: list[str], inputs: int, varying: bool
) -> list[str]:
    last = stage == len(_C) + 1
    lines = []
    # Stages 6 and 7 share their node, so theta and the inputs there are evaluated once.
    if not last:
        offset = "h" if node == "1" else f"{_number(node)} * h"
        lines.append(f"    r = s + {offset}")
        if inputs:
            values = [f"v{j} + r * (a{j} + r * (b{j} + r * c{j}))" for j in range(1, inputs + 1)]
            lines.append(f"    w = ({', '.join(values)},)")
        else:
            lines.append("    w = ()")
        if varying:
            lines.append("    p = theta(t + r)")
    points = [f"{x_i} + h * ({_combination(row, i)})" for i, x_i in enumerate(x, start=1)]
    if last:
        y = _row("y", len(x))
        lines += [f"    {y_i} = {point}" for y_i, point in zip(y, points, strict=True)]
        lines.append(f"    y = ({', '.join(y)},)")
        argument = "y"
    else:
        argument = f"({', '.join(points)},)"
    call = f"rates({argument}, w, p)" if varying else f"rates({argument}, w)"
    lines.append(f"    k{stage} = {call}")
    lines.append(f"    ({', '.join(_row(f'k{stage}_', len(x)))},) = k{stage}")
    return lines


def _error(x: list[str]) -> list[str]:
    lines = []
    for i, x_i in enumerate(x, start=1):
        lines.append(
            f"    e{i} = abs(h * ({_combination(_E, i)}))"
            f" / (absolute + relative * max(abs({x_i}), abs(y{i})))"
        )
    errors = ", ".join(_row("e", len(x)))
    lines.append(f"    error = max({errors})" if len(x) > 1 else f"    error = {errors}")
    return lines
