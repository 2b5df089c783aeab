"""The HTML report: one file, self-contained, well-formed, with everything that was stored."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from congelation.errors import CongelationError, InvalidInput
from congelation.report.run_page import write_html
from congelation.report.study_verdict import study_verdict
from congelation.results.record import Trajectory
from congelation.results.results import Results
from tests.report.stored import record, results, stored, stored_failures, stored_study

VOID = {"meta", "img", "br", "input"}


class Page(HTMLParser):
    """Collects text, checks that every element is closed in its turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.sources += [str(value) for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page(store: Results, file: Path) -> Page:
    write_html(store, file)
    parser = Page()
    parser.feed(file.read_text(encoding="utf-8"))
    assert parser.open == []
    return parser


def test_the_report_holds_what_was_stored(tmp_path: Path) -> None:
    found = page(stored(tmp_path), tmp_path / "report.html")
    for text in (
        "Two <runs>",
        "Controller 1",
        "peak_x [m]",
        "1.235",
        "not settled",
        "max |v| & more",
        "Plant.fmu",
        "5e1f",
        "0.1.0+abc",
        'title = "Two <runs>"',
        "r1",
    ):
        assert text in found.text, text


def test_the_report_needs_no_other_file(tmp_path: Path) -> None:
    """It is HTML all through, and nothing in it names another file; the browser tests watch it."""
    found = page(stored(tmp_path), tmp_path / "report.html")
    assert found.sources == ["#content"]
    assert "@import" not in (tmp_path / "report.html").read_text()


def test_the_verdict_and_the_price_come_first(tmp_path: Path) -> None:
    found = page(stored(tmp_path), tmp_path / "report.html")
    head = found.text[: found.text.index("Trajectories")]
    assert "Controller 1 settles after 2.5 s; Controller 2 does not settle." in head
    # u = gain exp(-t), gains 1000 and 1; no metric measures it.
    assert "Controller 1 pays with a peak of |u| that is 1000 times that of Controller 2." in head


def test_failures_and_deviations_are_told(tmp_path: Path) -> None:
    failed = page(stored_failures(tmp_path / "a"), tmp_path / "a.html")
    assert "Controller 1: plant: <too> large" in failed.text
    assert "DIVERGED" in failed.text
    verified = page(stored(tmp_path / "b", {"plant.x[1]": 1.5e-5}), tmp_path / "b.html")
    assert "error of plant.x[1] / peak" in verified.text
    assert "1.5e-05" in verified.text


def test_places_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="is no result directory"):
        write_html(Results(tmp_path), tmp_path / "report.html")
    store = stored(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(CongelationError, match=r"report\.html cannot be written"):
        write_html(store, tmp_path / "file" / "report.html")


def test_a_variant_without_an_axis_is_compared_with_all_runs_of_the_other(tmp_path: Path) -> None:
    both = stored_study(tmp_path / "both", kept=0).study()
    one, *_ = (run for run in both.records if run.variant == "Controller 1")
    others = [run for run in both.records if run.variant == "Controller 2"]
    one = replace(one, settings={"plant.omega": None, "plant.a": one.settings["plant.a"]})
    said = list(study_verdict(replace(both, records=(one, *others))))
    # u peaks at 50 and, over the runs of the other that came to their end, at 1 and 2.
    assert said[-1] == (
        "Controller 1 pays with a peak of |u| that is 50 times that of Controller 2 "
        "(median at equal settings; 25 to 50)."
    )
    assert said[0] == "Controller 1 settles in its only run, after 1 s."


def test_pages_tell_of_the_burst_that_delays_a_run(tmp_path: Path) -> None:
    """Of a study, in the run of each variant that settles last alone."""
    time = np.arange(0.0, 10.0, 0.5)
    x = np.where(time < 2.0, 1.0, np.where((time >= 6.0) & (time < 7.0), 0.5, 1e-3))
    steady = Trajectory(time, ("plant.x[1]",), np.exp(-5 * time)[:, np.newaxis], {})
    burst = Trajectory(time, ("plant.x[1]",), x[:, np.newaxis], {})
    about = {"settling_x": {"metric": "settling_time", "of": "plant.x", "options": {"below": 0.01}}}
    about["settling_x"] |= {"definition": "the last time", "unit": "s"}
    runs = [
        (record(f"r{k}", k, variant="A", settings={"plant.a": k}, metrics={"settling_x": end}), of)
        for k, (end, of) in enumerate([(1.0, steady), (7.0, burst), (2.0, burst)])
    ]
    said = ", |plant.x| falls below 0.01 at t = 2 s, and bursts to 0.5 at t = 6 s."
    swept = results(tmp_path / "s", runs, metrics=about, figures=[], swept=True)
    text = page(swept, tmp_path / "s.html").text
    assert f"In the run of A that settles last{said}" in text
    assert text.count("and bursts to") == 1
    alone = results(tmp_path / "r", runs[1:2], metrics=about, figures=[])
    text = page(alone, tmp_path / "r.html").text
    assert text.count(f"In the run of A{said}") == text.count("and bursts to") == 1


def test_a_study_says_where_it_fails_and_what_it_costs(tmp_path: Path) -> None:
    found = page(stored_study(tmp_path, kept=0), tmp_path / "report.html")
    head = found.text[: found.text.index("Metric against a setting")]
    assert "Controller 1 settles in all 8 runs, after 1.5 s (median; 1 to 2 s)." in head
    assert "A run settles when |plant.x| stays" in head
    assert "Controller 2 settles in 4 of 8 runs: in all up to omega = 1 and in none" in head
    assert "from omega = 10 on." in head
    assert "a peak of |u| that is 50 times that of Controller 2" in head
    assert "plant: x[1] <too> large" in found.text
    assert "No trajectories were kept; trajectories = true under [sweep] keeps them." in found.text
