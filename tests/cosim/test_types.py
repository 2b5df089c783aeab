"""What is composed in Python of the wrong types is refused in one line, where it is composed."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import pytest

import congelation as cg
from congelation.errors import InvalidInput
from congelation.sweep.local import Local
from tests.scenarios import FMUS

PLANT = FMUS / "ScalarPlant.fmu"
TO = "/nowhere/that/is/written"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cg.Component("plant", None), r"component 'plant': fmu = None is not valid"),
        (lambda: cg.Component(5, PLANT), r"Component\.name = 5 is not valid; give a string"),
        (lambda: cg.Component("plant", PLANT, "x0=1"), r"start = 'x0=1' is not valid; give values"),
        (lambda: cg.Component("plant", PLANT, {1: 2.0}), r"a name in start = 1 is not valid"),
        (lambda: cg.Connection(None, "plant.u"), r"Connection\.source = None is not valid"),
        (lambda: cg.System(None), r"System\.components = None is not valid; give a tuple"),
        (
            lambda: cg.System(cg.Component("plant", PLANT)),
            r"System\.components = Component.* is not valid|System\.components = ",
        ),
        (
            lambda: cg.System((cg.Component("plant", PLANT),), ("plant.x -> controller.x",)),
            r"connections\[0\] = 'plant\.x -> controller\.x' is not valid; give a Connection, such",
        ),
        (lambda: cg.Output(every=1.5), r"every = 1\.5 is not valid; give a whole number of at"),
        (lambda: cg.Output(every=True), r"every = true is not valid"),
        (lambda: cg.Output(interval="1"), r"interval = '1' is not valid; give a number of seconds"),
        (lambda: cg.Sampled("1"), r"sample_time = '1' is not valid"),
        (lambda: cg.Sampled(0.1, delay=True), r"delay = true is not valid; give 0 or 1"),
        (lambda: cg.certify("specs/scalar.toml", samples=0), r"samples = 0 is not valid"),
        (lambda: cg.certify("specs/scalar.toml", seed=-1), r"seed = -1 is not valid"),
        (lambda: cg.certify("specs/scalar.toml", umax="x"), r"umax = 'x' is not valid"),
        (lambda: cg.tune("specs/scalar.toml", stop_time=float("inf")), r"stop_time = inf is not"),
        (lambda: cg.tune("specs/scalar.toml", evaluations="9"), r"evaluations = '9' is not valid"),
        (lambda: cg.attack("scenarios/scalar.toml", objectives=[]), r"objectives is empty"),
        (lambda: cg.attack("scenarios/scalar.toml", variants=[]), r"variants is empty"),
        (lambda: cg.attack("scenarios/scalar.toml", effort=float("inf")), r"effort = inf is not"),
        (lambda: cg.attack("scenarios/scalar.toml", workers=0), r"workers = 0 is not valid"),
        (lambda: cg.check([]), r"paths is empty; give the FMUs to check"),
        (lambda: cg.check(PLANT), r"paths = .* is not valid; give a tuple, each entry the path"),
        (lambda: cg.check([PLANT], jobs=0), r"jobs = 0 is not valid"),
        (lambda: cg.check([PLANT], time_limit=float("nan")), r"time_limit = nan is not valid"),
        (lambda: cg.run(None), r"scenario = None is not valid; give a Scenario, or the path"),
        (lambda: cg.run("scenarios/scalar.toml", out=""), r"out is empty"),
        (lambda: cg.run("scenarios/scalar.toml", out=TO, timeout=-1), r"timeout = -1 is not valid"),
        (lambda: cg.run("scenarios/scalar.toml", out=TO, timeout="1"), r"timeout = '1' is not"),
        (lambda: cg.load_scenario(None), r"file = None is not valid; give the path of a"),
        (lambda: cg.load_scenario("scenarios/scalar.toml", "x"), r"experiment = 'x' is not valid"),
        (lambda: cg.export_ssp("scenarios/scalar.toml", "a.ssp"), r"scenario = .* give a Scenario"),
        (lambda: cg.build(["specs/scalar.toml"]), r"spec = \['specs/scalar\.toml'\] is not valid"),
        (lambda: Local(-1), r"workers = -1 is not valid; give a whole number of at least 1"),
        (lambda: Local(1.5), r"workers = 1\.5 is not valid"),
    ],
)
def test_a_part_of_the_wrong_type_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_an_error_of_an_fmu_goes_to_other_processes(again: Callable[[object], object]) -> None:
    error = again(cg.SlaveError("plant", 1.0, "no", "fmi2DoStep"))
    assert isinstance(error, cg.SlaveError)
    assert (str(error), error.call) == ("plant at t = 1: no", "fmi2DoStep")
