"""What a run, a file and the code are known by: hashes of what they consist of."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import congelation

__all__ = ["code_version", "content_hash", "file_hash"]

_ID_LENGTH = 16  # hex digits; 64 bits, so 10^6 runs collide with probability 3e-8


def content_hash(content: object) -> str:
    """Identifier of JSON-representable `content`: equal content, equal identifier."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_ID_LENGTH]


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
