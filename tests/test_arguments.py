"""Wrong types and values in calls of the Python interface are refused in one line."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import congelation as cg
from congelation.arguments import checked
from congelation.sweep.local import Local

SYSTEM = cg.System((cg.Component("plant", "plant.fmu"),))
RUN = {"stop_time": 1.0, "step": 0.1}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cg.Component("plant", None), "Component: fmu = None is not valid; give a path"),
        (lambda: cg.Component(5, "p.fmu"), "Component: name = 5 is not valid; give a text"),
        (
            lambda: cg.Component("p", "p.fmu", {1: 2.0}),
            "Component: start = {1 = 2.0} is not valid; give a dictionary with names as keys",
        ),
        (lambda: cg.Connection("a.y", None), "Connection: target = None is not valid; give a text"),
        (
            lambda: cg.System(cg.Component("p", "p.fmu")),
            "System: components = a Component is not valid; give a list of Component",
        ),
        (
            lambda: cg.System((), ("a.y b.u",)),
            "connection 'a.y b.u': write it as 'plant.x -> controller.x'",
        ),
        (
            lambda: cg.System((), (("a.y", "b.u"),)),
            "System: connections = [['a.y', 'b.u']] is not valid; give a list of Connection",
        ),
        (lambda: cg.Experiment("1"), "stop_time = '1' is not valid; give a number"),
        (
            lambda: cg.Experiment(10**400, step=1.0),
            f"stop_time = 1{56 * '0'}... is not valid; give a finite number",
        ),
        (
            lambda: cg.Experiment(1.0, step=0.1, start_time=float("nan")),
            "start_time = nan is not valid; give a finite number",
        ),
        (
            lambda: cg.Experiment(1.0, step=0.1, coupling=cg.Hermite),
            "coupling = the class Hermite is not valid; give a text or a Coupling or an Auto",
        ),
        (
            lambda: cg.Experiment(1.0, step=0.1, max_steps=1.5),
            "max_steps = 1.5 is not valid; give an integer",
        ),
        (
            lambda: cg.Experiment(1.0, step=0.1, slave_tolerance=-1.0),
            "slave_tolerance -1 must be positive",
        ),
        (
            lambda: cg.simulate(SYSTEM, **RUN, record="plant.x"),
            "record = 'plant.x' is not valid; give a list of texts",
        ),
        (
            lambda: cg.simulate(SYSTEM, **RUN, output=0.5),
            "output = 0.5 is not valid; give an Output or a list of Output",
        ),
        (
            lambda: cg.simulate(SYSTEM, **RUN, options="x"),
            "options = 'x' is not valid; give a dictionary with names as keys",
        ),
        (
            lambda: cg.simulate(SYSTEM, **RUN, progress=1),
            "progress = 1 is not valid; give a function",
        ),
        (lambda: cg.Output(every=True), "Output: every = true is not valid; give an integer"),
        (
            lambda: cg.Hermite(max_iterations=1.5),
            "max_iterations = 1.5 is not valid; give an integer",
        ),
        (lambda: cg.Sampled("1"), "sample_time = '1' is not valid; give a number"),
        (
            lambda: cg.Scenario("T", SYSTEM, {"stop_time": 1.0}),
            "Scenario: experiment = {stop_time = 1.0} is not valid; give an Experiment",
        ),
        (
            lambda: cg.Scenario(
                "T", SYSTEM, cg.Experiment(**RUN), metrics=(cg.MetricSpec("p", "peak", "a.x"),) * 2
            ),
            "Scenario: metric 'p' is given twice; names must differ",
        ),
        (
            lambda: cg.run(None),
            "scenario = None is not valid; give a Scenario or a path",
        ),
        (
            lambda: cg.sweep("s.toml", retry="timed_out"),
            "retry = 'timed_out' is not valid; give a list of texts",
        ),
        (
            lambda: cg.open_results(5),
            "folder = 5 is not valid; give a path",
        ),
        (
            lambda: cg.info("p.fmu", 5),
            "fmus = 5 is not valid; give a path",
        ),
        (lambda: cg.Output(every=0), "every = 0 is not valid; give a whole number of at least 1"),
        (
            lambda: cg.certify("specs/scalar.toml", samples=0),
            "samples = 0 is not valid; give a whole number of at least 1",
        ),
        (
            lambda: cg.certify("specs/scalar.toml", seed=-1),
            "seed = -1 is not valid; give a whole number that is not negative",
        ),
        (
            lambda: cg.tune("specs/scalar.toml", stop_time=float("inf")),
            "stop_time = inf is not valid; give a positive time in seconds",
        ),
        (
            lambda: cg.attack("scenarios/scalar.toml", objectives=[]),
            "objectives is empty; name what is to be maximised",
        ),
        (
            lambda: cg.attack("scenarios/scalar.toml", variants=[]),
            "variants is empty; leave it out for all",
        ),
        (
            lambda: cg.attack("scenarios/scalar.toml", effort=float("inf")),
            "effort = inf is not valid; give a positive number",
        ),
        (
            lambda: cg.attack("scenarios/scalar.toml", workers=0),
            "workers = 0 is not valid; give a whole number of at least 1",
        ),
        (
            lambda: cg.load_scenario("s.toml", "x"),
            "experiment = 'x' is not valid; give a dictionary with names as keys",
        ),
        (
            lambda: cg.export_ssp("s.toml", "a.ssp"),
            "scenario = 's.toml' is not valid; give a Scenario",
        ),
        (
            lambda: cg.build(["s.toml"]),
            "specs = ['s.toml'] is not valid; give a Spec or a BlockSpec or a path",
        ),
        (lambda: cg.check([]), "paths is empty; give the FMUs to check"),
        (
            lambda: cg.check("p.fmu"),
            "paths = 'p.fmu' is not valid; give a list of paths",
        ),
        (
            lambda: cg.check(["p.fmu"], jobs=0),
            "jobs = 0 is not valid; give a whole number of at least 1",
        ),
        (
            lambda: cg.check(["p.fmu"], time_limit=float("nan")),
            "time_limit = nan is not valid; give a positive number of s",
        ),
        (lambda: Local(-1), "workers = -1 is not valid; give a whole number of at least 1"),
        (
            lambda: cg.verify(SYSTEM, None),
            "result = None is not valid; give a Result",
        ),
    ],
)
def test_what_is_of_another_type_is_named(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(cg.InvalidInput) as error:
        call()
    assert str(error.value) == message


def test_what_stands_for_a_type_is_taken() -> None:
    record = np.array(["plant.x"])
    experiment = cg.Experiment(
        np.float32(1.0), list(record), step=np.int64(1), max_steps=np.int8(3)
    )
    assert experiment.record == ("plant.x",)
    assert cg.Component("plant", Path("p.fmu")) == cg.Component("plant", Path("p.fmu"), {})
    parts = [cg.Component("a", "a.fmu"), cg.Component("b", "b.fmu")]
    assert cg.System(parts, ["a.y -> b.u"]) == cg.System(
        tuple(parts), (cg.Connection("a.y", "b.u"),)
    )


def test_types_of_any_form_are_read() -> None:
    @checked
    def pick(pair: tuple[float, float] | None = None, *names: str | Path) -> NotThere:  # type: ignore[name-defined]  # noqa: F821
        return pair, names

    assert pick((1, 2.0), "a", Path("b")) == ((1, 2.0), ("a", Path("b")))
    for wrong in ((1.0,), (1.0, "2"), 1.0, "ab"):
        with pytest.raises(cg.InvalidInput, match="give a pair of numbers"):
            pick(wrong)
    with pytest.raises(cg.InvalidInput, match="names = 3 is not valid; give a path"):
        pick(None, "a", 3)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_an_error_of_an_fmu_goes_to_other_processes(again: Callable[[object], object]) -> None:
    error = again(cg.SlaveError("plant", 1.0, "no", "fmi2DoStep"))
    assert isinstance(error, cg.SlaveError)
    assert (str(error), error.call) == ("plant at t = 1: no", "fmi2DoStep")
