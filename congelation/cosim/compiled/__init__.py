"""The compiled stepping loop, called through ctypes.

It makes the steps of `jacobi`, `gauss_seidel`, `derivative` and `hermite`, for any FMUs, and the
jumps between steps that a tolerance chooses. The loops in Python are the reference: they make the
step that the compiled loop ended at, and so find the status and the message of a run that fails.

The shared library is built from the folder `loop` when the package is installed. Where there is
none, because there was no compiler, runs are the same, and slower.

structures  what both sides share
library     the shared library
base        the system, and what all calls have in common
held        jacobi and gauss_seidel
polynomials hermite and derivative
model_exchange  DOP853 on all states
"""

from congelation.cosim.compiled.base import CHUNK, DONE, FULL, NOT_FINITE, UNUSUAL, fits
from congelation.cosim.compiled.held import CompiledHeld
from congelation.cosim.compiled.library import available
from congelation.cosim.compiled.model_exchange import CompiledIntegrator, CompiledRates
from congelation.cosim.compiled.polynomials import CompiledPolynomials
from congelation.cosim.compiled.structures import Loop

__all__ = [
    "CHUNK",
    "DONE",
    "FULL",
    "NOT_FINITE",
    "UNUSUAL",
    "CompiledHeld",
    "CompiledIntegrator",
    "CompiledPolynomials",
    "CompiledRates",
    "Loop",
    "available",
    "fits",
]
