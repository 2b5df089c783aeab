"""Time-varying parameters θ(t): sums of constants, sines, squares, chirps, tables, random terms.

The paper asks of θ(t) only that it stays in a box of known radius δ; it may vary arbitrarily fast
and jump. A `Profile` is such a signal as data. Between two events (jumps, kinks of a table, ends
of a sweep) it is one smooth formula, a `Segment`; an integrator that stops at `Segment.end` and
goes on with `Profile.segment(end)` therefore never steps across a jump.

    profile(-3.0, Sine(0.6, 0.4), Square(0.4, 1.3))     -3 + 0.6 sin(0.4 t) + 0.4 sgn(sin(2π t/1.3))

Profiles are continuous from the right: at a jump, `Profile.value` is the value after it and
`Segment.value(end)` the value before it. The time of every jump is computed from its index, by
the same expression wherever it is needed, so no rounding separates a jump from its own time.

Read in the order of the imports: `checks`, `segment`, `terms`, `telegraph`, `noise`, `table`,
`kinds`, then `spec` and `flat` side by side, and `profiles`. The folder is copied into the FMUs as
it stands: the standard library only, Python 3.9 or later, imports among its modules relative.
"""

from __future__ import annotations

from .checks import ProfileError
from .flat import FlatParameter, Slots, flat_parameters, sizes_of_flat
from .kinds import SLOTTED
from .noise import Noise
from .profiles import Profile, box_radius, profile
from .segment import Segment
from .table import Table
from .telegraph import Telegraph, splitmix64
from .terms import Chirp, Constant, Sine, Square, Term

__all__ = [
    "SLOTTED",
    "Chirp",
    "Constant",
    "FlatParameter",
    "Noise",
    "Profile",
    "ProfileError",
    "Segment",
    "Sine",
    "Slots",
    "Square",
    "Table",
    "Telegraph",
    "Term",
    "box_radius",
    "flat_parameters",
    "profile",
    "sizes_of_flat",
    "splitmix64",
]
