"""The law (11)-(19), (26) for system (60) in plain numpy: one Runge-Kutta step per macro step."""

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class NaiveController(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x1 = 0.0
        self.x2 = 0.0
        self.u = 0.0
        self.theta_hat = np.zeros(2)
        self.c = np.array([0.5, 0.5])
        self.Gamma = np.eye(2)
        self.epsilon = 0.3
        self.delta = np.sqrt(2.0)
        for name in ("x1", "x2"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.input, variability=Fmi2Variability.continuous)
            )
        self.register_variable(Real("u", causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        self.u, _ = self.law(self.theta_hat)

    def law(self, theta_hat):
        """u and theta_hat' of (19)."""
        x = np.array([self.x1, self.x2])
        c, Gamma = self.c, self.Gamma
        weight, spread = 1.0 / self.epsilon**2, self.epsilon**2 * self.delta**2
        wbar_11 = np.array([-1.0, 0.0])
        z_1 = x[0]
        w_1 = wbar_11 * z_1
        slope = -(c[0] + (weight * wbar_11 @ wbar_11 + spread) / 2.0) + theta_hat[0]
        z_2 = x[1] - slope * z_1
        wbar_21 = np.array([0.0, -1.0]) - slope * wbar_11
        w_2 = wbar_21 * z_1
        tau = w_1 * z_1 + w_2 * z_2
        zeta_2 = (
            -weight * (wbar_21 @ wbar_11) * z_1 - (weight * wbar_21 @ wbar_21 + spread) / 2.0 * z_2
        )
        u = (
            -z_1
            - c[1] * z_2
            + slope * x[1]
            - w_2 @ theta_hat
            + np.array([z_1, 0.0]) @ Gamma @ tau
            + zeta_2
        )
        return float(u), Gamma @ tau

    def do_step(self, current_time, step_size):
        h, theta_hat = step_size, self.theta_hat
        _, k1 = self.law(theta_hat)
        _, k2 = self.law(theta_hat + h / 2.0 * k1)
        _, k3 = self.law(theta_hat + h / 2.0 * k2)
        _, k4 = self.law(theta_hat + h * k3)
        self.theta_hat = theta_hat + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.u, _ = self.law(self.theta_hat)
        return True
