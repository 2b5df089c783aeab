"""Mutants of the archive: for each rule about the package, one that breaks it."""

from __future__ import annotations

import re
import stat
import zipfile
from collections.abc import Callable
from io import BytesIO, RawIOBase
from pathlib import Path

import lag
from mutant import Mutant, Pack, archive, extra, renamed, xml

__all__ = ["ARCHIVE_MUTANTS"]


def truncated(folder: Path, entries: lag.Entries) -> Path:
    """The first half of an archive."""
    path = archive(folder, entries)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def damaged(folder: Path, entries: lag.Entries) -> Path:
    """A byte of the first entry's content is another."""
    path = folder / "lag.fmu"
    with zipfile.ZipFile(path, "w") as target:
        for name, content in entries.items():
            target.writestr(name, content)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"First-order", b"Fourth-order"[:11], 1))
    return path


def misnamed(folder: Path, entries: lag.Entries) -> Path:
    """An archive called .zip."""
    return lag.write_archive(folder / "lag.zip", entries)


def with_info(change: Callable[[zipfile.ZipInfo], None], name: str = "resources/more") -> Pack:
    """One more entry, whose header is changed before it is written."""

    def pack(folder: Path, entries: lag.Entries) -> Path:
        path = archive(folder, entries)
        info = zipfile.ZipInfo(name)
        change(info)
        with zipfile.ZipFile(path, "a") as target:
            target.writestr(info, b"content", compress_type=info.compress_type)
        return path

    return pack


def _bzip2(info: zipfile.ZipInfo) -> None:
    info.compress_type = zipfile.ZIP_BZIP2


def _newer(info: zipfile.ZipInfo) -> None:
    info.extract_version = 45


def _link(info: zipfile.ZipInfo) -> None:
    info.external_attr = (stat.S_IFLNK | 0o777) << 16


def _backslash(info: zipfile.ZipInfo) -> None:
    info.filename = info.orig_filename = "resources\\more"


def encrypted(folder: Path, entries: lag.Entries) -> Path:
    """The flag of encryption is set for the resource, in both headers."""
    path = archive(folder, entries)
    data = bytearray(path.read_bytes())
    for signature, flags, length, name in ((b"PK\3\4", 6, 26, 30), (b"PK\1\2", 8, 28, 46)):
        for found in re.finditer(re.escape(signature), bytes(data)):
            start = found.start()
            size = int.from_bytes(data[start + length : start + length + 2], "little")
            if data[start + name : start + name + size] == b"resources/feedthrough.txt":
                data[start + flags] |= 1
    path.write_bytes(data)
    return path


class _Pipe(RawIOBase):
    """A file that cannot be rewound, so that the archive needs data descriptors."""

    def __init__(self) -> None:
        self.content = BytesIO()

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        return self.content.write(bytes(data))  # type: ignore[call-overload]  # any buffer


def streamed(folder: Path, entries: lag.Entries) -> Path:
    """Stored entries with data descriptors, as written to a pipe."""
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_STORED) as target:
        for name, content in entries.items():
            target.writestr(name, content)
    path = folder / "lag.fmu"
    path.write_bytes(pipe.content.getvalue())
    return path


def doubled(folder: Path, entries: lag.Entries) -> Path:
    """The resource twice, under names that were different while being written."""
    path = archive(folder, {**entries, "resources/feedthrough.TXT": b"0.7"})
    path.write_bytes(path.read_bytes().replace(b"feedthrough.TXT", b"feedthrough.txt"))
    return path


ARCHIVE_MUTANTS: tuple[Mutant, ...] = (
    Mutant("FMI2-PACK-01", "lag.fmu cannot be read: File is not a zip file", pack=truncated),
    Mutant("FMI2-PACK-01", "lag.fmu cannot be read: Bad CRC-32 for file", pack=damaged),
    Mutant("FMI2-PACK-01", "the name of lag.zip does not end in .fmu", pack=misnamed),
    Mutant(
        "FMI2-PACK-02",
        "the archive has no modelDescription.xml at its root",
        edit=renamed("^", "lag/"),
    ),
    Mutant("FMI2-PACK-03", "resources/more uses compression method 12", pack=with_info(_bzip2)),
    Mutant("FMI2-PACK-04", "resources/more needs ZIP 4.5", pack=with_info(_newer)),
    Mutant("FMI2-PACK-04", "resources/feedthrough.txt is encrypted", pack=encrypted),
    Mutant("FMI2-PACK-05", "'resources\\\\more' contains a backslash", pack=with_info(_backslash)),
    Mutant("FMI2-PACK-05", "'/resources/more' is an absolute path", edit=extra("/resources/more")),
    Mutant(
        "FMI2-PACK-06",
        "'resources/../../more' leads out of the archive",
        edit=extra("resources/../../more"),
    ),
    Mutant("FMI2-PACK-06", "resources/feedthrough.txt occurs 2 times", pack=doubled),
    Mutant("FMI2-PACK-07", "resources/more is a symbolic link", pack=with_info(_link)),
    Mutant("FMI2-PACK-08", "/lag.so", edit=renamed("lag.so", "liblag.so")),
    Mutant(
        "FMI2-PACK-08",
        "the archive has neither sources nor binaries",
        edit=renamed("^(binaries|sources)/", "extra/"),
    ),
    Mutant(
        "FMI2-PACK-09",
        "modelDescription.xml is stored uncompressed with general purpose bit 3",
        pack=streamed,
    ),
    Mutant("FMI2-PACK-10", "'notes.txt' at the top of the archive", edit=extra("notes.txt")),
    Mutant(
        "FMI2-PACK-11", "documentation/ has no index.html", edit=renamed("index.html", "main.html")
    ),
    Mutant("FMI2-PACK-12", "model.png is no PNG image", edit=extra("model.png", b"no image")),
    Mutant(
        "FMI2-PACK-13",
        "SourceFiles lists lag.c, which is not in sources/",
        edit=renamed("sources/lag.c", "sources/other.c"),
    ),
    xml(
        "FMI2-PACK-13",
        "there are sources, but no SourceFiles",
        '<SourceFiles><File name="lag.c"/></SourceFiles>',
        "",
    ),
)
