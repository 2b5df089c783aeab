"""fmus/manifest.json: what was built, of what, with what."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree

from congelation.errors import InvalidInput
from congelation.export.spec import FmuSpec

__all__ = ["update_manifest"]

# What the content of an FMU follows from, besides its spec.
_TOOLS = ("congelation", "casadi", "pythonfmu", "fmpy")


def update_manifest(manifest: Path, path: Path, fmu: FmuSpec, spec: str) -> None:
    """Enter a built FMU in the manifest, in place of an older build of the same name."""
    entries = _entries(manifest)
    with zipfile.ZipFile(path) as archive:
        guid = ElementTree.fromstring(archive.read("modelDescription.xml")).get("guid")
    entries[path.name] = {
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "guid": guid,
        "model": fmu.model.name,
        "spec": spec,
        "tools": {name: importlib.metadata.version(name) for name in _TOOLS},
    }
    manifest.write_text(json.dumps(entries, indent=1, sort_keys=True) + "\n", "utf-8")


def _entries(manifest: Path) -> dict[str, object]:
    if not manifest.exists():
        return {}
    try:
        entries = json.loads(manifest.read_text("utf-8"))
    except ValueError:
        entries = None
    if not isinstance(entries, dict):
        raise InvalidInput(f"{manifest} was not written by build_fmu.py; remove it")
    return entries
