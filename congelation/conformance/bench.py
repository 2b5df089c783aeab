"""The test bench on which a dynamic rule puts an FMU."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from congelation.conformance.binding import Library, Tape
from congelation.conformance.description import Description, Value, read_description
from congelation.conformance.instance import CO_SIMULATION, Instance
from congelation.conformance.job import Job, binary_path
from congelation.conformance.rule import NotApplicable, NotEvaluated, Violated, require
from congelation.conformance.trajectory import (
    Grid,
    Trajectory,
    by_base,
    demand,
    excite,
    first_difference,
    observe,
)

__all__ = ["Bench", "from_text", "to_text"]

# Where nothing says how long a step is; short against the seconds in which models move.
_DEFAULT_STEP = 1e-2
# Messages of the FMU that go with a finding, and instances that are asked for them.
_LAST = 5


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
        description = read_description((self.directory / "modelDescription.xml").read_bytes())
        self.description = description if job.able.moves else description.at_rest()
        self.notes: list[str] = []
        self.made = 0
        # The latest alone, for their messages; a check for leaks makes thousands.
        self.instances: deque[Instance] = deque(maxlen=_LAST)
        self._tape = Tape(job.tape)

    @cached_property
    def binary(self) -> Path:
        """The shared library for this platform."""
        if self.description.identifier is None:
            raise NotApplicable("no FMU for co-simulation: there is no <CoSimulation>")
        return _existing(binary_path(self.directory, self.description))

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
            raise Violated(f"the shared library cannot be loaded: {error}") from None

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
        """Whether there can be no second instance next to the first."""
        one = self.description.flag("canBeInstantiatedOnlyOncePerProcess")
        return one or bool(self.job.able.beside)

    def require_flag(self, name: str, *, exchange: bool = False) -> None:
        """Raise NotApplicable where a capability flag of co-simulation, or of model exchange, is
        false."""
        flags = self.description.exchange_flag if exchange else self.description.flag
        require(flags(name), f"{name} is false")

    @property
    def uri(self) -> str:
        """URI of the resources directory."""
        return (self.directory / "resources").as_uri()

    def fresh(
        self,
        name: str = "tested",
        *,
        guid: str | None = None,
        uri: str | None = None,
        logging: bool = True,
        memory: bool = True,
        library: Library | None = None,
        kind: int = CO_SIMULATION,
        refusable: bool = False,
    ) -> Instance:
        """A new instance, in state "instantiated".

        Parameters
        ----------
        refusable : bool
            Whether the FMU may refuse; the instance has no component then.

        Raises
        ------
        NotEvaluated
            The FMU is known to bear no second instance in a process.
        Violated
            fmi2Instantiate returned a null pointer.
        """
        if self.made and self.job.able.again and self.job.rule != "FMI2-INST-04":
            raise NotEvaluated(self.job.able.again)
        instance = Instance(
            library or self.library,
            name=name,
            guid=self.description.guid if guid is None else guid,
            uri=self.uri if uri is None else uri,
            logging=logging,
            memory=memory,
            kind=kind,
        )
        self.made += 1
        self.instances.append(instance)
        if instance.component is None and not refusable:
            said = "; ".join(m.shown for m in instance.messages) or "and logged nothing"
            raise Violated(f"fmi2Instantiate returned a null pointer: {said}")
        return instance

    def said(self) -> list[str]:
        """The last messages that the instances logged, variables by name."""
        names = {f"{v.base[:1].lower()}{v.reference}": v.name for v in self.description.variables}

        def named(found: re.Match[str]) -> str:
            return "#" if found[0] == "##" else names.get(found[1], found[0])

        shown = [message.shown for instance in self.instances for message in instance.messages]
        return [re.sub(r"##|#([ribs]\d+)#", named, text).strip() for text in shown[-_LAST:]]

    def initialize(
        self,
        instance: Instance,
        phase: float = 0.0,
        description: Description | None = None,
        *,
        setup: bool = True,
        what: str = "",
    ) -> Instance:
        """Bring an instance from "instantiated" to the first communication point.

        Parameters
        ----------
        description : Description, optional
            In place of the FMU's own, where some inputs are to rest.
        setup : bool
            False: fmi2SetupExperiment has been called.
        what : str
            Said of a call that fails.
        """
        self.begin(instance, phase, description, setup=setup, what=what)
        demand(instance.leave(), f"fmi2ExitInitializationMode{what}")
        return instance

    def begin(
        self,
        instance: Instance,
        phase: float = 0.0,
        description: Description | None = None,
        *,
        setup: bool = True,
        what: str = "",
    ) -> Instance:
        """Bring an instance from "instantiated" into Initialization Mode, inputs excited."""
        if setup:
            demand(instance.setup(self.grid.start), f"fmi2SetupExperiment{what}")
        demand(instance.enter(), f"fmi2EnterInitializationMode{what}")
        excite(instance, description or self.description, 0, phase)
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
        grid: Grid | None = None,
    ) -> Trajectory:
        """Simulate an instance that stands at communication point `first` up to `last`.

        Parameters
        ----------
        quiet : bool
            Do not read anything before the end.
        grid : Grid, optional
            In place of that of the bench.

        Raises
        ------
        Violated
            A call was refused.
        """
        grid = grid or self.grid
        end = grid.steps if last is None else last
        rows = [] if quiet else [observe(instance, self.description)]
        for point in range(first, end):
            excite(instance, self.description, point, phase)
            time = grid.time(point)
            demand(
                instance.step(time, grid.time(point + 1) - time),
                f"fmi2DoStep at t = {time:.9g}, h = {grid.step:.9g}",
            )
            if not quiet or point + 1 == end:
                rows.append(observe(instance, self.description))
        names = (v.name for _, group in by_base(self.description.variables) for v in group)
        return Trajectory(tuple(names), tuple(rows))

    @cached_property
    def reference(self) -> Trajectory:
        """What a fresh instance does, left alone."""
        if self.job.able.reference:
            return from_text(Path(self.job.able.reference).read_text(encoding="utf-8"))
        return self.alone()

    def alone(self, phase: float = 0.0) -> Trajectory:
        """Instantiate, initialize, simulate, terminate and free one instance."""
        instance = self.ready(phase=phase)
        trajectory = self.run(instance, phase=phase)
        demand(instance.terminate(), "fmi2Terminate")
        instance.free()
        return trajectory

    def compare(self, found: Trajectory, what: str) -> Iterator[str]:
        """A line if a run differs from the reference.

        Raises
        ------
        NotEvaluated
            The FMU does not even repeat itself.
        """
        if not self.job.able.repeats and self.job.rule != "FMI2-STEP-07":
            raise NotEvaluated("two equal runs differ, see FMI2-STEP-07")
        difference = first_difference(found, self.reference.after(-len(found.rows)))
        if difference is not None:
            yield f"{what}: {difference}"

    @contextmanager
    def held(self, name: str = "tested") -> Iterator[Instance]:
        """A new instance at the first communication point, freed at the end."""
        instance = self.ready(name)
        yield instance
        instance.free()

    @cached_property
    def exchange_library(self) -> Library:
        """The shared library for model exchange, as a rule that for co-simulation."""
        identifier = self.description.identifiers.get("ModelExchange")
        if identifier is None:
            raise NotApplicable("no FMU for model exchange: there is no <ModelExchange>")
        if identifier == self.description.identifier:
            return self.library
        return Library(_existing(self.binary.with_stem(identifier)), self._tape)

    def elsewhere(self, task: str, *, directory: Path | None = None, argument: str = "") -> str:
        """Do a task of `congelation.conformance.child_main` in another process.

        Raises
        ------
        Violated
            The other process failed; the text holds the end of its output.
        """
        scratch = Path(self.job.scratch) / f"elsewhere-{task}"
        scratch.mkdir(exist_ok=True)
        job = Job(
            directory=str(directory or self.directory),
            companion=self.job.companion,
            scratch=str(scratch),
            task=task,
            argument=argument,
            able=replace(self.job.able, again="", beside="", reference=""),
        )
        done = subprocess.run(
            [sys.executable, "-m", "congelation.conformance.child_main", str(job.saved())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
        )
        report = json.loads(job.result.read_text(encoding="utf-8")) if job.result.exists() else {}
        if done.returncode != 0 or "text" not in report:
            where = Tape.read(job.tape)
            why = report.get("error") or f"it ended with {done.returncode} in {where or 'the task'}"
            raise Violated(f"another process failed: {why}")
        return str(report["text"])


def _existing(binary: Path) -> Path:
    """The path, or NotApplicable if there is no such file."""
    where = f"{binary.parent.name}/{binary.name}"
    require(binary.is_file(), f"no binary for this platform ({where})")
    return binary


def to_text(trajectory: Trajectory) -> str:
    """A trajectory as JSON that keeps every bit (floats in hexadecimal)."""

    def cell(value: Value) -> object:
        return {"hex": value.hex()} if isinstance(value, float) else value

    rows = [[cell(value) for value in row] for row in trajectory.rows]
    return json.dumps({"names": trajectory.names, "rows": rows})


def from_text(text: str) -> Trajectory:
    """The inverse of `to_text`."""

    def value(cell: object) -> Value:
        if isinstance(cell, dict):
            return float.fromhex(cell["hex"])
        return cell  # type: ignore[return-value]  # JSON gives back what to_text put in

    data = json.loads(text)
    rows = tuple(tuple(value(cell) for cell in row) for row in data["rows"])
    return Trajectory(tuple(data["names"]), rows)
