"""The pages of `certify` and `check`: what was judged, and everything that it rests on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from congelation.cli import app
from congelation.conformance.finding import FmuReport, Report, Verdict
from congelation.conformance.rule import BY_ID, Breach, Outcome
from congelation.report.certificates import write_certificates
from congelation.report.conformance import write_conformance
from congelation.verify.certify import certify
from tests.report.browser import WIDTHS, chromium, fits, keep, needs_browser, opened
from tests.report.test_run_page import Page
from tests.scenarios import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser

LAWFUL = ROOT / "specs/scalar.toml"


def found(report: Report, file: Path) -> Page:
    write_conformance(report, file)
    return parsed(file)


def parsed(file: Path) -> Page:
    page = Page()
    page.feed(file.read_text("utf-8"))
    assert page.open == []
    return page


@pytest.fixture(scope="module")
def report() -> Report:
    """One FMU that breaks two rules, one of them as is known, and one that no rule was for."""
    broken = (Breach("<x> has no unit", 7, "modelDescription.xml"), Breach("y has none"))
    verdicts = (
        Verdict(BY_ID["FMI2-STATE-02"], Outcome.KNOWN, (Breach("stepped on"),), "of old"),
        Verdict(BY_ID["FMI2-LIB-02"], Outcome.FOUND, broken, log=("no & of version",)),
        Verdict(BY_ID["FMI2-PACK-03"], Outcome.PASS),
        Verdict(BY_ID["FMI2-LOG-01"], Outcome.NOT_EVALUATED, reason="it hangs"),
    )
    own = FmuReport(Path("some folder/Own.fmu"), "FMI 2.0, all rules", True, verdicts)
    other = FmuReport(Path("Other.fmu"), "FMI 3.0: not checked", False, ())
    return Report((own, other), ("FMI2-LIB-01 of Lost.fmu",))


def test_findings_come_with_place_remedy_and_rule(report: Report, tmp_path: Path) -> None:
    page = found(report, tmp_path / "a.html")
    for text in (
        "The standard is violated by Own.fmu.",
        "1 violation, 0 warnings, 0 findings on robustness; 1 accepted.",
        "1 of the FMUs could not be checked.",
        "FMI 3.0: not checked",
        "<x> has no unit (and 1 more) (modelDescription.xml, line 7)",
        f"Remedy: {BY_ID['FMI2-LIB-02'].remedy}",
        "y has none",
        "log: no & of version",
        BY_ID["FMI2-LIB-02"].why,
        "Accepted: of old",
        "it hangs",
        "nothing was found for FMI2-LIB-01 of Lost.fmu",
    ):
        assert text in page.text, text
    graver, known = (page.text.index(f"{n}: ") for n in ("FMI2-LIB-02", "FMI2-STATE-02"))
    assert graver < known


def test_an_fmu_without_findings_is_said_to_be_so(report: Report, tmp_path: Path) -> None:
    (own, _) = report.fmus
    clean = FmuReport(own.path, own.scope, True, own.verdicts[2:3])
    page = found(Report((clean,)), tmp_path / "a.html")
    assert "No violation of the standard was found in Own.fmu." in page.text
    assert "No rule is broken." in page.text
    assert page.sources[0] == "#content"


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page that the command writes of a design that holds, with limits of u."""
    file = tmp_path_factory.mktemp("certificate") / "page.html"
    options = ["--samples", "50", "--umax", "100", "--html", str(file)]
    done = CliRunner().invoke(app, ["certify", str(LAWFUL), *options])
    assert done.exit_code == 0, done.output
    return file


def test_a_certificate_says_what_holds_and_what_it_rests_on(certificate: Path) -> None:
    page = parsed(certificate)
    (design,) = certify(LAWFUL, samples=50, umax=100.0)
    assert design.finding is not None
    assert design.level is not None
    for text in (
        f"{design.design.name}: no state was found at which V' exceeds what the design promises.",
        f"{design.finding.margin.relative:.1e}",
        "controller.theta_hat",
        f"|u| stays below 100 where V < {design.level.v:.4g}",
        'form = "scalar"',  # the spec itself
        "The adaptive controller (3)",
    ):
        assert text in page.text, text


def test_a_broken_assumption_is_told(tmp_path: Path) -> None:
    """The profile leaves the ball that the design is made for."""
    text = LAWFUL.read_text("utf-8")
    spec = tmp_path / "spec.toml"
    spec.write_text(text.replace("delta = 1", "delta = 0.01"), "utf-8")
    designs = certify(spec, samples=10)
    write_certificates(designs, spec, tmp_path / "page.html", samples=10, seed=0)
    page = parsed(tmp_path / "page.html")
    assert "an assumption of the theorem is broken" in page.text
    assert designs[0].reasons[0] in page.text
    assert "No assumption of the theorem is known to be broken" not in page.text


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as engine:
        yield engine


@needs_browser
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_with_everything_open(
    browser: Browser, certificate: Path, report: Report, tmp_path: Path, width: int
) -> None:
    write_conformance(report, tmp_path / "check.html")
    for file, name in ((certificate, "certificate"), (tmp_path / "check.html", "conformance")):
        scheme = "dark" if width == WIDTHS[0] else "light"
        with opened(browser, file, width, scheme) as page:
            page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
            assert fits(page)
            keep(page, f"{name}-{width}")
            page.pdf(path=tmp_path / "page.pdf", format="A4")
            assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
