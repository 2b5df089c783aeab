"""Integer, Boolean and String inputs passed on to outputs, the integer counted up by one a step."""

from pythonfmu import (
    Boolean,
    Fmi2Causality,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
    String,
)


class TestDiscrete(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.n_in, self.n_out = 0, 0
        self.b_in, self.b_out = False, False
        self.s_in, self.s_out = "", ""
        self.y = 0.0
        kinds = {"n": Integer, "b": Boolean, "s": String}
        for letter, kind in kinds.items():
            self.register_variable(kind(
                letter + "_in", causality=Fmi2Causality.input, variability=Fmi2Variability.discrete
            ))
            self.register_variable(kind(
                letter + "_out", causality=Fmi2Causality.output,
                variability=Fmi2Variability.discrete,
            ))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.n_out = self.n_in + 1
        self.b_out = not self.b_in
        self.s_out = self.s_in + "."
        self.y = current_time + step_size
        return True
