"""The file travels into FMUs: on its own, on Python 3.9, with the standard library."""

import ast
import importlib.util
import inspect
import sys
from pathlib import Path

from congelation import signals

SOURCE = Path(inspect.getsourcefile(signals)).read_text()


def test_imports_the_standard_library_alone():
    tree = ast.parse(SOURCE)
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names.add(node.module)
    assert {name.split(".")[0] for name in names} <= set(sys.stdlib_module_names)


def test_is_python_3_9():
    ast.parse(SOURCE, feature_version=(3, 9))
    assert "from __future__ import annotations" in SOURCE
    assert "strict=" not in SOURCE
    assert "slots=True" not in SOURCE
    assert "kw_only" not in SOURCE


def test_loads_under_another_name(tmp_path):
    path = tmp_path / "signals_0123456789.py"
    path.write_text(SOURCE)
    spec = importlib.util.spec_from_file_location("signals_0123456789", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
        assert module.profile(1.0, module.Sine(2.0, 1.0)).value(0.0) == 1.0
    finally:
        del sys.modules[spec.name]


def test_exports_are_the_public_names():
    defined = {
        node.name
        for node in ast.parse(SOURCE).body
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_")
    }
    assert set(signals.__all__) == defined
    assert list(signals.__all__) == sorted(signals.__all__)


def test_everything_public_is_documented():
    for name in signals.__all__:
        thing = getattr(signals, name)
        assert inspect.getdoc(thing)
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                if inspect.isroutine(value) and not member.startswith("_"):
                    assert inspect.getdoc(getattr(thing, member)), f"{name}.{member}"
