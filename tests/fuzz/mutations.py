"""The table of mutations: what is changed, and what has to come of it.

Each row changes one thing of a valid scenario, spec, FMU or archive. It says what the command is to
end with: the exit code, and what its last line (a refusal) or the named value of the run has to be.
`make fuzz` applies rows at random, with other values of each kind every time.
"""

from __future__ import annotations

import random
import string
from collections.abc import Callable
from dataclasses import dataclass

from tests.scenarios import FMUS

__all__ = ["ARCHIVES", "FILES", "KEYS", "SPEC", "SPECS", "SYSTEMS", "Mutation"]

Change = Callable[[random.Random], tuple[str, str]]


@dataclass(frozen=True)
class Mutation:
    """One row of the table.

    Parameters
    ----------
    name : str
    change : callable
        From random numbers to (what stands in the text, what takes its place).
    code : int
        Exit code of the command: ``congelation run`` of a scenario or an SSP archive, ``congelation
        build`` of a spec.
    says : str
        Regular expression that the last line of stderr has; of a code of 0, that none has.
    same : str
        Column of the row that keeps its value, where nothing else should change it.
    entry : str
        Of an SSP archive: the file in it whose text is changed.
    """

    name: str
    change: Change
    code: int
    says: str = ""
    same: str = ""
    entry: str = "SystemStructure.ssd"


def word(rng: random.Random) -> str:
    return "".join(rng.choices(string.ascii_lowercase, k=rng.randint(9, 14)))


def number(rng: random.Random) -> float:
    return rng.choice([rng.uniform(0.001, 1e3), 10.0 ** rng.uniform(-300, 300)])


def no_number(rng: random.Random) -> str:
    return rng.choice(['"ten"', "true", "[1.0, 2.0]", "{a = 1}", "1979-05-27", "[]", "nan", "inf"])


def _key(table: str, key: str) -> Change:
    """A key that is spelled in a way nobody knows."""
    return lambda rng: (f"{key} =", f"{word(rng)} =")


def _to(old: str, new: Callable[[random.Random], object]) -> Change:
    return lambda rng: (old, str(new(rng)))


KEYS = (
    # keys
    Mutation("unknown key", _key("experiment", "stop_time"), 2, r"experiment\.\w+ is not known"),
    Mutation("unknown key of all", _key("", "title"), 2, r"is not known here"),
    Mutation("twice", _to("step = 0.01", lambda r: "step = 0.01\nstep = 0.01"), 2, r"line \d+"),
    Mutation(
        "no stop", _to("stop_time = 1.0", lambda r: ""), 2, r"experiment\.stop_time is missing"
    ),
    Mutation("no step", _to("step = 0.01", lambda r: ""), 2, r"experiment\.step is missing"),
    # values of keys
    Mutation(
        "negative time",
        _to("stop_time = 1.0", lambda r: f"stop_time = {-number(r)!r}"),
        2,
        r"experiment\.stop_time = -.* is not valid; give a time after start_time",
    ),
    Mutation(
        "no time",
        _to("stop_time = 1.0", lambda r: f"stop_time = {no_number(r)}"),
        2,
        r"experiment\.stop_time",
    ),
    Mutation(
        "negative step",
        _to("step = 0.01", lambda r: f"step = {-number(r)!r}"),
        2,
        r"experiment\.step = -.* is not valid",
    ),
    Mutation(
        "no step number",
        _to("step = 0.01", lambda r: f"step = {no_number(r)}"),
        2,
        r"experiment\.step",
    ),
    Mutation(
        "more rows than are kept",
        _to(
            "step = 0.01", lambda r: f"step = 0.01\noutput_interval = {10.0 ** r.uniform(-300, -9)}"
        ),
        2,
        r"experiment\.output_interval = .* asks for .* rows of a run",
    ),
    Mutation(
        "open and driven",
        _to("title =", lambda r: f'open = ["{r.choice(["plant.u", "controller.x"])}"]\ntitle ='),
        2,
        r"open: '.*' is driven by '.* -> .*'; leave one of them out",
    ),
    Mutation(
        "axis of what a variant sets",
        _to(
            "[[figures]]",
            lambda r: (
                '[sweep]\n[[sweep.axes]]\nset = "controller.damping"\n'
                f"values = [{r.choice(['true', 'false', 'true, false'])}]\n[[figures]]"
            ),
        ),
        2,
        r"sweep\.axes\[1\]\.set sets 'controller\.damping', which the variant 'Controller 1' sets",
    ),
    Mutation(
        "an axis of one setting twice",
        _to(
            "[[figures]]",
            lambda r: (
                '[sweep]\n[[sweep.axes]]\nset = ["controller.epsilon", "controller.epsilon"]\n'
                f"values = [[{r.uniform(0.1, 1)}, {r.uniform(0.1, 1)}]]\n[[figures]]"
            ),
        ),
        2,
        r"sweep\.axes\[1\]\.set sets 'controller\.epsilon' twice; leave one of them out",
    ),
    Mutation(
        "an axis with one value twice",
        _to(
            "[[figures]]",
            lambda r: (
                '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\n'
                f"values = [{(value := r.uniform(0.1, 1))!r}, 2.0, {value!r}]\n[[figures]]"
            ),
        ),
        2,
        r"sweep\.axes\[1\]\.values\[3\] is that of values\[1\]; leave one of them out",
    ),
    Mutation(
        "an axis of nothing",
        _to(
            "[[figures]]", lambda r: "[sweep]\n[[sweep.axes]]\nset = []\nvalues = [[]]\n[[figures]]"
        ),
        2,
        r"sweep\.axes\[1\]\.set is empty; name the settings of the axis",
    ),
    Mutation(
        "metrics that differ by case",
        _to("[metrics]", lambda r: '[metrics]\nPeak_X = {metric = "peak", of = "plant.u"}'),
        2,
        r"metrics name 'Peak_X' and 'peak_x', which differ by case alone",
    ),
    Mutation(
        "unit of a metric's option",
        _to("below = 0.1", lambda r: f'below = {{value = {r.uniform(0.1, 1)!r}, unit = "kg"}}'),
        2,
        r"metrics\.settling_x\.below\.unit = 'kg' is not the unit of 'below'",
    ),
    Mutation(
        "a metric's option without its value",
        _to("below = 0.1", lambda r: f'below = {{{word(r)} = 0.1, unit = "1"}}'),
        2,
        r"metrics\.settling_x\.below\.\w+ is not known here; "
        r"(valid: value, unit|did you mean .(value|unit)..)",
    ),
    Mutation(
        "a name of a file that is too long",
        _to(f"{FMUS}/ScalarPlant.fmu", lambda r: word(r) * r.randint(100, 999)),
        2,
        r"is no FMU in fmus/",
    ),
    Mutation(
        "a figure's name that is too long for a file",
        _to('name = "loop"', lambda r: f'name = "{word(r) * r.randint(30, 99)}"'),
        2,
        r"figures\[1\]\.name = .* is not valid; give up to 200 letters, digits, - and _",
    ),
    Mutation(
        "a table's name with a zero",
        _to(
            "{square = {amplitude = 0.4, period = 0.3}}",
            lambda r: f'{{table = {{file = "{word(r)}\\u0000"}}}}',
        ),
        2,
        r"components\.plant\.profile\.theta\[1\] cannot be read: embedded null byte",
    ),
    Mutation(
        "tolerance",
        _to("step = 0.01", lambda r: f"tolerance = {r.uniform(1, 9)!r}"),
        2,
        r"experiment\.tolerance = .* is not valid",
    ),
    Mutation(
        "coupling",
        _to("step = 0.01", lambda r: f'step = 0.01\ncoupling = "{word(r)}"'),
        2,
        r"experiment\.coupling = '\w+' is not known",
    ),
    Mutation(
        "record",
        _to('"plant.x", "controller', lambda r: f'"plant.{word(r)}", "controller'),
        2,
        r"record 'plant\.\w+': ScalarPlant\.fmu has no variable",
    ),
    Mutation(
        "metric",
        _to('metric = "peak"', lambda r: f'metric = "{word(r)}"'),
        2,
        r"metrics\.peak_x\.metric",
    ),
    Mutation(
        "start name",
        _to("x0 = [1.0]", lambda r: f"{word(r)} = 1.0"),
        2,
        r"ScalarPlant\.fmu has no variable",
    ),
    Mutation(
        "start shape",
        _to("x0 = [1.0]", lambda r: f"x0 = {[1.0] * r.randint(2, 9)}"),
        2,
        r"\d values given, 1 value needed",
    ),
    Mutation(
        "text with a zero",
        _to("x0 = [1.0]", lambda r: f'"profile[1].table.file" = "{word(r)}\\u0000"'),
        2,
        r"has a zero, at which a text ends in C",
    ),
    Mutation("start type", _to("x0 = [1.0]", lambda r: f"x0 = {no_number(r)}"), 2, r"x0"),
    Mutation(
        "gain",
        _to("epsilon = 0.3", lambda r: f"epsilon = {-number(r)!r}"),
        1,
        r"epsilon = .* is refused: it must be positive",
    ),
    Mutation("unit", _to("x0 = [1.0]", lambda r: 'x0 = {value = 1, unit = "kg"}'), 2, r"unit"),
    Mutation(
        "term",
        _to("{constant = -3.0}", lambda r: f"{{{word(r)} = -3.0}}"),
        2,
        r"profile.*theta\[1\]",
    ),
    Mutation("period", _to("period = 0.3", lambda r: f"period = {-number(r)!r}"), 2, r"period"),
    Mutation(
        "variant",
        _to('"controller.damping" = false', lambda r: f'"{word(r)}.damping" = false'),
        2,
        r"is no component",
    ),
    Mutation(
        "panel",
        _to('panels = ["plant.x"', lambda r: f'panels = ["plant.{word(r)}"'),
        2,
        r"plant\.\w+",
    ),
    # values that change nothing
    Mutation(
        "title",
        _to("A short loop", lambda r: word(r) + r.choice(["", " \u03b8", " [b]"])),
        0,
        same="metric.peak_x",
    ),
    Mutation(
        "unit of time",
        _to("stop_time = 1.0", lambda r: 'stop_time = {value = 1000, unit = "ms"}'),
        0,
        same="metric.peak_x",
    ),
    Mutation(
        "comment", _to("[metrics]", lambda r: f"# {word(r)}\n[metrics]"), 0, same="metric.peak_x"
    ),
    Mutation(
        "order of tables",
        _to("title =", lambda r: f"{' ' * r.randint(0, 9)}title ="),
        0,
        same="metric.peak_x",
    ),
    # connections
    Mutation(
        "no arrow",
        _to("plant.x -> controller.x", lambda r: "plant.x controller.x"),
        2,
        r"write it as 'plant\.x -> controller\.x'",
    ),
    Mutation(
        "no component", _to("plant.x ->", lambda r: f"{word(r)}.x ->"), 2, r"no component '\w+'"
    ),
    Mutation("no output", _to("plant.x ->", lambda r: f"plant.{word(r)} ->"), 2, r"no variable"),
    Mutation(
        "backwards",
        _to("plant.x -> controller.x", lambda r: "controller.x -> plant.x"),
        2,
        r"causality",
    ),
    Mutation(
        "twice driven",
        _to(
            '"controller.u -> plant.u"',
            lambda r: '"controller.u -> plant.u", "plant.theta -> plant.u"',
        ),
        2,
        r"driven already",
    ),
    Mutation(
        "forgotten",
        _to(', "controller.u -> plant.u"', lambda r: ""),
        0,
        r"warning: .*input 'plant\.u' has no connection",
    ),
    # files
    Mutation(
        "no file",
        _to(f"{FMUS}/ScalarPlant.fmu", lambda r: f"{FMUS}/{word(r)}.fmu"),
        2,
        r"no FMU at",
    ),
    Mutation("a folder", _to(f"{FMUS}/ScalarPlant.fmu", lambda r: "."), 2, r"is no FMU"),
    Mutation("no FMU", _to(f"{FMUS}/ScalarPlant.fmu", lambda r: word(r)), 2, r"is no FMU in fmus/"),
    Mutation(
        "no TOML",
        _to("[metrics]", lambda r: r.choice(["[metrics", "=", "\x01", "]]"])),
        2,
        r"line \d+",
    ),
    Mutation("byte-order mark", _to("\ntitle", lambda r: "\ufefftitle"), 0, same="metric.peak_x"),
)
"""Of a scenario file, by its text."""


SPEC = """
title = "A cart"
form = "strict-feedback"

[structure]
n = 2
p = 2
phibar = {"1,1" = [-1, 0], "2,1" = [0, -1]}

[units]
x = ["m", "m/s"]
u = "m/s2"
theta = ["1/s", "1/s2"]

[plant]
name = "CartPlant"
start = {x0 = [1, 0]}

[plant.profile]
"theta[1]" = [{constant = 1}, {sine = {amplitude = 0.2, omega = 3}}]
"theta[2]" = [{constant = 1}]

[controller]
name = "CartController"
start = {c = [1, 2], epsilon = 0.3, delta = 0.2, Gamma = [[1, 0], [0, 2]]}
"""

SPECS = (
    # keys
    Mutation("unknown key", _key("", "form"), 2, r"form is missing|is not known here"),
    Mutation("unknown table", _to("[controller]", lambda r: f"[{word(r)}]"), 2, r"is not known"),
    Mutation("no order", _to("n = 2", lambda r: ""), 2, r"structure\.n is missing"),
    Mutation("form", _to('"strict-feedback"', lambda r: f'"{word(r)}"'), 2, r"form = '\w+' is not"),
    Mutation(
        "a key of another form", _to("n = 2", lambda r: "n = 2\nm = 1"), 2, r"structure\.m is not"
    ),
    Mutation(
        "an order that is none",
        _to("n = 2", lambda r: f"n = {no_number(r)}"),
        2,
        r"structure\.n = .* is not valid; give a whole number",
    ),
    Mutation(
        "an order out of range",
        _to("n = 2", lambda r: f"n = {r.choice([-1, 101, 10**9])}"),
        2,
        r"structure\.n = .* is not valid; give a whole number from 0 to 100",
    ),
    Mutation(
        "a row that is none",
        _to('"2,1"', lambda r: f'"{r.choice(["1,2", "0,1", "3,1", word(r)])}"'),
        2,
        r"structure\.phibar\..* is not known",
    ),
    Mutation(
        "a row of another length",
        _to("[0, -1]", lambda r: str([1] * r.choice([1, 3, 4]))),
        2,
        r"structure\.phibar\.2,1 = .* give 2 numbers",
    ),
    # values
    Mutation("no name", _to('"CartPlant"', lambda r: f'"{word(r)} {word(r)}"'), 2, r"plant\.name"),
    Mutation(
        "one name", _to('"CartController"', lambda r: '"CartPlant"'), 2, r"is the plant's too"
    ),
    Mutation("start", _to("x0 = [1, 0]", lambda r: f"{word(r)} = 1"), 2, r"plant\.start.* is not"),
    Mutation(
        "gain of another size",
        _to("c = [1, 2]", lambda r: f"c = {[1] * r.randint(3, 9)}"),
        2,
        r"controller\.start: c = .* is not valid; give 2",
    ),
    Mutation(
        "gain that is not positive",
        _to("epsilon = 0.3", lambda r: f"epsilon = {-number(r)!r}"),
        2,
        r"controller\.start: .*epsilon",
    ),
    Mutation(
        "gain that is no matrix",
        _to("[[1, 0], [0, 2]]", lambda r: f"[[1, {r.uniform(2, 9)!r}], [0, 2]]"),
        2,
        r"controller\.start: .*Gamma",
    ),
    Mutation(
        "profile of none",
        _to('"theta[1]"', lambda r: f'"theta[{r.randint(3, 9)}]"'),
        2,
        r"plant\.profile\.theta\[\d\] is not known",
    ),
    # units
    Mutation("no unit", _to('"1/s2"]', lambda r: f'"{word(r)}"]'), 2, r"is no unit"),
    Mutation(
        "unit of theta",
        _to('["1/s", "1/s2"]', lambda r: f'["1/s", "{r.choice(["1/s", "N", "m/s2", "1/h2"])}"]'),
        2,
        r"units\.theta = .* does not fit .*; give theta\[2\] the unit '1/s2'",
    ),
    Mutation(
        "unit of x",
        _to('["m", "m/s"]', lambda r: f'["m", "{r.choice(["m", "km/h", "rad/s", "V"])}"]'),
        2,
        r"units\.x = .* does not fit .*; give x\[2\] the unit 'm/s'",
    ),
    Mutation(
        "unit of u",
        _to('"m/s2"', lambda r: f'"{r.choice(["N", "m", "mm/s2", "W"])}"'),
        2,
        r"units\.u = .* does not fit .*; give the unit 'm/s2'",
    ),
    # what changes nothing that is checked
    Mutation("equal unit", _to('"m/s2"', lambda r: f'"{r.choice(["N/kg", "m.s-2"])}"'), 0),
    Mutation("title", _to("A cart", lambda r: word(r)), 0),
)
"""Of a spec, by its text."""

_LINK = 'startElement="plant" startConnector="x" endElement="controller" endConnector="x"/>'
_OUTER = (
    '<ssd:Connector name="force" kind="input"><ssc:Real/></ssd:Connector>',
    '<ssd:Connection startConnector="force" endElement="plant" endConnector="u"/>',
)

SYSTEMS = (
    Mutation("no XML", _to("</ssd:System>", lambda r: ""), 2, r"SystemStructure\.ssd: no XML"),
    Mutation(
        "no kind", _to('kind="input"', lambda r: f'kind="{word(r)}"'), 2, r"line \d+: Element"
    ),
    Mutation(
        "no source",
        _to("resources/ScalarPlant.fmu", lambda r: f"resources/{word(r)}.fmu"),
        2,
        r"component 'plant': there is no 'resources/\w+\.fmu'",
    ),
    Mutation(
        "a source outside",
        _to("resources/ScalarPlant.fmu", lambda r: r.choice(["../", "/etc/"]) + word(r)),
        2,
        r"component 'plant': there is no",
    ),
    Mutation(
        "a system in it",
        _to("</ssd:Elements>", lambda r: f'<ssd:System name="{word(r)}"/></ssd:Elements>'),
        2,
        r"only systems of FMUs can be run",
    ),
    Mutation(
        "no connector",
        _to(_LINK, lambda r: _LINK.replace('"x"', f'"{word(r)}"', 1)),
        2,
        r"no connector 'plant\.\w+'",
    ),
    Mutation(
        "no element",
        _to(_LINK, lambda r: _LINK.replace('"plant"', f'"{word(r)}"')),
        2,
        r"no connector '\w+\.x'",
    ),
    Mutation(
        "a transformation",
        _to(
            _LINK,
            lambda r: (
                f'{_LINK[:-2]}><ssc:LinearTransformation factor="{number(r)!r}"/></ssd:Connection>'
            ),
        ),
        2,
        r"a transformation; put it into an FMU",
    ),
    Mutation(
        "no connector of the system",
        _to("<ssd:Connections>", lambda r: f"<ssd:Connections>{_OUTER[1]}"),
        2,
        r"connector 'force' of the system",
    ),
    Mutation(
        "a mapping",
        _to(
            '<ssd:ParameterBinding source="resources/plant.ssv"/>',
            lambda r: (
                '<ssd:ParameterBinding source="resources/plant.ssv"><ssd:ParameterMapping '
                'source="a.ssm"/></ssd:ParameterBinding>'
            ),
        ),
        2,
        r"parameter mapping",
    ),
    Mutation(
        "no parameters",
        _to("resources/plant.ssv", lambda r: f"resources/{word(r)}.ssv"),
        2,
        r"component 'plant': there is no 'resources/\w+\.ssv'",
    ),
    Mutation(
        "no stop",
        _to(' stopTime="1.0"', lambda r: ""),
        0,  # the annotation has it
        same="metric.peak_x",
    ),
    Mutation(
        "stop before start",
        _to('stopTime="1.0"', lambda r: f'stopTime="{-number(r)!r}"'),
        2,
        r"stop_time = -.* is not valid",
    ),
    Mutation(
        "no stop that is a number",
        _to('stopTime="1.0"', lambda r: f'stopTime="{word(r)}"'),
        2,
        r"SystemStructure\.ssd, line \d+: Element ",
    ),
    Mutation(
        "annotation",
        _to('"step": 0.01', lambda r: f'"step": {word(r)}'),
        2,
        r"annotation .* no JSON",
    ),
    Mutation(
        "annotation with a key twice",
        _to('"step": 0.01', lambda r: f'"step": {number(r)!r}, "step": 0.01'),
        2,
        r"annotation 'congelation': no JSON: 'step' is given twice",
    ),
    Mutation(
        "annotation with connections",
        _to('"experiment": {', lambda r: '"connections": [], "experiment": {'),
        2,
        r"annotation 'congelation': connections are those of the archive; leave them out",
    ),
    Mutation(
        "document type",
        _to(
            "<ssd:SystemStructureDescription",
            lambda r: f'<!DOCTYPE {word(r)} SYSTEM "{word(r)}"><ssd:SystemStructureDescription',
        ),
        2,
        r"SystemStructure\.ssd: it declares a document type",
    ),
    Mutation(
        "coupling",
        _to('"auto"', lambda r: f'"{word(r)}"'),
        2,
        r"experiment\.coupling = '\w+' is not known",
    ),
    Mutation(
        "value",
        _to('<ssv:Real value="1.0"/>', lambda r: f'<ssv:Real value="{word(r)}"/>'),
        2,
        r"resources/plant\.ssv, line \d+",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "type of a value",
        _to('<ssv:Real value="1.0"/>', lambda r: '<ssv:String value="1.0"/>'),
        2,
        r"x0\[1\]': '1\.0' given, a number needed",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "unit of a value",
        _to('<ssv:Real value="0.3"/>', lambda r: '<ssv:Real value="0.3" unit="kg"/>'),
        2,
        r"unit = 'kg' is not the unit of",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "an equal unit",
        _to('<ssv:Real value="0.3"/>', lambda r: '<ssv:Real value="300" unit="ms"/>'),
        0,
        same="metric.peak_x",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "a parameter twice",
        _to(
            "<ssv:Parameters>",
            lambda r: (
                f'<ssv:Parameters><ssv:Parameter name="x0[1]"><ssv:Real value="{number(r)!r}"/>'
                "</ssv:Parameter>"
            ),
        ),
        2,
        r"component 'plant': parameter 'x0\[1\]' is given twice in one set",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "another SSP",
        _to('version="1.0"', lambda r: f'version="{r.randint(2, 9)}.0"'),
        2,
        r"of SSP \d\.0; SSP 1\.0 is needed",
    ),
    Mutation(
        "by model exchange",
        _to('"CoSimulation"', lambda r: '"ModelExchange"'),
        2,
        r"component 'plant' is to be run by model exchange",
    ),
    Mutation(
        "another direction",
        _to('kind="input"', lambda r: 'kind="output"'),
        2,
        r"the connector '\w+' is an output, the variable of the FMU an input",
    ),
    Mutation(
        "a binding with values of its own",
        _to(
            '<ssd:ParameterBinding source="resources/plant.ssv"/>',
            lambda r: (
                '<ssd:ParameterBinding source="resources/plant.ssv"><ssd:ParameterValues>'
                '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/'
                f'SystemStructureParameterValues" version="1.0" name="{word(r)}">'
                "<ssv:Parameters/></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>"
            ),
        ),
        2,
        r"a binding with the source 'resources/plant\.ssv' and with values of its own",
    ),
    Mutation(
        "parameter of none",
        _to('name="x0[1]"', lambda r: f'name="{word(r)}"'),
        0,
        r"there is no variable for the parameter 'plant\.\w+'",
        entry="resources/plant.ssv",
    ),
    Mutation(
        "gain",
        _to('<ssv:Real value="0.3"/>', lambda r: f'<ssv:Real value="{-number(r)!r}"/>'),
        1,
        r"epsilon = .* is refused: it must be positive",
        entry="resources/controller.ssv",
    ),
    Mutation(
        "description",
        _to('description="A short loop"', lambda r: f'description="{word(r)}"'),
        0,
        same="metric.peak_x",
    ),
    Mutation(
        "the order of connectors",
        _to(
            _LINK,
            lambda r: (
                'startElement="controller" startConnector="x" endElement="plant" endConnector="x"/>'
            ),
        ),
        0,
        same="metric.peak_x",
    ),
)
"""Of an SSP archive, by the text of a file in it."""


def _cut(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) // 2)]


def _flipped(rng: random.Random, data: bytes) -> bytes:
    """The directory of the archive, at its end, damaged."""
    place = len(data) - rng.randint(1, 22)
    return data[:place]


ARCHIVES: tuple[tuple[str, Callable[[random.Random, bytes], bytes], str], ...] = (
    ("cut", _cut, r"is not an FMU"),
    ("end cut", _flipped, r"is not an FMU"),
    ("empty", lambda rng, data: b"", r"is not an FMU"),
    ("text", lambda rng, data: word(rng).encode(), r"is not an FMU"),
    ("noise", lambda rng, data: rng.randbytes(rng.randint(1, 9999)), r"is not an FMU"),
)
"""Of an FMU, by its bytes; each is refused with exit code 2."""

FILES: tuple[tuple[str, Callable[[random.Random, bytes], bytes], str], ...] = (
    ("cut", _cut, r"is not an SSP archive"),
    ("end cut", _flipped, r"is not an SSP archive"),
    ("empty", lambda rng, data: b"", r"is not an SSP archive"),
    ("text", lambda rng, data: word(rng).encode(), r"is not an SSP archive"),
)
"""Of an SSP archive, by its bytes; each is refused with exit code 2."""
