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

__all__ = ["ARCHIVES", "KEYS", "Mutation"]

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
        Exit code of ``congelation run``.
    says : str
        Regular expression that the last line of stderr has; of a code of 0, that none has.
    same : str
        Column of the row that keeps its value, where nothing else should change it.
    """

    name: str
    change: Change
    code: int
    says: str = ""
    same: str = ""


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
        r"shape \d+ given, 1 needed",
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
