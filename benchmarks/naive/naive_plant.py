"""System (60) in plain numpy: one Runge-Kutta step per macro step."""

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class NaivePlant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = 0.0
        self.x1 = 2.0
        self.x2 = -1.0
        self.register_variable(
            Real("u", causality=Fmi2Causality.input, variability=Fmi2Variability.continuous)
        )
        self.register_variable(Real("x1", causality=Fmi2Causality.output))
        self.register_variable(Real("x2", causality=Fmi2Causality.output))

    def theta(self, t):
        return np.array(
            [
                -3.0 + 0.6 * np.sin(0.4 * t) + 0.4 * np.sign(np.sin(2.0 * np.pi * t / 1.3)),
                2.0 + 0.6 * np.cos(0.25 * t) + 0.4 * np.sin(20.0 * t),
            ]
        )

    def rates(self, t, x):
        theta = self.theta(t)
        return np.array([-theta[0] * x[0] + x[1], -theta[1] * x[0] + self.u])

    def do_step(self, current_time, step_size):
        t, h = current_time, step_size
        x = np.array([self.x1, self.x2])
        k1 = self.rates(t, x)
        k2 = self.rates(t + h / 2.0, x + h / 2.0 * k1)
        k3 = self.rates(t + h / 2.0, x + h / 2.0 * k2)
        k4 = self.rates(t + h, x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.x1, self.x2 = float(x[0]), float(x[1])
        return True
