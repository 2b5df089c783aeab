"""The task of a child process: the FMU, the rule, and what the FMU can do."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path

from congelation.conformance.description import Description

__all__ = ["Ability", "Job", "binary_path", "platform_folder"]

_EXTENSIONS = {"Linux": ".so", "Windows": ".dll", "Darwin": ".dylib"}
_FOLDERS = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}


@dataclass(frozen=True)
class Ability:
    """What the survey found that an FMU can do; each failure is the finding of one rule.

    Attributes
    ----------
    loads, runs : str
        Why the library cannot be loaded or a plain run fails; "" if it does.
    moves : bool
        Whether a run with moving inputs succeeds. If not, all runs use the start values.
    again : str
        Why there is no second instance after the first in a process; "" if there is.
    beside : str
        Why there is no second instance next to the first; "" if there is.
    repeats : bool
        Whether a second run gives the same values as the first.
    reference : str
        File with the trajectory of a run, which rules compare theirs with; "" for none.
    """

    loads: str = ""
    runs: str = ""
    moves: bool = True
    again: str = ""
    beside: str = ""
    repeats: bool = True
    reference: str = ""


@dataclass(frozen=True)
class Job:
    """What a child process is to do; paths as text, so that it travels as JSON.

    Attributes
    ----------
    rule : str
        Id of the rule, "" for a task.
    module : str
        Where the rule is.
    task, argument : str
        A task of `congelation.conformance.child_main` and its argument.
    directory : str
        The unzipped FMU.
    companion : str
        Another unzipped FMU, to be loaded in the same process.
    scratch : str
        A directory of the child's own, its working directory.
    able : Ability
        What the FMU can do, by the survey.
    """

    directory: str
    companion: str
    scratch: str
    rule: str = ""
    module: str = ""
    task: str = ""
    argument: str = ""
    able: Ability = field(default_factory=lambda: Ability())

    @property
    def tape(self) -> Path:
        """Where the name of the function being called stands."""
        return Path(self.scratch) / "tape"

    @property
    def result(self) -> Path:
        """Where the child leaves what it found, as JSON."""
        return Path(self.scratch) / "result.json"

    @property
    def words(self) -> Path:
        """What the child writes to standard error.

        A file and no pipe: a process that the FMU starts and leaves may hold a pipe open.
        """
        return Path(self.scratch) / "stderr"

    def saved(self) -> Path:
        """A file with the job as JSON, which the child reads."""
        path = Path(self.scratch) / "job.json"
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")
        return path


def platform_folder() -> str:
    """The folder of this platform's binaries inside an FMU (section 2.3)."""
    return _FOLDERS.get(platform.system(), "")


def binary_path(directory: Path, description: Description) -> Path:
    """Where the shared library for this platform has to lie."""
    extension = _EXTENSIONS.get(platform.system(), "")
    return directory / "binaries" / platform_folder() / f"{description.identifier}{extension}"
