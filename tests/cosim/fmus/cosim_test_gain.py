"""y = k u + c u^3 + b, at once: feedthrough without a state."""

from cosim_test_base import Block


class TestGain(Block):
    parameters = {"k": 1.0, "c": 0.0, "b": 0.0}
    inputs = ("u",)
    output_names = ("y", "der(y)")
    dependencies = {"y": ["u"], "der(y)": ["u", "der(u)"]}

    def outputs(self, t, x, u, du):
        k, c, b = (self.values[name] for name in "kcb")
        return {"y": k * u["u"] + c * u["u"] ** 3 + b,
                "der(y)": (k + 3 * c * u["u"] ** 2) * du["u"]}
