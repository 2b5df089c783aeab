"""Specs and scenarios to start from: those shipped with the package, and a new pair of them."""

from __future__ import annotations

import importlib.resources
import re
import tempfile
from pathlib import Path
from typing import Any

from congelation.arguments import checked
from congelation.errors import InvalidInput
from congelation.export.transfer import marks, transfer_function
from congelation.places import check_folder, shipped, write_whole

__all__ = ["copy_examples", "write_starter"]


@checked
def copy_examples(folder: Path | str) -> list[Path]:
    """Copy the shipped specs and scenarios, with their tables, into folders of `folder`.

    Returns
    -------
    list of Path
        The files. One that is there already with the same content stays.

    Raises
    ------
    InvalidInput
        A file of that name has another content, or nothing can be written there.

    Examples
    --------
    >>> files = cg.examples(folder)
    >>> (folder / "specs" / "f16_pitch.toml") in files
    True
    """
    texts = {
        Path(folder) / kind / file.name: file.read_bytes()
        for kind in ("specs", "scenarios")
        for file in sorted(shipped(kind).iterdir())
        if file.suffix in (".toml", ".csv")  # scenarios name tables beside them
    }
    # Nobody's work is overwritten, and nothing is copied before that is sure.
    for target, text in texts.items():
        if target.exists() and not (target.is_file() and target.read_bytes() == text):
            raise InvalidInput(
                f"{target} is there already, with another content; give another folder"
            )
    for target, text in texts.items():
        check_folder("DIR", target.parent)
        write_whole(target, text)
    return list(texts)


@checked
def write_starter(
    name: str, folder: Path | str = ".", source: Any = None, spread: float = 0.0
) -> Path:
    """Write a commented spec and scenario to start from, into the new folder `name`.

    Parameters
    ----------
    name : str
        Of the folder; letters, digits and _, beginning with a letter. ``wing_flap`` gives the FMUs
        WingFlapPlant and WingFlapController.
    folder : Path or str
        Where to make it.
    source : Path, str, mapping or python-control system, optional
        The transfer function of the plant: a TOML file or a mapping with ``numerator`` and
        ``denominator``, whose coefficients may be intervals; without one the spec is of an example
        in state feedback.
    spread : float
        Half the width of the intervals of the coefficients of its denominator that are given as
        numbers, relative to them.

    Returns
    -------
    Path
        The new folder.

    Raises
    ------
    InvalidInput
        The name is not valid, there is such a folder already, or the transfer function breaks an
        assumption.

    Examples
    --------
    >>> made = cg.new("wing_flap", folder)
    >>> sorted(file.name for file in made.iterdir())
    ['scenario.toml', 'spec.toml']
    >>> plant = {"numerator": [2.0], "denominator": [1.0, [0.5, 1.5], [-1.0, 1.0]]}
    >>> made = cg.new("servo", folder, plant)
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,99}", name):
        raise InvalidInput(
            f"NAME '{name}' is not valid; give letters, digits and _, beginning with a letter, "
            "and 100 at most"
        )
    kind, further = "", {}
    if source is not None:
        kind, further = "_output", marks(transfer_function(source, spread))
    elif spread:
        raise InvalidInput("spread has no effect without a transfer function; give one as well")
    made = Path(folder) / name
    if made.exists():
        raise InvalidInput(f"{made} is there already; give another name")
    check_folder("NAME", made.parent)
    words = {
        **further,
        "@NAME@": name,
        "@FOLDER@": str(made),
        "@FMU@": "".join(part[:1].upper() + part[1:] for part in name.split("_")),
    }
    # The folder appears with both files or, where this is interrupted, not at all.
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=made.parent) as temporary:
        whole = Path(temporary) / name
        whole.mkdir()
        for file in ("spec.toml", "scenario.toml"):
            shape = file.replace(".toml", f"{kind}.toml")
            template = importlib.resources.files("congelation.export") / "starter" / shape
            text = template.read_text("utf-8")
            for mark, word in words.items():
                text = text.replace(mark, word)
            (whole / file).write_text(text, "utf-8")
        whole.rename(made)
    return made
