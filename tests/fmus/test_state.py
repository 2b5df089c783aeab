"""The complete state: every later output repeats bit for bit, here and in another process."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fmus.instance import DISCARD, FMUS, loaded

ROOT = Path(__file__).resolve().parents[2]
H = 0.05


def run(instance, first, count):
    """Outputs after each of `count` steps with inputs that change."""
    rows = []
    for k in range(first, first + count):
        instance.assign(dict.fromkeys(instance.inputs, 0.1 * (k % 7) - 0.2))
        assert instance.step(k * H, H) == 0
        rows.append(instance.get(*instance.outputs))
    return rows


def test_replay(fmu):
    """Get, run on, set, run again; on the same instance and on a second one."""
    with loaded(fmu, 2) as (one, two):
        one.start()
        two.start()
        run(one, 0, 30)
        state = one.slave.getFMUstate()
        first = run(one, 30, 20)
        one.slave.setFMUstate(state)
        assert run(one, 30, 20) == first
        two.slave.setFMUstate(state)
        assert run(two, 30, 20) == first
        one.slave.freeFMUstate(state)


def test_several_handles(fmu):
    with loaded(fmu) as (instance,):
        instance.start()
        states = [instance.slave.getFMUstate()]
        rows = []
        for k in range(5):
            rows.append(run(instance, k, 1))
            states.append(instance.slave.getFMUstate())
        for k in (3, 0, 4, 1):
            instance.slave.setFMUstate(states[k])
            assert run(instance, k, 1) == rows[k]
        for state in states:
            instance.slave.freeFMUstate(state)


REPLAY = """
import json, sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.fmus.instance import loaded
from tests.fmus.test_state import run
with loaded(Path({fmu!r})) as (instance,):
    instance.start()
    state = instance.slave.deSerializeFMUstate(bytes.fromhex({state!r}))
    instance.slave.setFMUstate(state)
    print(json.dumps(run(instance, 30, 20)))
"""


def test_replay_in_another_process(fmu):
    with loaded(fmu) as (instance,):
        instance.start()
        run(instance, 0, 30)
        state = instance.slave.getFMUstate()
        data = instance.slave.serializeFMUstate(state)
        expected = run(instance, 30, 20)
        instance.slave.freeFMUstate(state)
    script = REPLAY.format(root=str(ROOT), fmu=str(fmu), state=bytes(data).hex())
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == json.loads(json.dumps(expected))


@pytest.mark.parametrize("damage", ["truncated", "altered", "foreign", "empty"])
def test_damaged_bytes_are_refused(fmu, damage):
    with loaded(fmu) as (instance,):
        instance.start()
        run(instance, 0, 3)
        state = instance.slave.getFMUstate()
        good = bytes(instance.slave.serializeFMUstate(state))
        bad = {
            "truncated": good[:-5],
            "altered": good[:-3] + b"9" + good[-2:],
            "foreign": good[:20] + b"x" + good[21:],
            "empty": b"?",
        }[damage]
        before = instance.get(*instance.outputs)
        handle = instance.slave.deSerializeFMUstate(bad)
        instance.slave.setFMUstate(handle)
        assert "the state is refused" in instance.errors()[-1]
        assert instance.get(*instance.outputs) == before
        assert instance.step(3 * H, H) == DISCARD
        instance.slave.setFMUstate(state)
        assert instance.step(3 * H, H) == 0
        for handle_ in (handle, state):
            instance.slave.freeFMUstate(handle_)


@pytest.mark.slow
def test_exit_of_the_host():
    """A host that has restored a state ends well; without the exit guard one in seven aborts.

    The fourteen hosts of `test_replay_in_another_process` have to end well, too.
    """
    fmu = FMUS / "MatchedPlant.fmu"
    with loaded(fmu) as (instance,):
        instance.start()
        run(instance, 0, 30)
        state = instance.slave.getFMUstate()
        data = bytes(instance.slave.serializeFMUstate(state))
        instance.slave.freeFMUstate(state)
    script = REPLAY.format(root=str(ROOT), fmu=str(fmu), state=data.hex())
    codes = [
        subprocess.run([sys.executable, "-c", script], capture_output=True).returncode
        for _ in range(8)
    ]
    assert codes == [0] * 8
