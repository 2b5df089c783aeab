"""Figures show what is stored: curves, styles, scales, units; files are reproducible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import congelation as cg
from congelation.errors import InvalidInput
from congelation.results.print_figures import draw_panels, save
from congelation.results.record import Trajectory
from tests.report.stored import record, results, stored, stored_failures, trajectory


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


def test_theta_of_variants_with_steps_of_their_own_is_drawn_once(tmp_path: Path) -> None:
    """Unless a variant changes its profile."""
    loop = cg.load_scenario("scenarios/scalar.toml").system
    experiment = cg.Experiment(stop_time=1.0, tolerance=1e-4)
    first, second = (cg.Variant(f"{k}", {"controller.damping": k == 1}) for k in (1, 2))
    other = cg.Variant("other", {"plant.profile[1].mean": 0.5})
    scenario = cg.Scenario("steps", loop, experiment, (first, second, other))
    results = cg.run(scenario, out=tmp_path)
    rows = [len(results.trajectory(run.run_id).time) for run in results.runs]
    assert rows[0] != rows[1]
    panels = {axes.get_ylabel().partition(" ")[0]: axes for axes in results.plot().axes}
    assert len(panels["$x$"].get_lines()) == 3
    theta = panels[r"$\theta_{1}$"].get_lines()
    assert [len(line.get_xdata()) for line in theta] == [max(rows[:2]), rows[2]]
    assert [line.get_linestyle() for line in theta] == ["-", "--"]


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


def test_figures_have_the_width_and_formats_asked_for(tmp_path: Path) -> None:
    store = stored(tmp_path)
    figure = store.plot("loop", width=5.0)
    files = save(figure, tmp_path / "out", "loop", ("svg", "pdf"))
    assert [file.suffix for file in files] == [".svg", ".pdf"]
    svg = files[0].read_text()
    assert 'width="360pt"' in svg  # 5 in
    assert "<dc:date>" not in svg
    assert b"/Type3" not in files[1].read_bytes()


def test_scale_and_legend_are_those_asked_for(tmp_path: Path) -> None:
    """u of the two variants peaks at 1000 and 1, which by itself makes its axis symlog."""
    runs = [(record("r1", 1), trajectory(1000.0)), (record("r2", 2), trajectory(1.0))]
    panels = ["controller.u", "plant.x", "|plant.x|"]
    for scale, expected in {
        "auto": ["symlog", "linear", "log"],
        "linear": ["linear"] * 3,
        "symlog": ["symlog"] * 3,
        "log": ["log"] * 3,
    }.items():
        figure = draw_panels(runs, panels, scale=scale)
        figure.draw_without_rendering()
        assert [axes.get_yscale() for axes in figure.axes] == expected, scale
    bare = draw_panels(runs, panels, legend=False)
    assert not bare.legends
    assert not any(axes.get_legend() for axes in bare.axes)
    figures = [{"name": "f", "panels": panels, "span": None, "scale": "linear", "legend": False}]
    bare_study = results(tmp_path / "bare", runs, figures=[])
    assert bare_study.plot().axes
    with pytest.raises(
        InvalidInput, match=r"no figure 'f': this study defines none; plot\(\) draws"
    ):
        bare_study.plot("f")
    kept = results(tmp_path, runs, figures=figures).plot("f")
    assert [axes.get_yscale() for axes in kept.axes] == ["linear"] * 3
    assert not kept.legends


@pytest.mark.parametrize("width", [2.5, 3.5, 7.0])
def test_legends_are_not_clipped(tmp_path: Path, width: float) -> None:
    """Five parameters, each with a unit of its own, in a legend above its panel."""
    columns = tuple(f"controller.theta_hat[{k}]" for k in range(1, 6))
    units = dict(zip(columns, ("rad/s2", "1/s", "N.m/rad", "kg.m2", "m/s2"), strict=True))
    t = np.linspace(0.0, 1.0, 50)
    run = Trajectory(t, columns, np.outer(t, np.arange(1.0, 6.0)), units)
    figure = draw_panels([(record("r1", 1), run)], ["controller.theta_hat"], width=width)
    figure.draw_without_rendering()
    for axes in figure.axes:
        legend = axes.get_legend()
        assert legend is not None
        box = legend.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1
