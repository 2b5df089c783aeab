"""x1' = x2,  x2' = -w^2 x1 - 0.2 x2 + b u + a sgn(sin(2 pi t / T)): an oscillator that jumps."""

import math

from cosim_test_base import Block


class TestPlant(Block):
    parameters = {"w": 1.5, "b": 1.0, "a": 0.0, "T": 1.3, "x0[1]": 1.0, "x0[2]": 0.0}
    inputs = ("u",)
    states = {"x[1]": 0.0, "x[2]": 0.0}
    output_names = ("x[1]", "x[2]", "der(x[1])", "der(x[2])", "next_event")
    dependencies = {"x[1]": [], "x[2]": [], "der(x[1])": [], "der(x[2])": ["u"], "next_event": []}

    def initial(self):
        return {"x[1]": self.values["x0[1]"], "x[2]": self.values["x0[2]"]}

    def outputs(self, t, x, u, du):
        d1, d2 = self.rates(t, x, u, t)
        return {**x, "der(x[1])": d1, "der(x[2])": d2, "next_event": self.next_event(t)}

    def rates(self, t, x, u, piece):
        v = self.values
        sign = -1.0 if self.half_periods(piece) % 2 else 1.0
        return [x["x[2]"],
                -v["w"] ** 2 * x["x[1]"] - 0.2 * x["x[2]"] + v["b"] * u["u"] + v["a"] * sign]

    def half_periods(self, t):
        half = self.values["T"] / 2
        count = math.floor(t / half)
        if count * half > t:
            return count - 1
        return count + 1 if (count + 1) * half <= t else count

    def next_event(self, t):
        if self.values["a"] == 0.0:
            return math.inf
        return (self.half_periods(t) + 1) * (self.values["T"] / 2)

    def jumps(self, t, h):
        found, event = [], self.next_event(t)
        while event < t + h:
            found.append(event - t)
            event = self.next_event(event)
        return found
