"""One FMU instance: states, resets, failures, messages."""

import zipfile

import numpy as np
import pytest

from congelation.cosim.pool import SlavePool
from congelation.cosim.system import Component, System
from congelation.errors import InvalidInput, SlaveError
from congelation.fmi.description import describe
from congelation.fmi.library import unpack
from congelation.fmi.slave import Slave, StepDiscarded
from congelation.fmi.start_values import resolve_start


def ready(fmus, name, start=None, instance="s"):
    description = describe(fmus / f"{name}.fmu")
    slave = Slave(instance, description)
    begin(slave, start)
    return slave


def begin(slave, start=None):
    slave.setup(0.0)
    slave.set_values(resolve_start(slave.description, start or {}, "test"))
    slave.enter_initialization()
    slave.exit_initialization()


def reals(slave, *names):
    variables = slave.description.variables
    return slave.get_values("Real", [variables[name].reference for name in names])


def steps(slave, count, start=0):
    rows = []
    for k in range(start, start + count):
        slave.step(0.125 * k, 0.125)
        rows.append(reals(slave, "x[1]", "x[2]", "der(x[2])"))
    return rows


def test_a_restored_state_repeats_every_bit(fmus):
    with ready(fmus, "TestPlant", {"a": 1.0}) as slave:
        steps(slave, 3)
        state = slave.save()
        first = steps(slave, 8, start=3)
        slave.restore(state)
        assert steps(slave, 8, start=3) == first


def test_a_state_can_be_saved_over(fmus):
    with ready(fmus, "TestPlant") as slave:
        state = slave.save()
        steps(slave, 2)
        slave.save_into(state)
        later = reals(slave, "x[1]")
        steps(slave, 2, start=2)
        slave.restore(state)
        assert reals(slave, "x[1]") == later


def test_a_serialized_state_goes_to_another_instance(fmus):
    with ready(fmus, "TestPlant") as one, ready(fmus, "TestPlant", instance="t") as two:
        steps(one, 3)
        two.restore(two.deserialize(one.serialize(one.save())))
        assert steps(two, 4, start=3) == steps(one, 4, start=3)


def test_two_instances_do_not_touch_each_other(fmus):
    with ready(fmus, "TestPlant") as alone:
        expected = steps(alone, 4)
    with ready(fmus, "TestPlant") as one, ready(fmus, "TestPlant", {"w": 9.0}, "t") as two:
        found = []
        for k in range(4):
            found += steps(one, 1, start=k)
            steps(two, 1, start=k)
    assert found == expected


def test_a_reset_instance_is_as_new(fmus):
    with ready(fmus, "TestPlant") as slave:
        expected = steps(slave, 4)
        slave.reset()
        begin(slave)
        assert steps(slave, 4) == expected


def test_preallocated_access_equals_plain_access(fmus):
    with ready(fmus, "TestGain", {"k": 3.0}) as slave:
        variables = slave.description.variables
        values, outputs = np.zeros(2), np.zeros(2)
        write = slave.bound(
            "fmi2SetReal", [variables[n].reference for n in ("u", "der(u)")], [], values
        )
        read = slave.bound(
            "fmi2GetReal", [variables[n].reference for n in ("y", "der(y)")], [], outputs
        )
        values[:] = [2.0, 0.5]
        write()
        read()
        assert outputs.tolist() == [6.0, 1.5] == reals(slave, "y", "der(y)")


def test_a_discarded_step_carries_the_logged_message(fmus):
    with ready(fmus, "TestFaulty", {"mode": 1.0, "at": 0.3}) as slave:
        slave.step(0.0, 0.25)
        with pytest.raises(StepDiscarded, match="the valve is stuck, 100% open") as caught:
            slave.step(0.25, 0.25)
    assert (caught.value.component, caught.value.time) == ("s", 0.25)


def test_an_exception_in_an_fmu_is_a_failure_and_the_instance_is_abandoned(fmus):
    with ready(fmus, "TestFaulty", {"mode": 2.0, "at": 0.0}) as slave:
        with pytest.raises(SlaveError, match="the slave fell over"):
            slave.step(0.0, 0.25)
        assert not slave.usable


def test_a_failing_call_gives_the_logged_message_in_one_line(fmus):
    with ready(fmus, "TestPlant") as slave, pytest.raises(SlaveError, match="setReal") as caught:
        slave.bound("fmi2SetReal", [10**6], [], np.zeros(1))()
    assert "\n" not in str(caught.value)


def test_a_logged_error_during_initialisation_is_a_failure(fmus):
    with (
        ready(fmus, "TestFaulty", {"r": -200.0}) as slave,
        pytest.raises(SlaveError, match="at least -100"),
    ):
        slave.require_no_error()


def test_nothing_is_printed(fmus, capfd):
    with ready(fmus, "TestFaulty", {"mode": 1.0}) as slave, pytest.raises(StepDiscarded):
        slave.step(0.0, 1.0)
    assert capfd.readouterr() == ("", "")


def test_one_folder_serves_all_instances_of_an_fmu(fmus):
    description = describe(fmus / "TestPlant.fmu")
    assert unpack(description) == unpack(description)


def test_the_pool_reuses_instances_and_drops_broken_ones(fmus):
    members = System((Component("s", fmus / "TestFaulty.fmu"),)).resolve().members
    with SlavePool() as pool:
        with pool.lend(members) as (first,):
            begin(first)
        with pool.lend(members) as (second,):
            assert second is first
            begin(second, {"mode": 2.0, "at": 0.0})
            with pytest.raises(SlaveError):
                second.step(0.0, 1.0)
        with pool.lend(members) as (third,):
            assert third is not first
            assert third.usable
    assert not third.usable


def test_two_python_fmus_with_one_module_name_are_told_apart(fmus, tmp_path):
    """The second one doubles k u; loaded after the first, it would run the first one's code."""
    other = tmp_path / "Other.fmu"
    with zipfile.ZipFile(fmus / "TestGain.fmu") as archive, zipfile.ZipFile(other, "w") as copy:
        for name in archive.namelist():
            data = archive.read(name)
            if name.endswith("cosim_test_gain.py"):
                data = data.replace(b"k * u", b"2 * k * u")
            copy.writestr(name, data)
    with ready(fmus, "TestGain"), pytest.raises(InvalidInput) as caught:
        Slave("other", describe(other))
    assert "Other.fmu and" in str(caught.value)
    assert "'cosim_test_gain.py'" in str(caught.value)
