"""A slave as a first-time user of pythonfmu writes it: everything is left at its default."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class NaiveLag(Fmi2Slave):
    """x' = u - k x by one Euler step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = 0.25
        self.k = 1.5
        self.y = 0.0
        self.hidden = 1.0
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("k", causality=Fmi2Causality.parameter))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        """Advance by one step."""
        self.hidden += step_size * (self.u - self.k * self.hidden)
        self.y = 2.0 * self.hidden
        return True
