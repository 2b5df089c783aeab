"""TOML tables that know where they stand, and the records that say what may stand in them.

A `Table` lists the keys of a table of a file: type, default, unit, range and one line of text.
`Section.read` checks a table of a file against it; `congelation.keys` holds all of them.
"""

from __future__ import annotations

import math
import os
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

from congelation.errors import InvalidInput, nearest, shown

__all__ = ["TIME_UNITS", "Key", "Section", "Table", "parse_document", "read_document"]

T = TypeVar("T")

TIME_UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}

LARGEST_INTEGER = 2**63 - 1
"""What TOML promises to keep, and result files can hold."""


@dataclass(frozen=True)
class Key:
    """A key of a TOML table.

    Parameters
    ----------
    name : str
    kind : str
        One of `KINDS`: how its value is read.
    text : str
        One line on what it means.
    default : object
        What it is where it is left out.
    required : bool
        Whether it must not be left out.
    unit : str
        Of a number.
    least, most, above, below : float, optional
        Bounds of a number; the latter two do not belong to the range.
    choices : tuple of str
        The values that a text may have; empty: any.
    table : Table, optional
        What stands in it, where it holds tables.
    """

    name: str
    kind: str
    text: str
    default: object = None
    required: bool = False
    unit: str = ""
    least: float | None = None
    most: float | None = None
    above: float | None = None
    below: float | None = None
    choices: tuple[str, ...] = ()
    table: Table | None = None

    @property
    def valid(self) -> str:
        """A phrase for what may be given."""
        if self.choices:
            return "one of: " + ", ".join(self.choices)
        if self.kind == "time" and self.above == 0.0:
            return 'a positive time in seconds, or {value = .., unit = ".."}'
        if self.above is not None and self.below is not None:
            return f"{KINDS[self.kind]} between {self.above:g} and {self.below:g}"
        if self.above == 0.0:
            return KINDS[self.kind].replace("a ", "a positive ", 1)
        if self.least is not None and self.most is not None:
            return f"{KINDS[self.kind]} from {self.least:.0f} to {self.most:.0f}"
        if self.least is not None:
            return f"{KINDS[self.kind]} of at least {self.least:g}"
        return KINDS[self.kind]

    def admits(self, number: float) -> bool:
        """Whether a number is in the range."""
        return (
            (self.least is None or number >= self.least)
            and (self.most is None or number <= self.most)
            and (self.above is None or number > self.above)
            and (self.below is None or number < self.below)
        )


KINDS: Mapping[str, str] = {
    "text": "a string",
    "texts": "an array of strings",
    "name or names": "a string, or an array of strings",
    "number": "a number",
    "numbers": "an array of numbers",
    "integer": "a whole number",
    "boolean": "true or false",
    "quantity": 'a number, or {value = .., unit = ".."}',
    "time": 'a number of seconds, or {value = .., unit = ".."}',
    "table": "a table",
    "tables": "an array of tables",
    "value": "a number, true or false, a string, an array of them, or {value = .., unit = ..}",
    "values": "an array",
    "terms": "a number, or an array of terms",
    "matrix": "numbers, or rows of numbers of one length",
}
"""How the value of a key is read, and the phrase for it in messages."""


@dataclass(frozen=True)
class Table:
    """What may stand in a table of a TOML file.

    `extra` is how keys are read that the user names, such as the components of a system; None
    where there are no keys but those listed.
    """

    text: str
    keys: tuple[Key, ...] = ()
    extra: Key | None = None

    def __getitem__(self, name: str) -> Key:
        return next(key for key in self.keys if key.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """The keys, in order."""
        return tuple(key.name for key in self.keys)


@dataclass(frozen=True)
class Section:
    """A table of a TOML file, or what takes its place where none was read.

    Parameters
    ----------
    file : str
        The file, as messages name it.
    path : str
        The table inside it: ``experiment``, ``components.plant``; empty for the whole file.
    data : mapping
        Its keys and values.
    elsewhere : mapping
        Paths of the keys that were set in another place, e.g. by a variant.
    spelled : callable
        How messages write a path.
    """

    file: str
    path: str
    data: Mapping[str, object]
    elsewhere: Mapping[str, str] = field(default_factory=dict)
    spelled: Callable[[str], str] = str

    def at(self, key: str) -> str:
        """The path of a key of this table; of the table itself where the key is empty."""
        if not key:
            return self.path
        return self.elsewhere.get(key, f"{self.path}.{key}" if self.path else key)

    def place(self, key: str) -> str:
        """File and path of a key, for messages."""
        return f"{self.file}: {self.spelled(self.at(key))}"

    def error(self, key: str, text: str) -> InvalidInput:
        """The error to raise about a key."""
        return InvalidInput(f"{self.place(key)} {text}")

    def within(self, text: str) -> InvalidInput:
        """The error to raise about something in this table."""
        return InvalidInput(f"{self.place('')}: {text}")

    def wrong(self, key: str, valid: str) -> InvalidInput:
        """The error to raise about a value that is not `valid`."""
        return self.error(key, f"= {shown(self.data[key])} is not valid; give {valid}")

    def only(self, known: Iterable[str]) -> Section:
        """This table, after checking that it has no keys but `known` ones."""
        names = list(known)
        for key in self.data:
            if key not in names:
                raise self.error(key, f"is not known here; {nearest(key, names)}")
        return self

    def require(self, *keys: str) -> Section:
        """This table, after checking that it has all of `keys`."""
        for key in keys:
            if key not in self.data:
                raise self.error(key, "is missing")
        return self

    def read(self, table: Table) -> dict[str, Any]:
        """The values of all keys, checked; tables among them are sections.

        Raises
        ------
        InvalidInput
            An unknown key, one that is missing, a value of another type or out of range.
        """
        if table.extra is None:
            self.only(table.names)
        for key in table.keys:
            if key.required and key.name not in self.data:
                raise self.error(key.name, f"is missing; give {key.valid}")
        return {key.name: self.value(key) for key in table.keys}

    def value(self, key: Key) -> Any:
        """The value of one key, checked; its default where it is left out.

        Raises
        ------
        InvalidInput
            A value of another type or out of range.
        """
        name = key.name
        if name not in self.data:
            return _EMPTY[key.kind](self, name) if key.kind in _EMPTY else key.default
        value = self.data[name]
        if key.kind == "integer" and (isinstance(value, bool) or not isinstance(value, int)):
            raise self.wrong(name, key.valid)
        if key.kind != "integer" or key.most is None:
            value = _READERS[key.kind](self, name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            if not key.admits(value):
                raise self.wrong(name, key.valid)
        elif key.choices and value not in key.choices:
            raise self.error(name, f"= '{value}' is not known; {nearest(str(value), key.choices)}")
        return value

    def without(self, key: str) -> Section:
        """This table less one key."""
        return replace(self, data={k: v for k, v in self.data.items() if k != key})

    def section(self, key: str) -> Section:
        """The table under `key`; empty if there is none."""
        value = self.data.get(key, {})
        if not isinstance(value, Mapping):
            raise self.wrong(key, "a table")
        return replace(self, path=self.at(key), data=value, elsewhere={})

    def sections(self, key: str) -> Iterator[Section]:
        """The tables of the array of tables under `key`."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
            raise self.wrong(key, f"an array of tables, [[{self.at(key)}]]")
        for index, table in enumerate(value, start=1):
            yield replace(self, path=f"{self.at(key)}[{index}]", data=table, elsewhere={})

    def subsections(self) -> Iterator[tuple[str, Section]]:
        """The tables in this one, by key."""
        for key in self.data:
            yield key, self.section(key)

    def as_kind(self, key: str, kind: str) -> Any:
        """The value under a key that is there, read as one of `KINDS`.

        Raises
        ------
        InvalidInput
            It is of another type.
        """
        return _READERS[kind](self, key)

    def attempt(self, key: str, action: Callable[[], T]) -> T:
        """The result of `action`; what it says of bad input gets this key's file and path."""
        try:
            return action()
        except ValueError as error:
            raise InvalidInput(f"{self.place(key)}: {error}") from error


_Reader = Callable[[Section, str], Any]


def _reader(valid: str, convert: Callable[[Any], Any]) -> _Reader:
    """Reads what `convert` makes of a value; None: the value is not `valid`."""

    def read(section: Section, key: str) -> Any:
        value = convert(section.data[key])
        if value is None:
            raise section.wrong(key, valid)
        return value

    return read


def _text(section: Section, key: str) -> str:
    value = section.data[key]
    if not isinstance(value, str):
        raise section.wrong(key, "a string")
    if not value.strip():
        raise section.wrong(key, "a string that is not empty")
    return value


def _integer(section: Section, key: str) -> int:
    value = section.data[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise section.wrong(key, "a whole number")
    if abs(value) > LARGEST_INTEGER:
        raise section.wrong(key, "a whole number of at most 64 bits")
    return value


def _seconds(section: Section, key: str) -> float:
    """A time: a number of seconds, or {value = 2, unit = "ms"}."""
    value = section.data[key]
    if not isinstance(value, Mapping):
        if not _is_finite(value):
            raise section.wrong(key, KINDS["time"])
        return float(value)
    quantity = section.section(key).only(("value", "unit")).require("value", "unit")
    unit: str = quantity.as_kind("unit", "text")
    if unit not in TIME_UNITS:
        raise quantity.error("unit", f"= '{unit}' is no time; {nearest(unit, TIME_UNITS)}")
    seconds: float = quantity.as_kind("value", "number") * TIME_UNITS[unit]
    if not math.isfinite(seconds):
        raise section.wrong(key, "a time that is finite in seconds")
    return seconds


def _texts(value: Any) -> tuple[str, ...] | None:
    right = isinstance(value, list) and all(isinstance(v, str) for v in value)
    return tuple(value) if right else None


def _numbers(value: Any) -> tuple[float, ...] | None:
    return (
        tuple(map(float, value))
        if isinstance(value, list) and all(map(_is_finite, value))
        else None
    )


_READERS: Mapping[str, _Reader] = {
    "text": _text,
    "texts": _reader(KINDS["texts"], _texts),
    "name or names": lambda s, key: (
        s.as_kind(key, "texts") if isinstance(s.data[key], list) else (_text(s, key),)
    ),
    "number": _reader(KINDS["number"], lambda v: float(v) if _is_finite(v) else None),
    "numbers": _reader(KINDS["numbers"], _numbers),
    "integer": _integer,
    "boolean": _reader(KINDS["boolean"], lambda v: v if isinstance(v, bool) else None),
    "time": _seconds,
    "table": Section.section,
    "tables": lambda s, key: tuple(s.sections(key)),
    "values": _reader(
        "an array with at least one value",
        lambda v: tuple(v) if isinstance(v, list) and v else None,
    ),
    **dict.fromkeys(("quantity", "value", "terms", "matrix"), lambda s, key: s.data[key]),
}


_EMPTY = {kind: _READERS[kind] for kind in ("table", "tables")}
"""Where these are left out, there is an empty one."""


def read_document(file: Path, kind: str = "scenario") -> tuple[str, Section]:
    """The text of a TOML file, and its outermost table; `kind` is what it is meant to be.

    Raises
    ------
    InvalidInput
        If the file cannot be read or is not TOML; what else it is, if that is clear.
    """
    if os.path.isdir(file):  # unlike Path.is_dir, also of a name that is too long
        raise InvalidInput(f"{file}: this is a folder; give a file (.toml)")
    if os.path.isfile(file) and zipfile.is_zipfile(file):
        raise InvalidInput(f"{file}: this is {_archive_kind(file)}")
    try:
        text = file.read_text(encoding="utf-8-sig")  # with or without a byte order mark
    except FileNotFoundError as error:
        if file.is_symlink():
            raise InvalidInput(
                f"{file}: this is a link to {os.readlink(file)}, which does not exist"
            ) from error
        raise InvalidInput(f"{file}: no such file; {_neighbours(file, kind)}") from error
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InvalidInput(
            f"{file}: line {line} is no UTF-8 text; save the file in this encoding"
        ) from error
    except OSError as error:
        raise InvalidInput(f"{file}: cannot be read ({error.strerror})") from error
    return text, parse_document(text, str(file))


def folders_of(file: str) -> tuple[Path, ...]:
    """The folders that paths in a file start from: its own, and where the file is a link, that of
    what it leads to."""
    path = Path(file).absolute()
    return (path.parent, path.resolve().parent) if path.is_symlink() else (path.parent,)


def parse_document(text: str, name: str) -> Section:
    """The outermost table of a TOML text; `name` is what messages call it."""
    try:
        return Section(name, "", tomllib.loads(text))
    # Besides TOML's own errors, those of a number of thousands of digits and of deep nesting.
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{name}: not valid TOML: {error}") from error


def _is_finite(value: object) -> TypeGuard[float]:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond the largest float
        return False


def _archive_kind(file: Path) -> str:
    """What an archive is, and what to do with it."""
    with zipfile.ZipFile(file) as archive:
        names = archive.namelist()
    if "modelDescription.xml" in names:
        return f"an FMU; check it with: congelation check {file}, or name it in a scenario"
    if "SystemStructure.ssd" in names:
        return "an SSP archive; it can be run if its name ends in .ssp"
    return "a ZIP archive; give a TOML file"


def _neighbours(file: Path, kind: str) -> str:
    names = [p.name for p in sorted(file.parent.glob("*.toml"))] if file.parent.is_dir() else []
    return nearest(file.name, names) if names else f"give the path of a {kind} (.toml)"
