"""What docs/signals.md shows is true: its Python runs, its C gives the same bits."""

import ctypes
import math
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from congelation.signals import (
    Profile,
    Slots,
    Telegraph,
    box_radius,
    flat_parameters,
    profile,
    splitmix64,
)

TEXT = (Path(__file__).parents[2] / "docs" / "signals.md").read_text()


def block(language, containing):
    (found,) = [
        code
        for code in re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)
        if containing in code
    ]
    return found


def test_python_example():
    names = {}
    exec(block("python", "box_radius"), names)
    assert {"theta_1", "theta_2"} <= set(names)


def test_toml_example(tmp_path):
    (tmp_path / "wind.csv").write_text("time,value\n0,1\n1,2\n")
    specs = tomllib.loads(block("toml", "telegraph"))["components"]["plant"]["profile"]
    profiles = [Profile.from_spec(spec, name, str(tmp_path)) for name, spec in specs.items()]
    assert len(profiles) == 7
    assert box_radius(profiles[:2]) == math.sqrt(2.0)


def test_parameter_table_lists_every_parameter():
    rows = TEXT.split("| parameter | type | default |")[1].split("\n\n")[0].splitlines()[2:]
    listed = []
    for row in rows:
        first, *others = re.findall(r"`([^`]*)`", row)
        listed += [first, *(first.rpartition(".")[0] + other for other in others)]
    parameters = flat_parameters(Slots(1, 1, 1, 1, True))
    assert listed == [p.name.replace("[1]", "[k]") for p in parameters]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("telegraph")
    (folder / "telegraph.c").write_text(block("c", "splitmix64"))
    subprocess.run(
        [
            "cc",
            "-std=c99",
            "-O2",
            "-ffp-contract=off",
            "-Wall",
            "-Werror",
            "-shared",
            "-fPIC",
            "-o",
            "telegraph.so",
            "telegraph.c",
            "-lm",
        ],
        cwd=folder,
        check=True,
    )
    loaded = ctypes.CDLL(str(folder / "telegraph.so"))
    loaded.splitmix64.argtypes = [ctypes.c_uint64, ctypes.c_uint64]
    loaded.splitmix64.restype = ctypes.c_uint64
    loaded.first_sign.argtypes = [ctypes.c_uint64]
    loaded.jump.argtypes = [ctypes.c_uint64, ctypes.c_double, ctypes.c_uint64, ctypes.c_double]
    loaded.jump.restype = ctypes.c_double
    return loaded


@pytest.mark.parametrize(("seed", "rate"), [(0, 1.0), (7, 0.3), (1234567, 17.5), (2**31 - 1, 2.0)])
def test_c_gives_the_same_bits(library, seed, rate):
    signal = profile(Telegraph(1.0, rate, seed))
    assert library.first_sign(seed) == signal.value(0.0)
    t = 0.0
    for k in range(1, 2001):
        assert library.splitmix64(seed, k) == splitmix64(seed, k)
        jump = library.jump(seed, rate, k, t)
        t = signal.next_event(t)
        assert t == jump
