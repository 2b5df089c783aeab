"""Integer, Boolean and String connections: chains and loops of outputs that follow from inputs at
once, against loops written out."""

import itertools
import shutil
import zipfile

import pytest
from lxml import etree

from congelation.cosim import Component, Connection, Output, Sampled, Status, System, simulate

COUPLINGS = ["jacobi", "gauss_seidel", "derivative", Sampled(sample_time=1.0)]


def run(fmus, components, links, coupling="derivative", record=None, **starts):
    """Three steps of 1 s of components by name, each a counter or a block of logic."""
    files = {"s": "TestDiscrete.fmu"}
    return simulate(
        System(
            tuple(
                Component(name, fmus / files.get(name, "TestLogic.fmu"), starts.get(name, {}))
                for name in components
            ),
            tuple(Connection(*link.split(" -> ")) for link in links),
        ),
        stop_time=3.0,
        step=1.0,
        coupling=coupling,
        record=record,
    )


@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
def test_a_chain_follows_the_graph_in_any_order(fmus, coupling):
    """A counter s that counts its own output, and f, g, h that each add 1 at once."""
    links = ["s.n_out -> s.n_in", "s.n_out -> f.n_in", "f.n_out -> g.n_in", "g.n_out -> h.n_in"]
    record = ["s.n_out", "f.n_out", "g.n_out", "h.n_out"]
    expected = [[n, n + 1, n + 2, n + 3] for n in range(4)]
    for order in (links, links[::-1], [links[2], links[0], links[3], links[1]]):
        for components in ("sfgh", "hgfs"):
            result = run(fmus, components, order, coupling, record)
            assert result.status is Status.COMPLETED
            assert result.values.tolist() == expected


@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
def test_a_loop_settles(fmus, coupling):
    """Two that count each other up to 7 and 5, with a third behind them."""
    links = ["f.n_out -> g.n_in", "g.n_out -> f.n_in", "g.n_out -> h.n_in"]
    f = g = 0
    for _ in range(100):  # what satisfies f = min(g + 1, 7), g = min(f + 1, 5)
        f, g = min(g + 1, 7), min(f + 1, 5)
    assert (f, g) == (6, 5)
    for order in itertools.permutations(links):
        result = run(
            fmus,
            "fgh",
            order,
            coupling,
            ["f.n_out", "g.n_out", "h.n_out"],
            f={"most": 7},
            g={"most": 5},
        )
        assert result.status is Status.COMPLETED
        assert result.values.tolist() == [[6, 5, 6]] * 4


def test_booleans_and_strings_settle_too(fmus):
    letters = run(fmus, "fg", ["f.s_out -> g.s_in", "g.s_out -> f.s_in"], f={"most": 4})
    assert letters.status is Status.COMPLETED  # "....", and one more in g
    gates = ["f.b_out -> g.b_in", "g.b_out -> h.b_in"]
    result = run(
        fmus,
        "hgf",
        gates,
        record=["f.b_out", "g.b_out", "h.b_out"],
        f={"inverts": True},
        g={"inverts": True},
        h={"inverts": True},
    )
    assert result.values.tolist() == [[True, False, True]] * 4


@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
@pytest.mark.parametrize(
    ("letter", "starts"), [("n", {}), ("b", {"f": {"inverts": True}}), ("s", {})]
)
def test_a_loop_that_does_not_settle_is_refused_in_one_line(fmus, coupling, letter, starts):
    links = ["f.{0}_out -> g.{0}_in", "g.{0}_out -> f.{0}_in", "g.{0}_out -> h.{0}_in"]
    result = run(fmus, "hgf", [link.format(letter) for link in links], coupling, **starts)
    assert result.status is Status.LOOP_UNSOLVED
    assert "\n" not in result.message
    assert result.message.startswith("at t = 0: the loop of Integer, Boolean or String values")
    loop = f"f.{letter}_out -> g.{letter}_in, g.{letter}_out -> f.{letter}_in"
    assert f" {loop} does not come to rest" in result.message  # h stands behind the loop


@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
def test_a_comparison_of_a_real_value_acts_at_once(fmus, coupling):
    """c gives 1, d compares it with 0.5, e switches by the answer."""
    links = ["c.w -> d.v", "d.b_out -> e.b_in"]
    for order in (links, links[::-1]):
        result = run(fmus, "edc", order, coupling, ["e.w"], c={"b_in": True}, d={"level": 0.5})
        assert result.values.tolist() == [[1.0]] * 4


def test_a_loop_through_real_and_boolean_values_that_does_not_settle(fmus):
    """A relay that switches itself off as soon as it is on."""
    links = ["e.w -> d.v", "d.b_out -> e.b_in"]
    result = run(fmus, "de", links, d={"level": 0.5, "inverts": True})
    assert result.status is Status.LOOP_UNSOLVED
    assert "d.b_out -> e.b_in keep changing with the Real values around e.w -> d.v" in (
        result.message
    )
    settled = run(fmus, "de", links, record=["e.w"], d={"level": 0.5})
    assert settled.values.tolist() == [[0.0]] * 4


@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
def test_an_output_that_is_no_item_of_its_enumeration_is_named(fmus, tmp_path, coupling):
    """A counter 0, 1, 2, 3 whose output is declared to be off, low or high."""
    folder = tmp_path / "fmus"
    folder.mkdir()
    shutil.copy(fmus / "TestLogic.fmu", folder)
    with zipfile.ZipFile(fmus / "TestDiscrete.fmu") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    root = etree.fromstring(files["modelDescription.xml"])
    for tag in root.findall(".//ScalarVariable[@name='n_out']/Integer"):
        tag.tag = "Enumeration"
        tag.set("declaredType", "Level")
    types = etree.Element("TypeDefinitions")
    level = etree.SubElement(etree.SubElement(types, "SimpleType", name="Level"), "Enumeration")
    for value, name in enumerate(["off", "low", "high"]):
        etree.SubElement(level, "Item", name=name, value=str(value))
    root.find("ModelVariables").addprevious(types)
    files["modelDescription.xml"] = etree.tostring(root)
    with zipfile.ZipFile(folder / "TestDiscrete.fmu", "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    links = ["s.n_out -> s.n_in", "s.n_out -> f.n_in"]
    result = run(folder, "sf", links, coupling, ["s.n_out", "f.n_out"])
    assert result.values.tolist() == [[n, n + 1] for n in range(4)]
    valid = "'off' (0), 'low' (1), 'high' (2)"
    assert result.message == (
        f"{Status.COMPLETED.value} s.n_out is 3 at t = 3, no item of its enumeration ({valid}); "
        "it was passed on as it is."
    )


@pytest.mark.parametrize("coupling", ["jacobi", "derivative"])
def test_a_counter_is_held_between_the_points_on_a_grid(fmus, coupling):
    """Its numbers are whole on every row, and those of the communication point before."""
    result = simulate(
        System((Component("s", fmus / "TestDiscrete.fmu"),), (Connection("s.n_out", "s.n_in"),)),
        stop_time=3.0,
        step=1.0,
        coupling=coupling,
        output=Output(interval=0.25),
        record=["s.n_out"],
    )
    assert result.column("s.n_out").tolist() == [0] * 4 + [1] * 4 + [2] * 4 + [3]
