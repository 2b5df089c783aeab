"""The host in C of docs/fmus.md, compiled as the page says and run where there is no Python."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import fmpy
import pytest

from tests.fmus.instance import loaded
from tests.native.test_twins import NATIVE
from tests.scenarios import ROOT


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("host")
    page = (ROOT / "docs" / "fmus.md").read_text("utf-8")
    (code,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    assert code.count("\n") <= 70
    (folder / "host.c").write_text(code, "utf-8")
    sources = Path(fmpy.extract(str(NATIVE / "ScalarPlant.fmu"), str(folder / "fmu"))) / "sources"
    flags = ["-std=gnu99", "-Wall", "-Wextra", "-Werror", f"-I{sources}"]
    program = folder / "host"
    subprocess.run(["gcc", *flags, str(folder / "host.c"), "-ldl", "-o", str(program)], check=True)
    return program


@pytest.mark.parametrize(
    ("name", "measured"), [("StateFeedbackController", 2), ("OutputFeedbackController", 1)]
)
def test_the_controller_runs_without_python(
    host: Path, tmp_path: Path, name: str, measured: int
) -> None:
    path = NATIVE / f"{name}.fmu"
    description = fmpy.read_model_description(str(path))
    folder = Path(fmpy.extract(str(path), str(tmp_path)))
    library = folder / "binaries" / "linux64" / f"{name}.so"
    samples = [[0.3 - 0.01 * k, -0.2 + 0.02 * k][:measured] for k in range(20)]
    with loaded(path) as (instance,):
        instance.start()
        expected = []
        for k, sample in enumerate(samples):
            names = instance.inputs[:measured]
            instance.assign(dict(zip(names, sample, strict=True)))
            expected += instance.get("u")
            assert instance.step(k * 1e-3, 1e-3) == 0
        u = instance.references["u"]
    needed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    assert {line.split()[0].partition(".")[0] for line in needed.splitlines()} <= {
        "linux-vdso", "libm", "libc", "/lib64/ld-linux-x86-64",
    }  # fmt: skip
    done = subprocess.run(
        [host, library, description.guid, "1e-3", str(measured), str(u)],
        input=" ".join(str(value) for sample in samples for value in sample),
        env={},  # no PATH, so no python3 on it
        capture_output=True,
        text=True,
        check=True,
    )
    assert [float(line) for line in done.stdout.split()] == expected
    wrong = subprocess.run(
        [host, library, "{another}", "1e-3", str(measured), str(u)],
        env={},
        capture_output=True,
        text=True,
        check=False,
    )
    assert wrong.returncode == 1
    assert "the GUID is {another}" in wrong.stderr
