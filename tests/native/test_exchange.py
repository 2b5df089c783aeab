"""Model exchange and directional derivatives of the native FMUs."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from congelation.cosim.system import System
from congelation.scenario.load import load_scenario
from congelation.verify.reference import reference
from tests.fmus.instance import Instance, loaded
from tests.native.test_twins import NAMES, NATIVE, PROFILE
from tests.scenarios import ROOT

Floats = np.ndarray


class Exchange:
    """A model exchange in continuous-time mode, driven as an importer does."""

    def __init__(self, instance: Instance, path: Path, **start: float) -> None:
        self.instance, self.slave = instance, instance.slave
        description = fmpy.read_model_description(str(path))
        rates = [unknown.variable for unknown in description.derivatives]
        self.rate_names = [v.name for v in rates]
        self.state_names = [v.derivative.name for v in rates]
        self.count = len(rates)
        self._buffer = (ctypes.c_double * max(self.count, 1))()
        instance.start(**start)
        self.next_event = self.event()

    def event(self) -> float:
        """Through event mode, from there to continuous-time mode; the next time event."""
        again, stop, _, changed, defined, time = self.slave.newDiscreteStates()
        assert (again, stop, changed) == (False, False, False)
        self.slave.enterContinuousTimeMode()
        return float(time) if defined else float("inf")

    @property
    def x(self) -> Floats:
        self.slave.getContinuousStates(self._buffer, self.count)
        return np.array(self._buffer[: self.count])

    @x.setter
    def x(self, values: Sequence[float]) -> None:
        self._buffer[: self.count] = list(values)
        self.slave.setContinuousStates(self._buffer, self.count)

    @property
    def rates(self) -> Floats:
        self.slave.getDerivatives(self._buffer, self.count)
        return np.array(self._buffer[: self.count])


@contextmanager
def exchange(path: Path, **start: float) -> Iterator[Exchange]:
    with loaded(path, exchange=True) as (instance,):
        yield Exchange(instance, path, **start)


@pytest.mark.parametrize("name", ["ScalarPlant", "ObserverFormPlant", "Reference", "Noise"])
def test_both_kinds_agree_in_fmpy(name: str) -> None:
    """FMPy's own solver (CVode), with jumps, against the steps of the FMU."""
    path = NATIVE / f"{name}.fmu"
    description = fmpy.read_model_description(str(path))
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    start = {key: PROFILE[key] for key in PROFILE if "square" in key or "mean" in key}
    runs = [
        fmpy.simulate_fmu(
            str(path),
            fmi_type=kind,
            start_values={k: v for k, v in start.items() if name != "Noise" or "mean" in k},
            stop_time=1.0,
            output_interval=0.09,  # no multiple of an event
            relative_tolerance=1e-9,
            output=outputs,
        )
        for kind in ("ModelExchange", "CoSimulation")
    ]
    # Rows of model exchange come at events, too.
    rows = {round(float(row["time"]), 9): row for row in runs[0]}
    compared = 0
    for row in runs[1]:
        other = rows.get(round(float(row["time"]), 9))
        if other is not None:
            compared += 1
            for output in outputs:
                assert other[output] == pytest.approx(row[output], rel=1e-5, abs=1e-7), output
    assert compared > 8


class Loop:
    """Plant and controller of a scenario as one differential equation, by model exchange."""

    def __init__(self, parts: Sequence[Exchange], system: System) -> None:
        self.parts = parts
        resolved = system.resolve()
        self.links = [
            (parts[link.source], link.output.reference, parts[link.target], link.input.reference)
            for link in resolved.links
        ]
        self.sizes = np.cumsum([0, *(part.count for part in parts)])

    def rates(self, t: float, x: Floats) -> Floats:
        for i, part in enumerate(self.parts):
            part.slave.setTime(t)
            if part.count:
                part.x = x[self.sizes[i] : self.sizes[i + 1]]
        # The plant's outputs do not follow from its inputs: one pass in the order of connections.
        for source, output, target, input_ in self.links:
            target.slave.setReal([input_], source.slave.getReal([output]))
        return np.concatenate([part.rates for part in self.parts])

    def solve(self, times: Floats) -> Floats:
        t, x = float(times[0]), np.concatenate([part.x for part in self.parts])
        rows = [x]
        while t < times[-1]:
            end = min([times[-1], *(part.next_event for part in self.parts)])
            inside = times[(times > t) & (times <= end)]
            found = solve_ivp(
                self.rates,
                (t, end),
                x,
                method="DOP853",
                rtol=1e-11,
                atol=1e-12,
                t_eval=[*inside, *([] if end in inside else [end])],
            )
            assert found.success
            rows += list(found.y.T[: len(inside)])
            t, x = end, found.y[:, -1]
            self.rates(t, x)
            for part in self.parts:
                part.slave.enterEventMode()
                part.next_event = part.event()
        return np.array(rows)


@pytest.mark.parametrize(("name", "variant"), [("fig2", 1), ("fig3", 0)])
def test_a_loop_by_model_exchange_is_the_monolithic_solution(name: str, variant: int) -> None:
    """theta jumps five times in the three seconds; the loop is derived anew for comparison."""
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    case = scenario.case(scenario.variants[variant].settings)
    system = replace(
        case.system,
        components=tuple(replace(c, fmu=NATIVE / Path(c.fmu).name) for c in case.system.components),
    )
    times = np.linspace(0.0, 3.0, 31)
    starts = [
        {s.variable.name: s.value for s in member.start} for member in system.resolve().members
    ]
    with (
        exchange(Path(system.components[0].fmu), **starts[0]) as plant,
        exchange(Path(system.components[1].fmu), **starts[1]) as controller,
    ):
        loop = Loop((plant, controller), system)
        rows = loop.solve(times)
        names = [
            f"{component.name}.{state}"
            for component, part in zip(system.components, loop.parts, strict=True)
            for state in part.state_names
        ]
    expected = reference(case).solve(times)
    assert set(names) <= set(expected)
    for i, column in enumerate(names):
        peak = np.max(np.abs(expected[column]))
        assert np.max(np.abs(rows[:, i] - expected[column])) <= 2e-8 * max(peak, 1.0), column


def _set_randomly(part: Exchange, draw: random.Random) -> dict[str, float]:
    """States and inputs at random; the inputs."""
    values = {name: draw.uniform(-0.8, 0.8) for name in part.instance.inputs}
    part.instance.assign(values)
    if part.count:
        part.x = [draw.uniform(-0.8, 0.8) for _ in range(part.count)]
    return values


@pytest.mark.parametrize("name", [name for name in NAMES if name != "Delay"])
def test_directional_derivatives_are_those_of_finite_differences(name: str) -> None:
    """All unknowns with respect to all inputs and states at once, in a random direction."""
    draw = random.Random(5)
    with exchange(NATIVE / f"{name}.fmu") as part:
        instance = part.instance
        unknowns = list(dict.fromkeys([*instance.outputs, *part.rate_names]))
        values = _set_randomly(part, draw)
        x = part.x
        seeds = {known: draw.uniform(-1.0, 1.0) for known in (*values, *part.state_names)}
        references = instance.references
        found = instance.slave.getDirectionalDerivative(
            [references[u] for u in unknowns],
            [references[k] for k in seeds],
            list(seeds.values()),
        )

        def at(step: float) -> Floats:
            instance.assign({k: v + step * seeds[k] for k, v in values.items()})
            if part.count:
                part.x = [a + step * seeds[k] for a, k in zip(x, part.state_names, strict=True)]
            return np.array([0.0 if u == "next_event" else instance.get(u)[0] for u in unknowns])

        # Richardson's extrapolation of central differences: an error of h^4.
        h = 1e-3
        wide, narrow = ((at(s) - at(-s)) / (2 * s) for s in (2 * h, h))
        expected = (4 * narrow - wide) / 3
        scale = np.maximum(np.abs(expected), np.max(np.abs(expected)) * 1e-3 + 1e-6)
        assert np.all(np.abs(found - expected) <= 1e-5 * scale), dict(
            zip(unknowns, zip(found, expected, strict=True), strict=True)
        )
        assert np.any(expected != 0.0) or not seeds


def test_directional_derivatives_of_a_co_simulation() -> None:
    """Inputs act at the communication point; before the first one, start values are known, too."""
    path = NATIVE / "StateFeedbackController.fmu"
    with loaded(path) as (one,):
        references = one.references
        one.slave.setupExperiment(startTime=0.0)
        one.slave.enterInitializationMode()
        one.assign({"x[1]": 0.4, "x[2]": -0.2, "theta_hat0[1]": 0.3})

        def derivative(unknown: str, known: str) -> float:
            (value,) = one.slave.getDirectionalDerivative(
                [references[unknown]], [references[known]], [1.0]
            )
            return float(value)

        def difference(unknown: str, known: str, at: float) -> float:
            values = []
            for h in (-1e-5, 1e-5):
                one.assign({known: at + h})
                values.append(one.get(unknown)[0])
            one.assign({known: at})
            return (values[1] - values[0]) / 2e-5

        for known, at in (("x[1]", 0.4), ("theta_hat0[1]", 0.3)):
            expected = difference("u", known, at)
            assert derivative("u", known) == pytest.approx(expected, rel=1e-7)
        assert derivative("theta_hat[1]", "theta_hat0[1]") == 1.0
        with pytest.raises(Exception, match="fmi2GetDirectionalDerivative"):
            derivative("u", "epsilon")
        assert "derivatives with respect to epsilon are not known" in one.errors()[-1]
        one.slave.exitInitializationMode()
        assert one.step(0.0, 0.1) == 0
        assert derivative("u", "x[2]") == pytest.approx(difference("u", "x[2]", -0.2), rel=1e-7)
        with pytest.raises(Exception, match="fmi2GetDirectionalDerivative"):
            derivative("u", "theta_hat0[1]")


def test_inputs_of_model_exchange_are_values_at_all_times() -> None:
    """der(v) changes the outputs der(.) alone."""
    with exchange(NATIVE / "StateFeedbackController.fmu") as part:
        part.instance.assign({"x[1]": 0.5, "x[2]": 0.1})
        part.slave.setTime(0.2)
        before, slope = part.rates, part.instance.get("der(u)")
        part.instance.assign({"der(x[1])": 3.0, "der(x[1],2)": 5.0})
        part.slave.setTime(0.3)
        assert list(part.rates) == list(before)
        assert part.instance.get("der(u)") != slope


def test_the_piece_of_the_profile_changes_in_event_mode_alone() -> None:
    start = {f"profile[1].sine[{k}].amplitude": 0.0 for k in (1, 2)}
    start |= {"profile[1].square[1].amplitude": 0.5, "profile[1].square[1].period": 0.7}
    with exchange(NATIVE / "ScalarPlant.fmu", **start) as part:
        assert part.next_event == pytest.approx(0.35, abs=1e-15)
        before = part.instance.get("theta[1]")
        # The solver looks at the end of the piece, and behind it.
        for t in (part.next_event, 0.36):
            part.slave.setTime(t)
            assert part.instance.get("theta[1]") == before
            assert part.instance.get("next_event") == [part.next_event]
        part.slave.setTime(part.next_event * (1 - 1e-16))
        state = part.slave.getFMUstate()
        part.slave.enterEventMode()
        assert part.event() == pytest.approx(0.7, abs=1e-15)
        assert part.instance.get("theta[1]") == [before[0] - 1.0]
        part.slave.setFMUstate(state)
        assert part.instance.get("theta[1]") == before
        part.slave.freeFMUstate(state)


def test_a_delay_is_for_co_simulation_alone() -> None:
    path = NATIVE / "Delay.fmu"
    description = fmpy.read_model_description(str(path))
    assert description.modelExchange is None
    with pytest.raises(Exception, match="instantiate"), loaded(path, exchange=True):
        pass


def test_a_state_belongs_to_one_kind() -> None:
    path = NATIVE / "ScalarPlant.fmu"
    with exchange(path) as part, loaded(path) as (slave,):
        part.slave.setTime(0.1)
        part.x = [0.7]
        part.instance.assign({"u": 0.3})
        data = part.slave.serializeFMUstate(part.slave.getFMUstate())
        rates = list(part.rates)
        part.x = [5.0]
        part.slave.setFMUstate(part.slave.deSerializeFMUstate(data))
        assert list(part.rates) == rates
        with pytest.raises(Exception, match="fmi2SetFMUstate"):
            slave.slave.setFMUstate(slave.slave.deSerializeFMUstate(data))
        assert "the other kind" in slave.errors()[-1]


def test_calls_out_of_order_are_refused() -> None:
    path = NATIVE / "ScalarPlant.fmu"
    with exchange(path) as part, loaded(path) as (slave,):
        slave.start()
        step = (ctypes.c_double(0.0), ctypes.c_double(0.1), ctypes.c_int(1))
        info = (ctypes.byref(fmpy.fmi2.fmi2EventInfo()),)
        rates = ((ctypes.c_double * 1)(), ctypes.c_size_t(1))
        for instance, where, calls in (
            (
                part.instance,
                "in continuous-time mode of a model exchange",
                {
                    "fmi2EnterContinuousTimeMode": (),
                    "fmi2NewDiscreteStates": info,
                    "fmi2DoStep": step,
                },
            ),
            (
                slave,
                "after initialization of a co-simulation",
                {
                    "fmi2SetTime": (ctypes.c_double(1.0),),
                    "fmi2EnterEventMode": (),
                    "fmi2GetDerivatives": rates,
                },
            ),
        ):
            for name, arguments in calls.items():
                function = getattr(instance.slave.dll, name)
                assert function(ctypes.c_void_p(instance.slave.component), *arguments) == 3
                assert instance.errors()[-1].endswith(f"{name} was called {where}")
        with pytest.raises(Exception, match="fmi2SetContinuousStates"):
            part.x = [float("nan")]
        assert "x = nan is refused" in part.instance.errors()[-1]
