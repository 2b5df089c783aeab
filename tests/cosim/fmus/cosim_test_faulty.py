"""y' = r y, and every way to fail: chosen by `mode`, at time `at`."""

import math

from cosim_test_base import Block
from pythonfmu.enums import Fmi2Status


class TestFaulty(Block):
    parameters = {"r": 0.0, "mode": 0.0, "at": 0.5, "longest": math.inf}
    inputs = ("u",)
    states = {"y": 1.0}
    output_names = ("y", "der(y)")
    dependencies = {"y": [], "der(y)": []}

    def change(self, name, value):
        if name == "r" and value < -100.0:
            self.faults.append("r")
            self.log("r = %g is refused: it must be at least -100" % value, Fmi2Status.error)
        super().change(name, value)

    def rates(self, t, x, u, piece):
        return [self.values["r"] * x["y"]]

    def outputs(self, t, x, u, du):
        late = t > self.values["at"]
        y = math.nan if late and self.values["mode"] == 3.0 else x["y"]
        return {"y": y, "der(y)": self.values["r"] * x["y"]}

    def do_step(self, current_time, step_size):
        late = current_time + step_size > self.values["at"]
        if late and self.values["mode"] == 1.0:
            self.log("the valve is stuck, 100% open", Fmi2Status.error)
            return False
        if late and self.values["mode"] == 2.0:
            raise RuntimeError("the slave fell over")
        if late and self.values["mode"] == 4.0:
            raise KeyboardInterrupt
        if step_size > self.values["longest"]:
            self.log("too long a step", Fmi2Status.discard)
            return False
        return super().do_step(current_time, step_size)
