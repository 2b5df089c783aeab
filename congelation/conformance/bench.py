"""The test bench on which a dynamic rule puts an FMU."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from congelation.conformance.binding import Library, Tape
from congelation.conformance.description import Description, Value, read_description
from congelation.conformance.instance import Instance
from congelation.conformance.rule import NotApplicable, Violated
from congelation.conformance.trajectory import (
    Grid,
    Trajectory,
    demand,
    excite,
    first_difference,
    simulate,
)

__all__ = ["Bench", "Job", "binary_path", "platform_folder"]

_EXTENSIONS = {"Linux": ".so", "Windows": ".dll", "Darwin": ".dylib"}
_FOLDERS = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}
# Where nothing says how long a step is; short against the seconds in which models move.
_DEFAULT_STEP = 1e-2


@dataclass(frozen=True)
class Job:
    """What a child process is to do; paths as text, so that it travels as JSON.

    Attributes
    ----------
    rule : str
        Id of the rule, "" for a task.
    task, argument : str
        A task of `congelation.conformance.tasks` and its argument.
    directory : str
        The unzipped FMU.
    companion : str
        Another unzipped FMU, to be loaded in the same process.
    scratch : str
        A directory of the child's own, its working directory.
    """

    directory: str
    companion: str
    scratch: str
    rule: str = ""
    task: str = ""
    argument: str = ""

    @property
    def tape(self) -> Path:
        """Where the name of the function being called stands."""
        return Path(self.scratch) / "tape"

    @property
    def result(self) -> Path:
        """Where the child leaves what it found, as JSON."""
        return Path(self.scratch) / "result.json"


def platform_folder() -> str:
    """The folder of this platform's binaries inside an FMU (section 2.3)."""
    return _FOLDERS.get(platform.system(), "")


def binary_path(directory: Path, description: Description) -> Path:
    """Where the shared library for this platform has to lie."""
    extension = _EXTENSIONS.get(platform.system(), "")
    return directory / "binaries" / platform_folder() / f"{description.identifier}{extension}"


class Bench:
    """An unzipped FMU, loaded on demand, with the moves that rules share.

    Parameters
    ----------
    job : Job
        Which FMU, and where to work.

    Attributes
    ----------
    notes : list of str
        Things worth knowing that are no breach.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.directory = Path(job.directory)
        self.description = read_description((self.directory / "modelDescription.xml").read_bytes())
        self.notes: list[str] = []
        self._tape = Tape(job.tape)

    @cached_property
    def binary(self) -> Path:
        """The shared library for this platform."""
        if self.description.identifier is None:
            raise NotApplicable("no FMU for co-simulation: there is no <CoSimulation>")
        path = binary_path(self.directory, self.description)
        if not path.is_file():
            raise NotApplicable(f"no binary for this platform ({path.parent.name}/{path.name})")
        return path

    @cached_property
    def library(self) -> Library:
        """The loaded shared library.

        Raises
        ------
        NotApplicable
            There is none for this platform.
        Violated
            It cannot be loaded.
        """
        try:
            return Library(self.binary, self._tape)
        except OSError as error:
            raise Violated(f"the shared library cannot be loaded: {error}") from error

    def load(self) -> Library:
        """The shared library, in a handle of its own."""
        return Library(self.binary, self._tape)

    @cached_property
    def grid(self) -> Grid:
        """The communication points of a test run, from DefaultExperiment where it says."""
        experiment = self.description.experiment
        start, step = experiment.start or 0.0, experiment.step
        if step is None or step <= 0.0:
            step = _DEFAULT_STEP
        return Grid(start, step)

    @property
    def alone_only(self) -> bool:
        """Whether there may be no second instance in the process."""
        return self.description.flag("canBeInstantiatedOnlyOncePerProcess")

    @property
    def uri(self) -> str:
        """URI of the resources directory."""
        return (self.directory / "resources").as_uri()

    def attempt(
        self,
        name: str = "tested",
        *,
        guid: str | None = None,
        uri: str | None = None,
        logging: bool = True,
        memory: bool = True,
        library: Library | None = None,
    ) -> Instance:
        """Call fmi2Instantiate, whatever comes of it."""
        return Instance(
            library or self.library,
            name=name,
            guid=self.description.guid if guid is None else guid,
            uri=self.uri if uri is None else uri,
            logging=logging,
            memory=memory,
        )

    def fresh(
        self,
        name: str = "tested",
        *,
        uri: str | None = None,
        logging: bool = True,
        memory: bool = True,
        library: Library | None = None,
    ) -> Instance:
        """A new instance, in state "instantiated".

        Raises
        ------
        Violated
            fmi2Instantiate returned a null pointer.
        """
        instance = self.attempt(name, uri=uri, logging=logging, memory=memory, library=library)
        if instance.component is None:
            said = "; ".join(m.text or "" for m in instance.messages) or "and logged nothing"
            raise Violated(f"fmi2Instantiate returned a null pointer: {said}")
        return instance

    def initialize(self, instance: Instance, phase: float = 0.0) -> Instance:
        """Bring an instance from "instantiated" to the first communication point."""
        self.begin(instance, phase)
        demand(instance.leave(), "fmi2ExitInitializationMode")
        return instance

    def begin(
        self, instance: Instance, phase: float = 0.0, *, instead: Mapping[int, Value] | None = None
    ) -> Instance:
        """Bring an instance from "instantiated" into Initialization Mode, inputs excited."""
        demand(instance.setup(self.grid.start), "fmi2SetupExperiment")
        demand(instance.enter(), "fmi2EnterInitializationMode")
        excite(instance, self.description, 0, phase, instead)
        return instance

    def ready(self, name: str = "tested", *, phase: float = 0.0) -> Instance:
        """A new instance at the first communication point."""
        return self.initialize(self.fresh(name), phase)

    def run(
        self,
        instance: Instance,
        *,
        first: int = 0,
        last: int | None = None,
        phase: float = 0.0,
        quiet: bool = False,
    ) -> Trajectory:
        """Simulate on the grid of the bench."""
        return simulate(
            instance,
            self.description,
            self.grid,
            first=first,
            last=last,
            phase=phase,
            quiet=quiet,
        )

    @cached_property
    def reference(self) -> Trajectory:
        """What a fresh instance does, left alone.

        Raises
        ------
        NotApplicable
            Not even that works, which is the finding of another rule.
        """
        try:
            return self.alone()
        except Violated as breach:
            raise NotApplicable(f"a plain run fails already ({breach}); see FMI2-LIB-03") from None

    def plain_run(self) -> None:
        """Make sure that the FMU can be simulated at all.

        Raises
        ------
        NotApplicable
            It cannot, which is the finding of another rule.
        """
        _ = self.reference

    def alone(self, phase: float = 0.0) -> Trajectory:
        """Instantiate, initialize, simulate, terminate and free one instance."""
        instance = self.ready(phase=phase)
        trajectory = self.run(instance, phase=phase)
        demand(instance.terminate(), "fmi2Terminate")
        instance.free()
        return trajectory

    def compare(self, found: Trajectory, what: str) -> Iterator[str]:
        """A line if a run differs from the reference."""
        difference = first_difference(found, self.reference.after(-len(found.rows)))
        if difference is not None:
            yield f"{what}: {difference}"

    @contextmanager
    def held(self, name: str = "tested", *, phase: float = 0.0) -> Iterator[Instance]:
        """A new instance at the first communication point, freed at the end."""
        instance = self.ready(name, phase=phase)
        yield instance
        instance.free()

    def elsewhere(self, task: str, *, directory: Path | None = None, argument: str = "") -> str:
        """Do a task of `congelation.conformance.tasks` in another process.

        Raises
        ------
        Violated
            The other process failed; the text holds its last words.
        """
        scratch = Path(self.job.scratch) / f"elsewhere-{task}"
        scratch.mkdir(exist_ok=True)
        job = Job(
            directory=str(directory or self.directory),
            companion=self.job.companion,
            scratch=str(scratch),
            task=task,
            argument=argument,
        )
        done = subprocess.run(
            [sys.executable, "-m", "congelation.conformance.child"],
            input=json.dumps(asdict(job)),
            text=True,
            capture_output=True,
            check=False,
        )
        if done.returncode != 0 or not job.result.exists():
            raise Violated(f"another process ended with {done.returncode}: {done.stderr[-400:]}")
        return job.result.read_text(encoding="utf-8")
