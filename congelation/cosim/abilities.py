"""Whether FMUs can do what they declare: one component of each makes a step, and makes it again."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.buffers import NO_DERIVATIVE
from congelation.cosim.coupling import AdaptiveStepper, Stepper
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.result import RunEnded
from congelation.cosim.system import ResolvedSystem
from congelation.errors import SlaveError
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = [
    "ABILITIES",
    "LENGTHS",
    "REFUSED_LENGTH",
    "REFUSED_STATE",
    "SLOPES",
    "STATES",
    "Abilities",
    "Lack",
    "lack_of",
    "require_restored",
]

Floats = npt.NDArray[np.float64]

REPEATED = 0.5
"""Largest difference of a step from a restored state, relative to what the step changes; beyond it,
the state was not restored."""

HALF_WAY = (-0.1, 0.8)
"""Where a step of half the length ends, as parts of what the whole one changed. A change in
proportion to a power of the time is at half of it or less; from a state that was not restored, it
would end beyond 1."""

REFUSED_LENGTH = "refuses the second one"
REFUSED_STATE = "steps from a restored one are refused"

ROUNDING = 1e-6
"""Relative changes up to this size show nothing."""

STATES, SLOPES = "can_get_and_set_state", "max_output_derivative_order"
CUBICS, LENGTHS = "can_interpolate_inputs", "can_vary_step"

ABILITIES = MappingProxyType(
    {
        STATES: "states that can be saved and restored",
        SLOPES: "derivatives of its outputs",
        CUBICS: "inputs that follow polynomials",
        LENGTHS: "steps of any length",
    }
)
"""Abilities that an FMU may declare, by the name of their fields in its description."""

CALLED = MappingProxyType(
    {
        "fmi2GetFMUstate": STATES,
        "fmi2SetFMUstate": STATES,
        "fmi2FreeFMUstate": STATES,
        "fmi2GetRealOutputDerivatives": SLOPES,
        "fmi2SetRealInputDerivatives": CUBICS,
    }
)
"""The functions that go with an ability."""


class Lack(NamedTuple):
    """An ability that an FMU declares and does not have.

    Parameters
    ----------
    component : str
    ability : str
        One of `ABILITIES`.
    shown : str
        What the trial showed.
    """

    component: str
    ability: str
    shown: str

    def __str__(self) -> str:
        return f"{self.component} declares {ABILITIES[self.ability]}, but {self.shown}"


def lack_of(error: Exception, system: ResolvedSystem) -> Lack | None:
    """The ability that an FMU has declared and refuses."""
    ability = CALLED.get(getattr(error, "call", ""))
    if ability is None or not isinstance(error, SlaveError):
        return None
    member = next(m for m in system.members if m.name == error.component)
    if not getattr(member.description, ability):
        return None
    return Lack(member.name, ability, f"refuses {error.call}: {error.message}")


class Abilities:
    """Tries what FMUs declare and a run may use.

    Parameters
    ----------
    system : ResolvedSystem
    saves, varies, able : bool
        Whether states are saved and restored, steps are of more than one length, and derivatives go
        both ways.

    Attributes
    ----------
    lack : Lack or None
        The first ability that was found to be missing; the trial ends there.
    steps, calls : int
        fmi2DoStep calls, and all fmi2 calls but those that begin a session.
    """

    def __init__(self, system: ResolvedSystem, *, saves: bool, varies: bool, able: bool) -> None:
        self._system = system
        self._saves, self._varies, self._able = saves, varies, able
        self.lack: Lack | None = None
        self.steps = self.calls = 0

    def run(self, ensemble: Ensemble, start: float, h: float) -> None:
        """One component of each FMU makes a step of length h, and again from the saved state.

        Raises
        ------
        SlaveError, SlaveTerminated
            What an FMU refuses.
        """
        ensemble.C[:] = 0.0
        ensemble.C[0] = ensemble.Y[ensemble.source]
        known = ensemble.source_derivative != NO_DERIVATIVE
        ensemble.C[1, known] = ensemble.Y[ensemble.source_derivative[known]]
        tried = set()
        for m, member in enumerate(self._system.members):
            if self.lack is None and member.description.sha256 not in tried:
                tried.add(member.description.sha256)
                self._try_fmu(ensemble, m, start, h)

    def _try_fmu(self, ensemble: Ensemble, m: int, start: float, h: float) -> None:
        """What component m declares and the run may use: that its outputs have derivatives, that it
        takes a second length, that its state is restored."""
        if not (self._saves or self._varies or self._able):
            return
        slave, before = ensemble.slaves[m], ensemble.Y.copy()
        state = slave.save() if self._saves else None
        self._step(ensemble, m, start, h)
        after = ensemble.Y.copy()
        self.lack = self._flat(ensemble, m, before, after)
        if self.lack is not None:
            return
        if state is None:
            if self._varies:
                self._step(ensemble, m, start + h, h / 2.0, LENGTHS, REFUSED_LENGTH)
            return
        slave.restore(state)
        if self._varies:
            # A step of half the length shows both that the state is restored and that lengths may
            # vary, where it ends between start and end of the whole one.
            self._step(ensemble, m, start, h / 2.0, LENGTHS, REFUSED_LENGTH)
            if self._is_half_way(ensemble, m, before, after):
                return
            slave.restore(state)
        self._step(ensemble, m, start, h, STATES, REFUSED_STATE)
        self.lack = self._unlike(ensemble, m, before, after)
        self.calls += 3

    def _step(
        self,
        ensemble: Ensemble,
        m: int,
        time: float,
        length: float,
        ability: str = "",
        shown: str = "",
    ) -> None:
        """Component m over a step, its inputs as they are in C.

        Raises
        ------
        SlaveError
            Where the FMU refuses the step and `ability` is given, `lack` is set to it.
        """
        self.steps += 1
        self.calls += 1 + ensemble.write_calls[m] + ensemble.read_calls[m]
        slave = ensemble.slaves[m]
        ensemble.write[m]()
        try:
            slave.step(time, length)
        except SlaveError as error:
            if ability and getattr(self._system.members[m].description, ability):
                self.lack = Lack(slave.name, ability, f"{shown}: {error.message}")
            raise
        ensemble.read[m]()

    def _outputs(self, ensemble: Ensemble, m: int) -> list[int]:
        """The links that come from component m."""
        return [k for k, link in enumerate(ensemble.links) if link.source == m]

    def _flat(self, ensemble: Ensemble, m: int, before: Floats, after: Floats) -> Lack | None:
        """Whether outputs change while the FMU says that none of their derivatives is other than
        zero."""
        own = [
            k
            for k in self._outputs(ensemble, m)
            if ensemble.links[k].source_derivatives[0] is None
            and ensemble.source_derivative[k] != NO_DERIVATIVE
        ]
        values, slopes = ensemble.source[own], ensemble.source_derivative[own]
        change = np.abs(after[values] - before[values])
        said = np.concatenate([before[slopes], after[slopes]])
        moves = change > ROUNDING * (ensemble.nominal[own] + np.abs(before[values]))
        if moves.any() and not said.any():
            return Lack(ensemble.slaves[m].name, SLOPES, "all are zero while its outputs change")
        return None

    def _is_half_way(self, ensemble: Ensemble, m: int, before: Floats, after: Floats) -> bool:
        """Whether a step of half the length has ended between start and end of the whole one."""
        own = self._outputs(ensemble, m)
        places = ensemble.source[own]
        made, whole = ensemble.Y[places] - before[places], after[places] - before[places]
        least = ROUNDING * (ensemble.nominal[own] + np.abs(after[places]))
        low, high = HALF_WAY
        share = np.divide(made, whole, out=np.full(len(own), 0.5), where=np.abs(whole) > least)
        return bool(((share >= low) & (share <= high)).all())

    def _unlike(self, ensemble: Ensemble, m: int, before: Floats, after: Floats) -> Lack | None:
        """Whether a step from the restored state ends elsewhere than the first did, by more than a
        share of what that changed."""
        for k in self._outputs(ensemble, m):
            place = ensemble.source[k]
            off = abs(ensemble.Y[place] - after[place])
            least = ROUNDING * (ensemble.nominal[k] + abs(after[place]))
            if off > max(REPEATED * abs(after[place] - before[place]), least):
                return Lack(
                    ensemble.slaves[m].name,
                    STATES,
                    f"a step from a restored one ends with {ensemble.links[k].output.name} = "
                    f"{ensemble.Y[place]:.6g} in place of {after[place]:.6g}",
                )
        return None


def require_restored(
    ensemble: Ensemble, stepper: Stepper[Any], state: Any, time: float, length: float
) -> None:
    """Make the first step of a run, from `time` on, twice: an FMU that does not restore its state
    would go on from elsewhere, and no number would tell. Looked at once in a process for each FMU;
    nothing of it counts.

    Raises
    ------
    SlaveError
        The second one ends elsewhere than the first, by more than a share of what that changed.
    """
    hashes = {member.description.sha256 for member in ensemble.system.members}
    if hashes <= _RESTORED:
        return
    assert isinstance(stepper, AdaptiveStepper)
    counts = ensemble.calls, stepper.iterations, [slave.log.warnings for slave in ensemble.slaves]
    before, ends = ensemble.Y.copy(), []
    ensemble.save()
    try:
        for _ in range(2):
            stepper.attempt(state, time, time + length)
            ends.append(ensemble.Y.copy())
            ensemble.restore()
            ensemble.Y[:] = before
    except (RunEnded, StepDiscarded, SlaveTerminated):
        ensemble.restore()  # the run will say what it is, or take a shorter step
        ensemble.Y[:] = before
    ensemble.forget_states()
    ensemble.calls, stepper.iterations = counts[:2]
    for slave, warnings in zip(ensemble.slaves, counts[2], strict=True):
        slave.log.warnings = warnings
    if len(ends) < 2:
        return
    first, again = ends
    off, change = np.abs(again - first), np.abs(first - before)
    wrong = off > np.maximum(REPEATED * change, ROUNDING * (1.0 + np.abs(first)))
    if wrong.any():
        place = int(wrong.argmax())
        name, _, variable = ensemble.read_names[place].partition(".")
        raise SlaveError(
            name,
            time,
            "it declares states that can be saved and restored, but a step from a restored one "
            f"ends with {variable} = {again[place]:.6g} in place of {first[place]:.6g}; coupling "
            "'auto' does without",
        )
    _RESTORED.update(hashes)


_RESTORED: set[str] = set()
"""Hashes of the FMUs whose states were found to be restored."""
