"""Mutants of modelDescription.xml: for each rule about it, one that breaks it."""

from __future__ import annotations

import re

import lag
from mutant import XML, Mutant, swap, xml

__all__ = ["XML_MUTANTS"]

G = 'name="g" valueReference="3" causality="parameter" variability="tunable"'
FIRST = 'name="first" valueReference="100" causality="parameter" variability="fixed"'
W = '<ScalarVariable name="w" valueReference="9" causality="output">\n      <Real/>'
ALSO_Y = 'name="also_y" valueReference="8"'


def _tables_swapped(entries: lag.Entries) -> lag.Entries:
    first = swap('name="table[1]"', 'name="aside"')
    second = swap('name="table[2]"', 'name="table[1]"')
    third = swap('name="aside"', 'name="table[2]"')
    return third(second(first(entries)))


def _last_unknown_first(entries: lag.Entries) -> lag.Entries:
    last = '<Unknown index="15" dependencies="5"/>'
    return swap("<InitialUnknowns>", f"<InitialUnknowns>{last}")(swap(last, "")(entries))


DOCUMENT = (
    xml(
        "FMI2-XML-01",
        "the declared encoding is ISO-8859-1, not UTF-8",
        'encoding="UTF-8"',
        'encoding="ISO-8859-1"',
    ),
    xml(
        "FMI2-XML-01",
        "the first line declares no encoding",
        '<?xml version="1.0" encoding="UTF-8"?>\n',
        "",
    ),
    xml(
        "FMI2-XML-01", "not well-formed: Opening and ending tag mismatch:", "</ModelStructure>", ""
    ),
    xml("FMI2-XML-02", "attribute 'colour'", 'modelName="Lag"', 'modelName="Lag" colour="red"'),
    xml(
        "FMI2-XML-02",
        "The attribute 'guid' is required",
        'guid="{4f8a1d52-6f0e-4a53-9a55-2f7c0b1d9e01}"',
        "",
    ),
    xml("FMI2-XML-03", 'max="INF"', 'min="0.001"', 'min="0.001" max="INF"'),
    xml(
        "FMI2-XML-04",
        'generationDateAndTime="2024-01-01T00:00:00+01:00"',
        "2024-01-01T00:00:00Z",
        "2024-01-01T00:00:00+01:00",
    ),
    xml(
        "FMI2-XML-05",
        'CoSimulation has modelIdentifier="my.lag"',
        'modelIdentifier="lag"',
        'modelIdentifier="my.lag"',
    ),
    Mutant(
        "FMI2-XML-06",
        "there is neither <ModelExchange> nor <CoSimulation>",
        edit=lambda entries: {
            **entries,
            XML: re.sub(rb"<CoSimulation.*</CoSimulation>", b"", entries[XML], flags=re.DOTALL),
        },
    ),
    xml(
        "FMI2-XML-07",
        "Unit 's' is defined 2 times",
        '<Unit name="1/s">',
        '<Unit name="s"/><Unit name="1/s">',
    ),
    xml(
        "FMI2-XML-07",
        "Category 'logEvents' is defined 2 times",
        "<Category ",
        '<Category name="logEvents"/><Category ',
    ),
    xml(
        "FMI2-XML-08",
        "Sign has 2 items with value '1'",
        'name="minus" value="3"',
        'name="minus" value="1"',
    ),
    xml(
        "FMI2-XML-09", "stopTime -1 is not after startTime 0", 'stopTime="10.0"', 'stopTime="-1.0"'
    ),
    xml("FMI2-XML-09", "stepSize 0 is not positive", 'stepSize="0.05"', 'stepSize="0.0"'),
    xml(
        "FMI2-XML-10",
        "canSerializeFMUstate is true and canGetAndSetFMUstate is false",
        'canGetAndSetFMUstate="true"',
        "",
    ),
)

VARIABLES = (
    xml("FMI2-VARS-01", "2 variables are named 'y'", 'name="also_y"', 'name="y"'),
    xml("FMI2-VARS-01", "'also y' is no structured name", 'name="also_y"', 'name="also y"'),
    xml("FMI2-VARS-01", "a variable has an empty name", 'name="also_y"', 'name=""'),
    Mutant(
        "FMI2-VARS-02", "the elements of table[] are not in row-major order", edit=_tables_swapped
    ),
    xml(
        "FMI2-VARS-02",
        "the elements of table[] are not consecutive",
        'name="steps"',
        'name="table[3]"',
    ),
    xml(
        "FMI2-VARS-03",
        'g: causality="parameter" with variability="continuous"',
        G,
        G.replace("tunable", "continuous"),
    ),
    xml(
        "FMI2-VARS-03",
        "first: a variable of type Integer is",
        FIRST,
        FIRST.replace(' variability="fixed"', ""),
    ),
    xml(
        "FMI2-VARS-04",
        'first: initial="calculated" with causality="parameter",',
        FIRST,
        f'{FIRST} initial="calculated"',
    ),
    xml(
        "FMI2-VARS-04",
        'u: initial="exact" with causality="input",',
        'causality="input"',
        'causality="input" initial="exact"',
    ),
    xml("FMI2-VARS-05", "u has no start value", 'start="0.25" ', ""),
    xml(
        "FMI2-VARS-05",
        'w (initial="calculated") has a start value',
        W,
        W.replace("<Real/>", '<Real start="1.0"/>'),
    ),
    xml(
        "FMI2-VARS-06", "independent are time, also_y", ALSO_Y, f'{ALSO_Y} causality="independent"'
    ),
    xml(
        "FMI2-VARS-07",
        "the unit 'm/s' of u is not defined",
        '<Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>',
        "",
    ),
    xml(
        "FMI2-VARS-07",
        "w has a displayUnit and no unit",
        W,
        W.replace("<Real/>", '<Real displayUnit="m"/>'),
    ),
    xml(
        "FMI2-VARS-08",
        "the type 'Breadth' of x is not defined",
        'declaredType="Length"',
        'declaredType="Breadth"',
    ),
    xml(
        "FMI2-VARS-08",
        "x is Real, its type 'Sign' is not",
        'declaredType="Length"',
        'declaredType="Sign"',
    ),
    xml(
        "FMI2-VARS-08",
        "w is the name of a variable and of a type",
        'SimpleType name="Length"',
        'SimpleType name="w"',
    ),
    xml(
        "FMI2-VARS-09",
        "Real 10 (table[1], table[2]): more than one can be set",
        'valueReference="11"',
        'valueReference="10"',
    ),
    xml(
        "FMI2-VARS-09",
        "constants share a reference with variables that are none",
        ALSO_Y,
        'name="also_y" valueReference="4"',
    ),
    xml(
        "FMI2-VARS-09",
        "Real 8 (y, also_y): different units",
        f'{ALSO_Y}>\n      <Real unit="m"/>',
        f"{ALSO_Y}>\n      <Real/>",
    ),
    xml(
        "FMI2-VARS-10",
        "der(x) has the attribute reinit",
        'derivative="11"',
        'derivative="11" reinit="true"',
    ),
    xml("FMI2-VARS-11", "der(x) is the derivative of 5", 'derivative="11"', 'derivative="5"'),
    xml("FMI2-VARS-11", "der(x) is the derivative of 99", 'derivative="11"', 'derivative="99"'),
)

STRUCTURE = (
    xml("FMI2-STRUCT-01", "missing: steps", '<Unknown index="15" dependencies=""/>\n', ""),
    xml("FMI2-STRUCT-01", "must not be there: u", "<Outputs>", '<Outputs><Unknown index="2"/>'),
    xml("FMI2-STRUCT-01", "y is listed 2 times", "<Outputs>", '<Outputs><Unknown index="13"/>'),
    xml("FMI2-STRUCT-02", "missing: steps", '<Unknown index="15" dependencies="5"/>', ""),
    xml(
        "FMI2-STRUCT-02",
        "must not be there: x",
        "<InitialUnknowns>",
        '<InitialUnknowns><Unknown index="11"/>',
    ),
    Mutant("FMI2-STRUCT-03", "twice_k comes after steps", edit=_last_unknown_first),
    xml("FMI2-STRUCT-04", "der(x) is no state derivative", 'derivative="11" ', ""),
    xml(
        "FMI2-STRUCT-04",
        "the state k is neither local nor output",
        'derivative="11"',
        'derivative="3"',
    ),
    xml(
        "FMI2-STRUCT-05",
        "InitialUnknowns: y depends on w, no Known there",
        'dependencies="4 8 11"',
        'dependencies="4 8 11 14"',
    ),
    xml(
        "FMI2-STRUCT-05",
        "InitialUnknowns: the dependencies of y are not ascending",
        'dependencies="4 8 11"',
        'dependencies="11 8 4"',
    ),
    xml(
        "FMI2-STRUCT-06",
        "Outputs: w has 1 kinds for other dependencies",
        '"constant constant"',
        '"constant"',
    ),
    xml(
        "FMI2-STRUCT-06",
        "InitialUnknowns: twice_k has the kind 'tunable'",
        'dependencies="3" dependenciesKind="constant"',
        'dependencies="3" dependenciesKind="tunable"',
    ),
    xml(
        "FMI2-STRUCT-07",
        "InitialUnknowns: w depends on u",
        'dependencies="2 11 17 18"',
        'dependencies="11 17 18"',
    ),
    xml(
        "FMI2-STRUCT-07",
        "InitialUnknowns: y depends on g",
        'dependencies="4 8 11"',
        'dependencies="8 11"',
    ),
    xml(
        "FMI2-STRUCT-08",
        "Outputs: w depends on u",
        'dependencies="2 11" dependenciesKind="constant constant"',
        'dependencies="11"',
    ),
)

XML_MUTANTS: tuple[Mutant, ...] = (*DOCUMENT, *VARIABLES, *STRUCTURE)
