"""What runs, files and the code are identified by: hashes of their content, and versions."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import congelation

__all__ = ["NUMERICS_VERSION", "code_version", "content_hash", "file_hash", "text_of"]

NUMERICS_VERSION = 8
"""Part of the identity of a run: raise it whenever equal inputs give other numbers than before.

The digest of the sources is no part of it, as most changes of the sources change no number.
"""

ID_LENGTH = 16  # hex digits; 64 bits, so 10^6 runs collide with probability 3e-8


def text_of(content: object) -> bytes:
    """JSON-representable `content` as bytes; equal content gives equal bytes."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=True).encode()


def content_hash(content: object) -> str:
    """Identifier of JSON-representable `content`."""
    return hashlib.sha256(text_of(content)).hexdigest()[:ID_LENGTH]


def file_hash(file: Path) -> str:
    """SHA-256 of a file, in hex."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_version() -> str:
    """Version of congelation and a digest of its sources: ``0.1.0+5f0c9a1d2b3e``."""
    root = Path(congelation.__file__).parent
    digest = hashlib.sha256()
    for source in sorted(root.rglob("*.py")):
        digest.update(source.relative_to(root).as_posix().encode() + b"\0")
        digest.update(source.read_bytes() + b"\0")
    try:
        number = version("congelation")
    except PackageNotFoundError:  # used from a source tree that is not installed
        number = "0"
    return f"{number}+{digest.hexdigest()[:12]}"
