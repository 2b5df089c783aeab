"""The public names: what is listed is what there is, loaded late, documented and tried."""

from __future__ import annotations

import doctest
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import congelation as cg
from tests.scenarios import FMUS, ROOT

PAGE = ROOT / "docs" / "api.md"


def listed() -> list[str]:
    """The names in the table of the page."""
    return re.findall(r"^\| `(\w+)` \|", PAGE.read_text("utf-8"), re.MULTILINE)


def test_the_page_lists_what_there_is() -> None:
    assert sorted(listed()) == sorted(dir(cg)) == sorted(cg.__all__)
    assert sorted(cg._PLACES) == sorted(set(cg.__all__) - {"__version__"})


@pytest.mark.parametrize("name", cg.__all__)
def test_every_name_is_there_and_documented(name: str) -> None:
    found = getattr(cg, name)
    assert isinstance(found, str) or inspect.getdoc(found)


def test_importing_loads_nothing_else() -> None:
    script = (
        "import sys, congelation; dir(congelation); congelation.__version__;"
        "print([m for m in ('numpy', 'casadi', 'fmpy', 'typer') if m in sys.modules],"
        " [m for m in sys.modules if m.startswith('congelation.')])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[] []\n", "")


def test_names_stay_functions_whatever_is_imported() -> None:
    """`verify` is a function, and a private package that others import."""
    script = (
        "import congelation.verify.reference, congelation as cg; cg.load_scenario;"
        "from congelation import verify; print(callable(cg.verify), callable(verify))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("True True\n", "")


def test_an_unknown_name_is_an_attribute_error_that_names_the_nearest() -> None:
    with pytest.raises(AttributeError, match="no public name 'Metric'; did you mean 'MetricSpec'"):
        cg.Metric  # noqa: B018


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like the checkout's, with results of a run in it."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("specs", "scenarios", "fmus"):
        (folder / name).symlink_to(ROOT / name)
    cg.run(folder / "scenarios" / "scalar.toml", out=folder / "results" / "scalar")
    return folder


@pytest.fixture
def names(checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """What examples may use: an empty folder, and the FMUs that `make fmus` built."""
    monkeypatch.chdir(checkout)
    return {"cg": cg, "folder": tmp_path, "fmus": FMUS}


def failures(tests: list[doctest.DocTest]) -> str:
    """Run examples; what went wrong, empty if nothing did."""
    said: list[str] = []
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    runner = doctest.DocTestRunner(optionflags=flags, verbose=False)
    for test in tests:
        runner.run(test, out=said.append)
    assert runner.tries > 0
    return "".join(said) if runner.failures else ""


LONG = ("run", "sweep", "attack", "tune")
"""Names whose examples take seconds."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
        for name in cg.__all__
        if name != "__version__"
    ],
)
def test_every_name_has_an_example_that_works(name: str, names: dict[str, object]) -> None:
    text = inspect.getdoc(getattr(cg, name)) or ""
    assert failures([doctest.DocTestParser().get_doctest(text, names, name, None, None)]) == ""


@pytest.mark.slow
def test_examples_of_the_page(names: dict[str, object], tmp_path: Path) -> None:
    names["fmus"] = tmp_path / "fmus"
    text = PAGE.read_text("utf-8")
    test = doctest.DocTestParser().get_doctest(text, names, "api.md", str(PAGE), 0)
    assert failures([test]) == ""


def test_what_is_returned_prints_in_ten_lines(tmp_path: Path) -> None:
    spec = ROOT / "specs" / "scalar.toml"
    plant, controller = cg.build(spec, out=tmp_path)
    system = cg.System(
        (cg.Component("plant", plant), cg.Component("controller", controller)),
        (cg.Connection("plant.x", "controller.x"), cg.Connection("controller.u", "plant.u")),
    )
    scenario = cg.load_scenario(ROOT / "scenarios" / "study_monte_carlo.toml")
    for shown in (cg.simulate(system, stop_time=1.0, step=0.1), scenario, cg.certify(spec)[0]):
        assert len(repr(shown).splitlines()) <= 10
        assert max(map(len, repr(shown).splitlines())) < 200
