"""Parameters are completed, checked against their domains, and gains are computed."""

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.theory.gains import iss_filter_gain
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.values import complete_values


def test_defaults_and_gains():
    values = complete_values(output_feedback_controller(), {"r": 11.0, "epsilon": 0.1})
    assert values["k"].ravel() == pytest.approx(iss_filter_gain(11.0, 0.1, n=2))
    assert values["Gamma"].tolist() == np.eye(3).tolist()
    assert values["c"].shape == (2, 1)


def test_a_given_gain_takes_the_place_of_its_rule():
    values = complete_values(output_feedback_controller(), {"r": 0.1, "k": [2, 1]})
    assert values["k"].ravel().tolist() == [2, 1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"epsilom": 1}, r"no parameter 'epsilom'.*did you mean 'epsilon'\?"),
        ({"c": [1, 2, 3]}, r"c = \[1, 2, 3\] is not valid; give 2 numbers"),
        ({"c": [1, 0]}, "valid: positive"),
        ({"delta": -1}, "valid: non-negative"),
        ({"damping": 0.5}, "valid: true or false"),
        ({"Gamma": [[1, 2], [2, 1]]}, "positive definite"),
        ({"Gamma": [[1, 0.5], [0, 1]]}, "positive definite"),
        ({"epsilon": float("inf")}, "valid: positive"),
    ],
)
def test_values_that_are_refused(given, message):
    with pytest.raises(InvalidInput, match=message):
        complete_values(state_feedback_controller(), given)


def test_sign_of_b_m():
    with pytest.raises(InvalidInput, match=r"\+1 or -1"):
        complete_values(output_feedback_controller(), {"sign_b_m": 0})
