"""Inputs as value plus derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import AdaptiveStepper, StepsOnce, Trial, Watch
from congelation.cosim.coupling.points import LinkReader, Points
from congelation.cosim.coupling.polynomial import hermite, product
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange, settle_discrete
from congelation.cosim.system import MAX_DERIVATIVE
from congelation.errors import InvalidInput

__all__ = ["Derivative", "DerivativePlan", "DerivativeStepper"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SEQUENCES = ("gauss_seidel", "jacobi")
CONTROLS = ("halves", "prediction")

ORDER = 2

FIRST_CHANGE = 1e-2
"""Share of its size by which an input may change over the first step that is tried."""


@dataclass(frozen=True)
class Derivative(StepsOnce):
    """Inputs are extrapolated from their value and derivative at the step's start.

    Order 2. The derivative is the source's der(.) output, or that of fmi2GetRealOutputDerivatives,
    or else that of the polynomial through the last values. An input that takes a value alone is
    held at the mean of what it would follow.

    Parameters
    ----------
    sequence : str
        "gauss_seidel": slaves step in the declared order, and the inputs that come from a slave
        which has already stepped are interpolated between both ends of the step instead.
        "jacobi": all inputs are extrapolated, and after the step outputs and inputs are made to
        agree in the order of the declared dependencies.
    control : str
        How the error of a step is found where a tolerance chooses it. "halves": where inputs are
        held or sources say no derivative, the step is made again in two halves, and the difference
        tells. "prediction": how far each input was off the output that drives it, by the value
        that was extrapolated to the end of the step. No step is made twice for that, and FMUs need
        not save their state: those that cannot keep every step, whatever its error.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, step=0.05, coupling=cg.Derivative()).status.name
    'COMPLETED'
    """

    sequence: str = "gauss_seidel"
    control: str = "halves"
    name: ClassVar[str] = "derivative"
    needs_derivatives: ClassVar[bool] = True
    lands_on_events: ClassVar[bool] = True
    takes_tolerance: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sequence not in SEQUENCES:
            raise InvalidInput(f"sequence '{self.sequence}'; valid: {', '.join(SEQUENCES)}")
        if self.control not in CONTROLS:
            raise InvalidInput(f"control '{self.control}'; valid: {', '.join(CONTROLS)}")

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> AdaptiveStepper[Points]:
        """This coupling at work."""
        return DerivativeStepper(ensemble, exchange, self, takes_back=tolerance is not None)


class DerivativePlan(NamedTuple):
    """What `derivative` is on a system, for the compiled loop.

    Parameters
    ----------
    halves : bool
        Whether steps are made again in halves.
    sequential, exchanges : bool
        Whether slaves see what others before them have done, and whether outputs and inputs are
        made to agree after each step.
    reaches_end : list of bool, one per slave
        Whether its outputs are read for what held inputs are at the end.
    ahead : boolean array, shape (slaves, L)
        The links whose target is that slave, and whose source steps before it.
    """

    halves: bool
    sequential: bool
    exchanges: bool
    reaches_end: list[bool]
    ahead: Mask


class DerivativeStepper(AdaptiveStepper[Points]):
    """`derivative` at work."""

    def __init__(
        self, ensemble: Ensemble, exchange: Exchange, coupling: Derivative, *, takes_back: bool
    ) -> None:
        self._ensemble = ensemble
        self._exchange = exchange
        self._reader = LinkReader(ensemble)
        self.first_change = FIRST_CHANGE
        self._sequential = coupling.sequence == "gauss_seidel"
        self._watches = not takes_back
        # Loops are solved at every communication point; for plain feedthrough the sequence of
        # the slaves already carries the values over.
        self._exchanges = bool(exchange.loops) or (exchange.feedthrough and not self._sequential)
        self._ahead = [self._interpolated(m) for m in range(len(ensemble.slaves))]
        self._held = ensemble.order == 0
        self._has_held = bool(self._held.any())
        # Outputs that follow at once from a held input belong to its value at the end of the step.
        self._reaches_end = [ensemble.passes_on_held(m) for m in range(len(ensemble.slaves))]
        self.order = ORDER
        self._is_plain = self._has_held or bool(self._reader.inexact.size)
        self.halves = self._is_plain and coupling.control == "halves"
        self.predicts = self.keeps = coupling.control == "prediction"
        self.watch = Watch(ensemble.nominal, extrapolated=True)
        self.iterations = 0
        self.calls_per_iteration = (
            sum(ensemble.write_calls)
            + len(ensemble.slaves)
            + sum(ensemble.read_calls)
            + 2 * sum(self._reaches_end)
        )

    def plan(self) -> DerivativePlan:
        """The same as data."""
        links, slaves = self._ensemble.links, range(len(self._ensemble.slaves))
        ahead = [
            [self._sequential and link.source < link.target == m for link in links] for m in slaves
        ]
        return DerivativePlan(
            self.halves,
            self._sequential,
            self._exchanges,
            self._reaches_end,
            np.array(ahead, bool).reshape(len(slaves), len(links)),
        )

    def _interpolated(self, m: int) -> tuple[Mask | None, Mask | None, Mask | None] | None:
        """The links into slave m that can be interpolated, as their sources have stepped already:
        those that take three derivatives, those that take fewer, and those that take none."""
        stepped = np.array([k.source < k.target == m for k in self._ensemble.links], bool)
        if not self._sequential or not stepped.any():
            return None
        cubic = stepped & (self._ensemble.order == MAX_DERIVATIVE)
        held = stepped & (self._ensemble.order == 0)
        linear = stepped & ~cubic & ~held
        return (
            cubic if cubic.any() else None,
            linear if linear.any() else None,
            held if held.any() else None,
        )

    def renew(self) -> None:
        super().renew()
        self.watch.clear()

    def start(self, time: float, before: Points | None) -> Points:
        state = Points.begun(time, self._reader.start())
        if self._watches:  # otherwise each trial has an error of its own
            self.watch.row(time)[:] = state.now
        return state

    def advance(self, state: Points, time: float, end: float) -> Points:
        state, _ = self._step(state, time, end)
        self.watch.row(end)[:] = state.now
        settle_discrete(self._ensemble, end)
        return state

    def attempt(self, state: Points, time: float, end: float) -> Trial[Points]:
        after, w = self._step(state, time, end)
        values = after.now[0]
        if not values.size:
            return Trial(after, 0.0, ORDER, 0)
        distance = np.abs(w[0] + (end - time) * w[1] - values)
        relative = self._reader.relative(distance, values)
        worst = int(relative.argmax())
        missed = distance if self.predicts else None
        return Trial(after, float(relative[worst]), ORDER, worst, missed)

    def _step(self, state: Points, time: float, end: float) -> tuple[Points, Floats]:
        """The state at the end, and w = (v0, d0, v1, d1), shape (4, L), of which the first two
        rows are what inputs were extrapolated from."""
        ensemble, reader, C = self._ensemble, self._reader, self._ensemble.C
        length = end - time
        w = np.empty((4, C.shape[1]))
        w[:2] = state.now
        if reader.inexact.size:
            w[1, reader.inexact] = state.predicted(time, reader.inexact)[1]
        C[:2] = w[:2]
        C[2:] = 0.0
        if self._has_held:
            np.copyto(C[0], w[0] + w[1] * (length / 2.0), where=self._held)
        # Where the inputs are expected to be at the end of the step.
        ends = w[0] + w[1] * length if self._has_held else w[0]
        for m, slave in enumerate(ensemble.slaves):
            ahead = self._ahead[m]
            if ahead is not None:
                w[2:] = reader.end(state, end, w)
                cubic, linear, held = ahead
                if cubic is not None:
                    np.copyto(C, product(hermite(length), w), where=cubic)
                if linear is not None:
                    np.copyto(C[1], (w[2] - w[0]) / length, where=linear)
                if held is not None:
                    np.copyto(C[0], (w[0] + w[2]) / 2.0, where=held)
                if self._reaches_end[m]:
                    stepped = [mask for mask in ahead if mask is not None]
                    np.copyto(ends, w[2], where=np.logical_or.reduce(stepped))
            ensemble.write[m]()
            slave.step(time, length)
            if self._reaches_end[m]:
                columns = ensemble.columns[m]
                C[0, columns] = ends[columns]
                C[1:, columns] = 0.0
                ensemble.write[m]()
            if self._sequential:
                ensemble.read[m]()
        if not self._sequential:
            ensemble.read_all()
        if self._exchanges:
            self._exchange.run(end)
        self.iterations += 1
        return state.followed(end, reader.end(state, end, w)), w

    def points(self, state: Points) -> Points:
        return state

    def first_step(self, state: Points) -> float:
        if self.predicts and self._is_plain:
            return 0.0  # nothing is known before a step is made
        return self._reader.time_scale(state.now) * self.first_change

    def largest_error(self) -> float:
        return self.watch.largest()
