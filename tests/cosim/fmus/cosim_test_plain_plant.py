"""The oscillator as most FMUs are: no derivatives of inputs or outputs, no dependencies."""

from cosim_test_base import Block


class TestPlainPlant(Block):
    parameters = {"w": 1.5}
    inputs = ("u",)
    polynomial = False
    states = {"x[1]": 1.0, "x[2]": 0.0}
    output_names = ("x[1]", "x[2]")
    complete_state = False

    def rates(self, t, x, u, piece):
        return [x["x[2]"], -self.values["w"] ** 2 * x["x[1]"] - 0.2 * x["x[2]"] + u["u"]]

    def outputs(self, t, x, u, du):
        return dict(x)
