"""Integer, Boolean, String and Real outputs that follow from inputs at once.

n_out = min(n_in + 1, most), b_out = (b_in or v > level) != inverts, s_out = the last `most`
characters of s_in + "."; w = 1 where b_in, else 0.
"""

from pythonfmu import (
    Boolean,
    Fmi2Causality,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
    String,
)


class TestLogic(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.n_in, self.b_in, self.s_in, self.v = 0, False, "", 0.0
        self.most, self.inverts, self.level = 2**31 - 1, False, float("1e300")
        discrete = {"variability": Fmi2Variability.discrete}
        for letter, kind in {"n": Integer, "b": Boolean, "s": String}.items():
            self.register_variable(kind(letter + "_in", causality=Fmi2Causality.input, **discrete))
            self.register_variable(
                kind(letter + "_out", causality=Fmi2Causality.output, **discrete)
            )
        self.register_variable(Real("v", causality=Fmi2Causality.input))
        self.register_variable(Real("w", causality=Fmi2Causality.output))
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        self.register_variable(Integer("most", **fixed))
        self.register_variable(Boolean("inverts", **fixed))
        self.register_variable(Real("level", **fixed))

    @property
    def n_out(self):
        return min(self.n_in + 1, self.most)

    @property
    def b_out(self):
        return (self.b_in or self.v > self.level) != self.inverts

    @property
    def s_out(self):
        return (self.s_in + ".")[-self.most:]

    @property
    def w(self):
        return float(self.b_in)

    def do_step(self, current_time, step_size):
        return True
