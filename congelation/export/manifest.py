"""The manifest of a folder of FMUs: what each was built of, and whether its spec still says so."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from congelation.errors import InvalidInput
from congelation.places import write_whole

__all__ = ["NAME", "enter", "outdated"]

NAME = "manifest.json"


def enter(fmu: Path, entry: Mapping[str, object], spec: Path | None) -> None:
    """Enter a built FMU, in place of an older build of the same name; `spec` is the file of its
    spec, if that was read from one.

    Raises
    ------
    InvalidInput
        The folder has another file of that name.
    """
    manifest = fmu.parent / NAME
    entries: Any = {}
    if manifest.exists():
        try:
            entries = json.loads(manifest.read_text("utf-8"))
        except ValueError:
            entries = None
    if not isinstance(entries, dict):
        raise InvalidInput(
            f"{manifest} was not written by `congelation build`; remove it, or build into "
            "another folder"
        )
    source = {}
    if spec is not None:
        # A path from the folder, so that a project can be moved as a whole.
        place = Path(os.path.relpath(spec.absolute(), fmu.parent.absolute())).as_posix()
        source = {"spec_file": place, "spec_sha256": _digest(spec)}
    entries[fmu.name] = {**entry, "sha256": _sha256(fmu.read_bytes()), **source}
    write_whole(manifest, json.dumps(entries, indent=1, sort_keys=True) + "\n")


def outdated(fmu: Path, sha256: str) -> str:
    """That an FMU was built of another spec than its file holds now, with the command that builds
    it anew; empty where it was not, or where that cannot be known: without a manifest, the spec's
    file, or the FMU that the manifest is of."""
    try:
        entry: Any = json.loads((fmu.parent / NAME).read_text("utf-8"))[fmu.name]
        spec = fmu.parent / entry["spec_file"]
        if entry["sha256"] != sha256 or entry["spec_sha256"] == _digest(spec):
            return ""
    except (OSError, ValueError, LookupError, TypeError):
        return ""
    folder, native = fmu.parent, ""
    if folder.name == "native":
        folder, native = folder.parent, " --native"
    shown = shlex.quote(os.path.relpath(spec))
    out = os.path.relpath(folder)
    where = "" if out == "fmus" else f" --out {shlex.quote(out)}"
    return (
        f"{os.path.relpath(fmu)} was built from another {shown}; run "
        f"`congelation build {shown}{native}{where}`"
    )


def _digest(spec: Path) -> str:
    """SHA-256 of what a spec says; comments and layout are no part of it."""
    said = tomllib.loads(spec.read_text("utf-8"))
    return _sha256(json.dumps(said, sort_keys=True, default=str).encode())


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
