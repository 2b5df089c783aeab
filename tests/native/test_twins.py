"""The native FMUs against their Python twins: the same interface, and equal bits over a run."""

import ctypes
import math
import random
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest

from tests.fmus.instance import DISCARD, FMUS, Instance, loaded

NATIVE = FMUS / "native"
NAMES = sorted(path.stem for path in NATIVE.glob("*.fmu"))


def _both(name: str):  # type: ignore[no-untyped-def]
    return loaded(FMUS / f"{name}.fmu"), loaded(NATIVE / f"{name}.fmu")


def _same(one: list[float], other: list[float]) -> bool:
    return [float(x).hex() for x in one] == [float(x).hex() for x in other]


def _drive(instance: Instance, seed: int, **start: float) -> list[list[float]]:
    """What both twins compute over a run with steps, cubics and values from a seed.

    A law can be driven out of the range of numbers: the status of each step is in the rows, too.
    """
    twin = fmpy.read_model_description(str(FMUS / f"{instance.slave.modelIdentifier}.fmu"))
    shown = [v.name for v in twin.modelVariables if v.causality in ("output", "local")]
    draw = random.Random(seed)
    instance.start(**start)
    rows = [instance.get(*shown)]
    t = 0.0
    for _ in range(20):
        values = {name: draw.uniform(-1.0, 1.0) for name in instance.inputs}
        instance.assign(values)
        rows.append(instance.get(*shown))
        h = draw.choice((1e-4, 1e-3, 0.02, 0.1))
        status = instance.step(t, h)
        t += h if status == 0 else 0.0
        rows.append([float(status), *instance.get(*shown)])
    assert sum(row[0] == 0.0 for row in rows[2::2]) > 8
    return rows


@pytest.mark.parametrize("name", NAMES)
def test_variables_are_those_of_the_twin(name: str) -> None:
    one, other = (
        fmpy.read_model_description(str(folder / f"{name}.fmu")) for folder in (FMUS, NATIVE)
    )
    facts = [
        [
            (v.name, v.valueReference, v.type, v.causality, v.variability, v.initial, v.start)
            for v in description.modelVariables
        ]
        for description in (one, other)
    ]
    shared = len(facts[0])
    assert facts[0] == facts[1][:shared]
    further = facts[1][shared:]
    own = ["leave_at_jumps"] if any(name == "next_event" for name, *_ in facts[0]) else []
    own += ["capacity"] if name == "Delay" else []
    assert [row[0] for row in further[len(further) - len(own) :]] == own
    further = further[: len(further) - len(own)]
    assert all(n.startswith("der(") and causality == "local" for n, _, _, causality, *_ in further)
    assert one.guid != other.guid


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_equal_to_the_last_bit(name: str) -> None:
    one, other = _both(name)
    with one as (python,), other as (native,):
        rows = [_drive(instance, 7) for instance in (python, native)]
        assert len(rows[0]) == len(rows[1]) == 41
        for expected, actual in zip(*rows, strict=True):
            assert _same(expected, actual)


PROFILE = {
    "profile[1].mean": -0.3,
    "profile[1].sine[1].amplitude": 0.4,
    "profile[1].sine[1].omega": 3.0,
    "profile[1].square[1].amplitude": 0.5,
    "profile[1].square[1].period": 0.7,
    "profile[1].square[1].phase": 0.3,
    "profile[1].square[2].amplitude": 0.2,
    "profile[1].square[2].period": 1.4,
    "profile[1].chirp[1].amplitude": 0.6,
    "profile[1].chirp[1].omega_start": 1.0,
    "profile[1].chirp[1].omega_end": 9.0,
    "profile[1].chirp[1].duration": 2.0,
    "profile[1].telegraph[1].amplitude": 0.7,
    "profile[1].telegraph[1].rate": 5.0,
}


@pytest.mark.parametrize("name", ["ScalarPlant", "ObserverFormPlant", "Disturbance"])
def test_every_term_of_a_profile_is_equal_to_the_last_bit(name: str) -> None:
    one, other = _both(name)
    with one as (python,), other as (native,):
        rows = [_drive(instance, 3, **PROFILE) for instance in (python, native)]
        assert all(_same(a, b) for a, b in zip(*rows, strict=True))


ROWS = """time,value  # a header
-0.1, 0.25
0.2,1_0.5e-1 # a comment

0.35,-1.5e-1
0.5 , 0.0625
1.1,.5
"""


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("name", ["ScalarPlant", "Disturbance"])
def test_a_table_is_equal_to_the_last_bit(name: str, linear: bool, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_text("\ufeff" + ROWS.replace("\n", "\r\n"), "utf-8")
    table = {"profile[1].table.file": str(file), "profile[1].table.linear": linear}
    one, other = _both(name)
    with one as (python,), other as (native,):
        rows = [_drive(instance, 3, **PROFILE, **table) for instance in (python, native)]
        assert all(_same(a, b) for a, b in zip(*rows, strict=True))
        references = [native.references["profile[1].table.file"]]
        assert native.slave.getString(references) == [str(file).encode()]
        # The state holds the name of the file, from which another instance reads it.
        data = native.slave.serializeFMUstate(native.slave.getFMUstate())
        expected = native.get(*native.outputs)
        native.slave.reset()
        assert native.slave.getString(references) == [b""]
        native.slave.setFMUstate(native.slave.deSerializeFMUstate(data))
        assert native.get(*native.outputs) == expected


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "No such file or directory"),
        ("", "no rows; expected two columns time,value"),
        ("time,value\n", "no rows; expected two columns time,value"),
        ("0,1\n1,2,3\n", "line 2: '1,2,3' is not time,value (two finite numbers)"),
        ("time,value\n\ntime,value\n", "line 3: 'time,value' is not time,value"),
        ("0,inf\n", "line 1: '0,inf' is not time,value"),
        ("1,0\n0.5,1\n", "line 2: time 0.5 does not come after 1.0"),
        ("0,1e308\n1e-3,-1e308\n", "line 2: the step from 1e+308 to -1e+308 is beyond double"),
    ],
)
def test_a_bad_table_is_refused_as_by_the_twin(text: str | None, says: str, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    if text is not None:
        file.write_text(text, "utf-8")
    one, other = _both("ScalarPlant")
    with one as (python,), other as (native,):
        python.start(**{"profile[1].table.file": str(file)})
        with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
            native.start(**{"profile[1].table.file": str(file)})
        for instance in (python, native):
            assert f"profile[1]: table.file: table file '{file}'" in instance.errors()[0]
            assert says in instance.errors()[0]
        native.slave.reset()
        with pytest.raises(Exception, match="fmi2SetString"):
            native.assign({"profile[1].table.file": "x" * 512})


def test_gains_are_equal_to_the_last_bit() -> None:
    one, other = _both("OutputFeedbackController")
    draw = random.Random(11)
    with one as (python,), other as (native,):
        gains = [name for name in python.references if name.startswith("k[")]
        for _ in range(8):
            epsilon = 10 ** draw.uniform(-2.0, 0.5)
            values = {"epsilon": epsilon, "r": 1.0 + 10 ** draw.uniform(0.1, 3.0) / epsilon}
            found = []
            for instance in (python, native):
                instance.slave.reset()
                instance.start(**values)
                found.append(instance.get(*gains))
            assert _same(*found), values


def test_infeasible_values_are_refused_with_the_smallest_feasible_r() -> None:
    with loaded(NATIVE / "OutputFeedbackController.fmu") as (native,):
        native.slave.setupExperiment(startTime=0.0)
        native.slave.enterInitializationMode()
        native.assign({"r": 1.5, "epsilon": 0.01})
        with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
            native.slave.exitInitializationMode()
        (message,) = native.errors()
    with loaded(FMUS / "OutputFeedbackController.fmu") as (python,):
        python.start(r=1.5, epsilon=0.01)
        assert message == python.errors()[0]
    assert "the smallest feasible r is" in message


@pytest.mark.parametrize("name", ["StrictFeedbackPlant", "OutputFeedbackController", "Noise"])
def test_a_serialised_state_continues_in_another_instance(name: str) -> None:
    with loaded(NATIVE / f"{name}.fmu", count=2) as (one, other):
        one.start()
        assert one.step(0.0, 0.3) == 0
        state = one.slave.getFMUstate()
        data = one.slave.serializeFMUstate(state)
        one.slave.freeFMUstate(state)
        other.slave.setFMUstate(other.slave.deSerializeFMUstate(data))
        for instance in (one, other):
            assert instance.step(0.3, 0.4) == 0
        assert _same(one.get(*one.outputs), other.get(*other.outputs))
        for wrong in (b"", data[:-8], data[:60] + b"\x01" + data[61:], b"x" * len(data)):
            pointer = ctypes.c_void_p()
            status = other.slave.dll.fmi2DeSerializeFMUstate(
                ctypes.c_void_p(other.slave.component),
                wrong,
                ctypes.c_size_t(len(wrong)),
                ctypes.byref(pointer),
            )
            assert status == 3
            assert pointer.value is None


def test_input_derivatives_are_the_inputs_der() -> None:
    with loaded(NATIVE / "StateFeedbackController.fmu", count=2) as (one, other):
        for instance in (one, other):
            instance.start()
        one.assign({"x[1]": 0.5, "der(x[1])": 2.0, "der(x[1],2)": -3.0})
        other.assign({"x[1]": 0.5})
        reference = other.references["x[1]"]
        other.slave.setRealInputDerivatives([reference, reference], [1, 2], [2.0, -3.0])
        for instance in (one, other):
            assert instance.step(0.0, 0.1) == 0
        assert _same(one.get(*one.outputs), other.get(*other.outputs))
        u = one.references["u"]
        assert one.slave.getRealOutputDerivatives([u], [1]) == one.get("der(u)")


def test_bad_calls_return_an_error_and_change_nothing() -> None:
    with loaded(NATIVE / "ScalarController.fmu") as (native,):
        assert native.step(0.0, 0.1) == 3
        native.start()
        for h in (0.0, -1.0, math.nan):
            assert native.step(0.0, h) == 3
        assert native.step(5.0, 0.1) == 3
        before = native.get(*native.outputs)
        with pytest.raises(Exception, match="fmi2SetReal"):
            native.assign({"x": math.inf})
        with pytest.raises(Exception, match="fmi2SetReal"):
            native.assign({"gamma": 2.0})
        assert native.get(*native.outputs) == before
        assert native.step(0.0, 0.1) == 0
    assert "x = inf is refused: it must be finite" in native.errors()[-2]


def test_a_diverging_step_is_discarded() -> None:
    with loaded(NATIVE / "ScalarPlant.fmu") as (native,):
        native.start()
        native.set(u=1e308)
        before = native.get("x")
        assert native.step(0.0, 1e9) == 2
        assert native.get("x") == before


def test_a_step_is_left_at_a_jump_on_demand() -> None:
    """theta jumps at 0.35 and 0.7; the pieces of a step end where the whole one does."""
    path = NATIVE / "ScalarPlant.fmu"
    square = {"profile[1].square[1].amplitude": 0.5, "profile[1].square[1].period": 0.7}
    with loaded(path, count=2) as (whole, parts):
        whole.start(**square)
        parts.start(**square, leave_at_jumps=True)
        for instance in (whole, parts):
            instance.set(u=0.2)
        t, times = 0.0, []
        while t < 0.8:
            status = parts.step(t, 0.8 - t)
            t = parts.slave.getRealStatus(2)  # fmi2LastSuccessfulTime
            times.append((status, t))
        assert times == [(DISCARD, 0.35), (DISCARD, 0.7), (0, 0.8)]
        assert whole.step(0.0, 0.8) == 0
        assert whole.slave.getRealStatus(2) == 0.8
        for one, other in zip(whole.get(*whole.outputs), parts.get(*whole.outputs), strict=True):
            assert one == pytest.approx(other, rel=1e-9)
        # A jump at the very end of a step belongs to the next one.
        parts.slave.reset()
        parts.start(**square, leave_at_jumps=True)
        assert parts.step(0.0, 0.35) == 0
    assert "ended at the jump at t = 0.35" in parts.errors()[0]


def test_a_delay_remembers_as_the_twin() -> None:
    """Steps longer and shorter than the delay, jumps that are announced, and a memory that goes
    round its ring many times."""
    with (
        loaded(FMUS / "Delay.fmu") as (python,),
        loaded(NATIVE / "Delay.fmu", count=2) as (native, copy),
    ):
        python.start(delay=0.13)
        native.start(delay=0.13, capacity=40)
        draw, t, steps = random.Random(2), 0.0, 0
        names = native.outputs
        while steps < 400:
            h = draw.choice((0.004, 0.01, 0.01, 0.05, 0.3))
            value = draw.choice((0.0, 1.0, draw.uniform(-1.0, 1.0)))
            values = {"u[1]": value, "der(u[1])": 1.5, "der(u[1],2)": -2.0, "der(u[1],3)": 9.0}
            for instance in (python, native):
                instance.assign(values if steps % 3 else {"u[1]": value})
            assert _same(python.get(*names), native.get(*names))
            assert (python.step(t, h), native.step(t, h)) == (0, 0)
            assert _same(python.get(*names), native.get(*names))
            t, steps = t + h, steps + 1
            if steps % 50 == 0:
                data = native.slave.serializeFMUstate(native.slave.getFMUstate())
                copy.slave.setFMUstate(copy.slave.deSerializeFMUstate(data))
                assert _same(copy.get(*names), native.get(*names))
                native, copy = copy, native


def test_a_delay_refuses_what_its_capacity_does_not_hold() -> None:
    with loaded(NATIVE / "Delay.fmu") as (native,):
        native.start(capacity=3, delay=1.0)
        assert [native.step(k * 0.25, 0.25) for k in range(4)] == [0, 0, 0, DISCARD]
        assert native.step(0.75, 2.0) == 0
        assert "holds more than 3 steps of this length" in native.errors()[0]
        native.slave.reset()
        with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
            native.start(capacity=0)
        assert "capacity = 0 is refused: it must be positive" in native.errors()[1]
        # What comes out jumps at 1; a step ends there on demand.
        native.slave.reset()
        native.start(delay=1.0, leave_at_jumps=True, **{"before[1]": -1.0})
        native.assign({"u[1]": 0.5})
        assert native.step(0.0, 5.0) == DISCARD
        assert native.slave.getRealStatus(2) == 1.0
        assert native.get("y[1]") == [0.5]


def test_a_library_refuses_the_guid_of_another_fmu(tmp_path: Path) -> None:
    twin = fmpy.read_model_description(str(FMUS / "ScalarPlant.fmu"))
    folder = fmpy.extract(str(NATIVE / "ScalarPlant.fmu"), str(tmp_path))
    slave = fmpy.fmi2.FMU2Slave(
        guid=twin.guid,
        unzipDirectory=folder,
        modelIdentifier="ScalarPlant",
        instanceName="wrong",
    )
    with pytest.raises(Exception, match="instantiate"):
        slave.instantiate()


@pytest.mark.parametrize("flags", [(), ("-O3", "-std=c99", "-lm")])
def test_an_importer_can_compile_the_sources(flags: tuple[str, ...], tmp_path: Path) -> None:
    """Also without our flags: private names neither meet those of the C library nor are seen."""
    file = NATIVE / "OutputFeedbackController.fmu"
    folder = Path(fmpy.extract(str(file), str(tmp_path)))
    library = folder / "binaries" / "linux64" / f"{file.stem}.so"
    library.unlink()
    sources = folder / "sources"
    description = ElementTree.parse(folder / "modelDescription.xml")
    listed = [e.get("name", "") for e in description.iterfind("CoSimulation/SourceFiles/File")]
    assert sorted(path.name for path in sources.glob("*.c")) == listed
    command = ["gcc", "-shared", "-fPIC", *listed, *flags, "-o", str(library)]
    subprocess.run(command, cwd=sources, check=True)
    names = subprocess.run(
        ["nm", "--dynamic", "--defined-only", str(library)],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    assert names.count(" T fmi2") > 30
    assert all(line.split()[-1].startswith("fmi2") for line in names.splitlines())
    rebuilt = tmp_path / "rebuilt.fmu"
    with zipfile.ZipFile(rebuilt, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path != rebuilt:
                archive.write(path, path.relative_to(folder))
    with loaded(file) as (shipped,), loaded(rebuilt) as (compiled,):
        rows = [_drive(instance, 7) for instance in (shipped, compiled)]
        assert all(_same(a, b) for a, b in zip(*rows, strict=True))


def test_the_sources_of_two_fmus_link_into_one_program(tmp_path: Path) -> None:
    """With the prefix that FMI 2.0 asks for; no name is defined twice, and no warning is given."""
    objects: list[str] = []
    for name in ("ScalarPlant", "ScalarController"):
        sources = Path(fmpy.extract(str(NATIVE / f"{name}.fmu"), str(tmp_path / name))) / "sources"
        files = sorted(path.name for path in sources.glob("*.c"))
        flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
        subprocess.run(
            ["gcc", *flags, f"-DFMI2_FUNCTION_PREFIX={name}_", "-c", *files],
            cwd=sources,
            check=True,
        )
        objects += [str(sources / file.replace(".c", ".o")) for file in files]
    main = tmp_path / "main.c"
    main.write_text(
        "#include <stdio.h>\n"
        "const char *ScalarPlant_fmi2GetVersion(void), *ScalarController_fmi2GetVersion(void);\n"
        "int main(void) { puts(ScalarPlant_fmi2GetVersion()); "
        "puts(ScalarController_fmi2GetVersion()); return 0; }\n",
        "utf-8",
    )
    program = tmp_path / "program"
    subprocess.run(["gcc", str(main), *objects, "-lm", "-o", str(program)], check=True)
    done = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    assert done.stdout == "2.0\n2.0\n"
