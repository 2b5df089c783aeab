"""No FMUs at all: scipy's `solve_ivp` on the equations that the FMUs evaluate.

The functions are those of the modules inside the FMU files. The solver is started anew at every
jump of theta, as it has to be to keep its order.
"""

from __future__ import annotations

import inspect
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from benchmarks.cases import figure
from benchmarks.engines.base import Program, Run
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch
from congelation.theory.model import Model
from congelation.verify.reference import Reference, reference

__all__ = ["Monolithic"]

Floats = npt.NDArray[np.float64]

ABSOLUTE = 1e-3
"""Absolute tolerance over the relative one, as inside the FMUs."""

AGREEMENT = 1e-9
"""Relative difference to the theory's own right-hand side that counts as an error in this file."""


class Monolithic(Program):
    """The loop as one differential equation in Python."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        found = figure(loop.name)
        self._reference = reference(found.case)
        fmus = {component.name: Path(component.fmu) for component in loop.components}
        self._rates, self._outputs = _closed(self._reference, fmus)
        self._names = [
            *self._reference.loop.state_names,
            *self._names_of_outputs(),
        ]
        self._check()

    def _names_of_outputs(self) -> list[str]:
        controller = self._reference.loop.controller
        return [f"controller.{n}" for y in controller.outputs for n in y.variables.names]

    def _check(self) -> None:
        theta = self._reference.segments[0].theta
        start = self._reference.start
        exact = self._reference.loop.function(start, theta(0.0))
        found = np.array(self._rates(0.0, start, theta))
        if np.abs(found - exact).max() > AGREEMENT * np.abs(exact).max():
            raise RuntimeError("the FMUs' equations are not those of the theory")

    def run(self, method: str, rtol: float, stop_time: float, *, keep_rows: bool) -> Run:
        """Rows are the solver's own steps; outputs are evaluated afterwards, which is not timed."""
        times: list[Floats] = []
        states: list[Floats] = []
        X = self._reference.start
        watch = Stopwatch()
        for segment in self._reference.segments:
            if segment.start >= stop_time:
                break
            piece = solve_ivp(
                self._rates,
                (segment.start, min(segment.end, stop_time)),
                X,
                method=method,
                rtol=rtol,
                atol=ABSOLUTE * rtol,
                args=(segment.theta,),
            )
            if not piece.success:
                raise RuntimeError(piece.message)
            X = piece.y[:, -1]
            times.append(piece.t)
            states.append(piece.y.T)
        seconds = watch.seconds()
        if not keep_rows:
            return Run(seconds)
        places = [self._names.index(f"{owner}.{name}") for owner, name in self.loop.record]
        rows = []
        for t, X in zip(np.concatenate(times), np.concatenate(states), strict=True):
            values = [*X.tolist(), *self._outputs(X)]
            rows.append([float(t), *(values[k] for k in places)])
        return Run(seconds, rows)


def _closed(
    found: Reference, fmus: Mapping[str, Path]
) -> tuple[Callable[..., Sequence[float]], Callable[[Floats], Sequence[float]]]:
    """(t, X, theta) -> X', and X -> the controller's outputs."""
    loop = found.loop
    plant, _ = _bound(fmus["plant"], loop.plant, {})
    controller, outputs = _bound(fmus["controller"], loop.controller, loop.values)
    n = sum(len(state.variables.names) for state in loop.plant.states)
    sensed = len(loop.controller.inputs[0].variables.names)

    # The plant's measured outputs are its first states, and u is the controller's first output.
    def rates(t: float, X: Floats, theta: Callable[[float], Sequence[float]]) -> Sequence[float]:
        values = X.tolist()
        x, own = values[:n], values[n:]
        y = x[:sensed]
        forward: tuple[float, ...] = plant(x, (outputs(own, y)[0],), theta(t))
        back: tuple[float, ...] = controller(own, y)
        return forward + back

    def all_outputs(X: Floats) -> Sequence[float]:
        values = X.tolist()
        found_outputs: Sequence[float] = outputs(values[n:], values[:sensed])
        return found_outputs

    return rates, all_outputs


def _bound(fmu: Path, model: Model, values: Mapping[str, Floats]) -> tuple[Any, Any]:
    """The rates and the outputs of an FMU's own module, closed over parameters."""
    with zipfile.ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith("/equations.py")]
        namespace: dict[str, Any] = {}
        exec(compile(archive.read(name), f"{fmu.name}/{name}", "exec"), namespace)
    groups = [p.variables for p in model.parameters] + [g.variables for g in model.gains]
    scalars = {
        re.sub(r"[\[,]", "_", scalar).rstrip("]"): float(value)
        for group in groups
        if group.name in values
        for scalar, value in zip(group.names, np.ravel(values[group.name], "F"), strict=True)
    }
    bind = namespace["bind"]
    rates, outputs, *_ = bind(*(scalars[name] for name in inspect.signature(bind).parameters))
    return rates, outputs
