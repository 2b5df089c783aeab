"""q' = x1,  u = -k x1 - d x2 - 0.5 q - c x1^3, with its exact derivative."""

from cosim_test_base import Block


class TestController(Block):
    parameters = {"k": 2.0, "d": 1.0, "c": 0.3}
    inputs = ("x[1]", "x[2]")
    states = {"q": 0.0}
    output_names = ("u", "der(u)", "q")
    dependencies = {
        "u": ["x[1]", "x[2]"],
        "der(u)": ["x[1]", "der(x[1])", "der(x[2])"],
        "q": [],
    }

    def rates(self, t, x, u, piece):
        return [u["x[1]"]]

    def outputs(self, t, x, u, du):
        k, d, c = (self.values[name] for name in "kdc")
        return {
            "u": -k * u["x[1]"] - d * u["x[2]"] - 0.5 * x["q"] - c * u["x[1]"] * u["x[1]"] * u["x[1]"],
            "der(u)": -(k + 3 * c * u["x[1]"] * u["x[1]"]) * du["x[1]"] - d * du["x[2]"] - 0.5 * u["x[1]"],
            "q": x["q"],
        }
