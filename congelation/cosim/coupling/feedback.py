"""The ends of the inputs that are fed back: what the sweeps of a step iterate on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.broyden import Broyden
from congelation.cosim.coupling.ends import Ends
from congelation.cosim.ensemble import Ensemble

__all__ = ["Feedback"]

Floats = npt.NDArray[np.float64]


class Feedback:
    """Links whose source steps after their target (or is the target): a sweep needs their ends
    before it knows them.

    The unknowns z are value and derivative at the end of the step of each such link, scaled by
    nominal value plus size, derivatives by that over the step length.

    Parameters
    ----------
    ensemble : Ensemble
    ends : Ends
    accelerate : bool
        Whether to improve z by quasi-Newton steps rather than plain ones.
    """

    def __init__(self, ensemble: Ensemble, ends: Ends, accelerate: bool) -> None:
        back = [k for k, link in enumerate(ensemble.inputs.links) if link.source >= link.target]
        count = len(ensemble.inputs.links)
        self._links = [ensemble.inputs.links[k] for k in back]
        self._start = np.array(back, np.intp)
        self._given = np.array([row * count + k for row in (2, 3) for k in back], np.intp)
        self._found = np.array([row * count + k for row in (0, 1) for k in back], np.intp)
        self._w, self._new = ends.w.reshape(-1), ends.new.reshape(-1)
        self._nominal = ensemble.inputs.nominal[back]
        self._method = Broyden(2 * len(back)) if accelerate and back else None
        # The step for which the Jacobian holds.
        self._length = 0.0
        self._before: tuple[Floats, float] = (np.zeros((0, 0)), 0.0)
        self._scales: Floats = np.ones(2 * len(back))
        self._g: Floats = np.zeros(2 * len(back))
        self._r: Floats = np.zeros(2 * len(back))

    def open(self, length: float) -> None:
        """Turn to a step of `length`."""
        scale = np.abs(self._w.take(self._start))
        scale += self._nominal
        self._scales = np.concatenate([scale, scale / length])
        if self._method is not None:
            self._before = (self._method.J, self._length)
            self._method.restart()
            if self._length > 0.0:
                # What an input's end does to an output grows with the step, to first order.
                self._method.rescale(length / self._length)
            self._length = length

    def change(self) -> float:
        """How far the last sweep moved the ends, relative; nan or infinity where it overflowed."""
        z = self._w.take(self._given)
        self._g = self._new.take(self._found)
        self._r = (self._g - z) / self._scales
        if self._method is not None:
            self._method.learn(z / self._scales, self._r)
        return float(np.sqrt(self._r.dot(self._r)))

    def take_over(self) -> None:
        """Let the next sweep start from the ends that the last one found."""
        self._w[self._given] = self._g

    def improve(self) -> None:
        """Let the next sweep start from the best ends that can be told from the sweeps so far."""
        if self._method is None:
            self.take_over()
        else:
            self._w[self._given] = self._method.step() * self._scales

    def undo(self) -> None:
        """Forget what was learnt since the step was turned to."""
        if self._method is not None:
            self._method.J, self._length = self._before

    def worst(self) -> str:
        """The connection that the last sweep moved most."""
        size = np.abs(self._r).reshape(2, -1).max(axis=0)
        return self._links[int(size.argmax())].name
