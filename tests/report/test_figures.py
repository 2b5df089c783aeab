"""Figures show what is stored: curves, styles, scales, units; files are reproducible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from congelation.errors import InvalidInput
from congelation.results.figures import save
from tests.report.stored import stored, stored_failures, trajectory


@pytest.fixture
def figure(tmp_path: Path) -> Figure:
    return stored(tmp_path).plot("loop")


def texts(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def test_one_panel_per_group_over_one_time_axis(figure: Figure) -> None:
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "$x$",
        "$u$",
        r"$\theta_{1}$ [1/s]",
        "|$x$|",
    ]
    assert figure.axes[-1].get_xlabel() == "$t$ [s]"
    assert {axes.get_xlim() for axes in figure.axes} == {(0.0, 10.0)}


def test_colours_are_elements_and_styles_are_variants(figure: Figure) -> None:
    lines = figure.axes[0].get_lines()
    colours = [line.get_color() for line in lines]
    styles = [line.get_linestyle() for line in lines]
    assert colours[0] == colours[2] != colours[1] == colours[3]
    assert styles == ["-", "-", "--", "--"]  # Matplotlib's name for any dashes
    assert texts(figure.axes[0]) == ["$x_{1}$ [m]", "$x_{2}$ [m/s$^{2}$]"]
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["Controller 1", "Controller 2"]


def test_what_all_variants_share_is_drawn_once(figure: Figure) -> None:
    assert len(figure.axes[2].get_lines()) == 1


def test_scales_follow_the_ranges(figure: Figure) -> None:
    assert [axes.get_yscale() for axes in figure.axes] == ["linear", "symlog", "linear", "log"]
    low, high = figure.axes[1].get_ylim()
    assert low < 0 < 1000 < high


def test_curves_keep_their_extremes_and_ends(figure: Figure) -> None:
    whole = trajectory(1000.0)
    for index, line in enumerate(figure.axes[0].get_lines()[:2]):
        shown = np.asarray(line.get_ydata())
        assert len(shown) < len(whole.time)
        assert (shown[0], shown[-1]) == (whole.values[0, index], whole.values[-1, index])
        assert (shown.min(), shown.max()) == (
            whole.values[:, index].min(),
            whole.values[:, index].max(),
        )


def test_the_norm_of_a_group(figure: Figure) -> None:
    line = figure.axes[3].get_lines()[1]
    exact = 1.001 * np.exp(-np.asarray(line.get_xdata()))
    assert np.asarray(line.get_ydata()) == pytest.approx(exact, rel=1e-12)


def test_a_span_shows_a_part(tmp_path: Path) -> None:
    figure = stored(tmp_path).plot("start")
    assert figure.axes[0].get_xlim() == (0.0, 1.0)
    assert max(np.max(line.get_xdata()) for line in figure.axes[0].get_lines()) == 1.0


def test_a_run_that_ended_early_is_marked_and_one_without_rows_left_out(tmp_path: Path) -> None:
    figure = stored_failures(tmp_path).plot("loop")
    lines = figure.axes[1].get_lines()
    assert [line.get_marker() for line in lines] == ["None", "x"]
    assert list(lines[1].get_xdata()) == [0.016]
    assert all(path.stat().st_size > 0 for path in save(figure, tmp_path / "figures", "loop"))


def test_files_are_pdf_and_png_and_the_same_every_time(tmp_path: Path) -> None:
    store = stored(tmp_path / "results")
    contents = []
    for folder in ("a", "b"):
        files = save(store.plot("loop"), tmp_path / folder, "loop")
        assert [file.name for file in files] == ["loop.pdf", "loop.png"]
        contents.append([file.read_bytes() for file in files])
    assert contents[0] == contents[1]
    assert contents[0][0].startswith(b"%PDF")
    assert b"/Type3" not in contents[0][0]
    assert contents[0][1].startswith(b"\x89PNG")


def test_names(tmp_path: Path) -> None:
    store = stored(tmp_path)
    assert store.figures() == ("loop", "start")
    assert len(store.plot().axes) == 4  # the first one
    with pytest.raises(InvalidInput, match=r"there is no figure 'lopo'; did you mean 'loop'\?"):
        store.plot("lopo")
