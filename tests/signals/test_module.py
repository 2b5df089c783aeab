"""The package travels into FMUs: on its own, on Python 3.9, with the standard library."""

import ast
import importlib
import inspect
import shutil
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from congelation import signals
from congelation.export.spec import read_spec
from congelation.export.stage import stage

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(signals.__file__).parent
SOURCES = {file.name: file.read_text("utf-8") for file in sorted(FOLDER.glob("*.py"))}
each_module = pytest.mark.parametrize("name", SOURCES)


@each_module
def test_imports_the_standard_library_and_its_neighbours(name):
    for node in ast.walk(ast.parse(SOURCES[name])):
        if isinstance(node, ast.ImportFrom) and node.level:
            assert node.level == 1
            assert f"{node.module}.py" in SOURCES
        elif isinstance(node, ast.ImportFrom):
            assert node.module.split(".")[0] in sys.stdlib_module_names
        elif isinstance(node, ast.Import):
            assert {alias.name.split(".")[0] for alias in node.names} <= sys.stdlib_module_names


@each_module
def test_is_python_3_9(name):
    source = SOURCES[name]
    ast.parse(source, feature_version=(3, 9))
    assert "from __future__ import annotations" in source
    assert "strict=" not in source
    assert "slots=True" not in source
    assert "kw_only" not in source


def test_loads_under_another_name(tmp_path, monkeypatch):
    shutil.copytree(FOLDER, tmp_path / "fmu_0123456789" / "signals")
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    module = importlib.import_module("fmu_0123456789.signals")
    new = set(sys.modules) - before
    try:
        assert module.profile(1.0, module.Sine(2.0, 1.0)).value(0.0) == 1.0
        assert module.Sine is not signals.Sine
        assert all(other.startswith("fmu_0123456789") for other in new)
    finally:
        for other in new:
            del sys.modules[other]


def test_travels_whole():
    """The built plant holds every module, to the letter."""
    with ZipFile(ROOT / "fmus" / "ScalarPlant.fmu") as archive:
        inside = {
            name.rsplit("/", 1)[1]: archive.read(name).decode("utf-8")
            for name in archive.namelist()
            if "/signals/" in name
        }
    assert inside == SOURCES


def staged_digest(folder):
    spec = read_spec(ROOT / "specs" / "scalar.toml")
    return stage(spec.plant, spec, ROOT / "fmu_src", folder).digest


def test_every_module_counts_in_the_digest(tmp_path, monkeypatch):
    """A change of any module gives an FMU of another name, so that none runs another's code."""
    copy = tmp_path / "signals"
    shutil.copytree(FOLDER, copy)
    digests = [staged_digest(tmp_path / "as_is")]
    monkeypatch.setattr(signals, "__file__", str(copy / "__init__.py"))
    for name, source in SOURCES.items():
        (copy / name).write_text(source + "# changed\n", "utf-8")
        digests.append(staged_digest(tmp_path / f"changed_{name}"))
        (copy / name).write_text(source, "utf-8")
    assert len(set(digests)) == 1 + len(SOURCES)
    assert staged_digest(tmp_path / "restored") == digests[0]


@each_module
def test_exports_exist(name):
    module = signals if name == "__init__.py" else sys.modules[f"{signals.__name__}.{name[:-3]}"]
    assert list(module.__all__)
    assert all(vars(module)[exported] is not None for exported in module.__all__)


def test_exports_are_the_public_names():
    imported = {
        alias.asname or alias.name
        for node in ast.parse(SOURCES["__init__.py"]).body
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }
    assert set(signals.__all__) == imported


def test_everything_public_is_documented():
    for name in signals.__all__:
        thing = getattr(signals, name)
        assert inspect.getdoc(thing)
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                if inspect.isroutine(value) and not member.startswith("_"):
                    assert inspect.getdoc(getattr(thing, member)), f"{name}.{member}"
