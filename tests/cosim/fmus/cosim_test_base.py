"""A small slave with named real variables, cubic inputs, states and a complete FMU state."""

import math

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

INTERNAL_STEP = 2e-3
INPUT_ORDERS = (1, 2, 3)


class Block(Fmi2Slave):
    """States `x` driven by inputs; `outputs(t, x, u, du)` gives every output by name.

    Subclasses set the class attributes and implement `rates` and `outputs`.
    """

    parameters = {}
    inputs = ()
    polynomial = True
    states = {}
    output_names = ()
    dependencies = None
    complete_state = True

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = dict(self.parameters)
        for name in self.inputs:
            self.values[name] = 0.0
            if self.polynomial:
                for order in INPUT_ORDERS:
                    self.values[self.derivative(name, order)] = 0.0
        self.x = dict(self.states)
        self.time = 0.0
        self.offset = 0.0
        self.running = False
        self.faults = []
        for name in self.parameters:
            self.add(name, Fmi2Causality.parameter, Fmi2Variability.fixed)
        for name in list(self.values)[len(self.parameters):]:
            self.add(name, Fmi2Causality.input, Fmi2Variability.continuous)
        for name in self.output_names:
            self.register_variable(Real(
                name, causality=Fmi2Causality.output, variability=Fmi2Variability.continuous,
                initial=Fmi2Initial.calculated, getter=lambda name=name: self.evaluate()[name],
            ), nested=False)

    @staticmethod
    def derivative(name, order):
        return f"der({name})" if order == 1 else f"der({name},{order})"

    def add(self, name, causality, variability):
        self.register_variable(Real(
            name, causality=causality, variability=variability, start=self.values[name],
            getter=lambda: self.values[name], setter=lambda value: self.change(name, value),
        ), nested=False)

    def change(self, name, value):
        self.values[name] = value
        self.offset = 0.0

    def input_at(self, s):
        v, d = {}, {}
        for name in self.inputs:
            a, b, c, e = self.values[name], 0.0, 0.0, 0.0
            if self.polynomial:
                b, c, e = (self.values[self.derivative(name, k)] for k in INPUT_ORDERS)
            v[name] = a + s * (b + s * (c / 2.0 + s * e / 6.0))
            d[name] = b + s * (c + s * e / 2.0)
        return v, d

    def evaluate(self):
        x = self.x if self.running else self.initial()
        return self.outputs(self.time, x, *self.input_at(self.offset))

    def initial(self):
        return dict(self.states)

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        self.time = start_time

    def exit_initialization_mode(self):
        self.x = self.initial()
        self.running = True

    def do_step(self, current_time, step_size):
        if self.faults:
            return False
        edges = [0.0, *self.jumps(current_time, step_size), step_size]
        for a, b in zip(edges, edges[1:]):
            count = max(1, math.ceil((b - a) / INTERNAL_STEP))
            for k in range(count):
                self.runge_kutta(current_time, a + (b - a) * k / count, (b - a) / count)
        self.time = current_time + step_size
        self.offset = step_size
        return True

    def jumps(self, t, h):
        return []

    def runge_kutta(self, t, s, h):
        names = list(self.x)

        def rates(s, x):
            # Inside a smooth piece: its middle decides on which side of a jump this is.
            return self.rates(t + s, dict(zip(names, x)), self.input_at(s)[0], t + middle)

        middle = s + h / 2
        x = list(self.x.values())
        k1 = rates(s, x)
        k2 = rates(s + h / 2, [a + h / 2 * b for a, b in zip(x, k1)])
        k3 = rates(s + h / 2, [a + h / 2 * b for a, b in zip(x, k2)])
        k4 = rates(s + h, [a + h * b for a, b in zip(x, k3)])
        self.x = {
            name: a + h / 6 * (p + 2 * q + 2 * r + w)
            for name, a, p, q, r, w in zip(names, x, k1, k2, k3, k4)
        }

    def rates(self, t, x, u, piece):
        return []

    def outputs(self, t, x, u, du):
        raise NotImplementedError

    def _get_fmu_state(self):
        return {"values": dict(self.values), "x": dict(self.x), "time": self.time,
                "running": self.running, "offset": self.offset, "faults": list(self.faults)}

    def _set_fmu_state(self, state):
        self.values, self.x = dict(state["values"]), dict(state["x"])
        self.time, self.offset = state["time"], state["offset"]
        self.running = state["running"]
        self.faults = list(state["faults"])
