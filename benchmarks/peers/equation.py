"""The loop of a figure as one differential equation in C, and compiled solvers on it."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt

from benchmarks.cases import Figure
from congelation.cosim.compiled.model_exchange import method_arrays
from congelation.cosim.compiled.structures import Integrator
from congelation.verify.reference import reference

__all__ = ["ABSOLUTE", "Equation"]

Floats = npt.NDArray[np.float64]

HERE = Path(__file__).absolute().parent
LOOP = HERE.parents[1] / "congelation" / "cosim" / "loop"
LSODA = "numbalsoda==0.3.4"
"""Its sources hold a port of LSODA to C++, which is compiled here; the package is not installed."""
CVODE = "scikit-sundae==1.2.0"
"""Its wheel holds SUNDIALS 7.9 as shared libraries, which are linked here; it is not installed."""

THETAS, SINES = 4, 8
POINTS = 8
"""Rows in each segment, of solvers that interpolate."""
ABSOLUTE = 1e-3
"""Absolute tolerance over the relative one, as inside the FMUs."""
AGREEMENT = 1e-9
"""Relative difference to the theory's own right-hand side that counts as an error in this file."""
MOST_ROWS = 200_000


class _Segment(ctypes.Structure):
    _fields_ = [
        ("start", ctypes.c_double),
        ("end", ctypes.c_double),
        ("held", ctypes.c_double * THETAS),
        ("sines", ctypes.c_double * 3 * SINES * THETAS),
        ("counts", ctypes.c_int * THETAS),
    ]


class Equation:
    """A figure's loop in C.

    Parameters
    ----------
    figure : Figure
        Its FMUs are native ones.
    folder : Path
        For what is compiled and fetched.
    peers : sequence of str
        Solvers of others that are fetched.

    Attributes
    ----------
    methods : tuple of str
        The solvers that there are.
    missing : tuple of str
        Why others are not there.
    """

    def __init__(
        self, figure: Figure, folder: Path, peers: Sequence[str] = ("LSODA", "CVODE")
    ) -> None:
        self._peers = peers
        self._reference = found = reference(figure.case)
        self.start = found.start
        loop = found.loop
        names = [*loop.state_names, *loop.output_names]
        self._columns = [names.index(f"{owner}.{name}") for owner, name in figure.loop.record]
        self.missing: tuple[str, ...] = ()
        self._library = self._compiled(figure, folder)
        self._segments = (_Segment * len(found.segments))(
            *(_segment(s, figure.stop_time) for s in found.segments if s.start < figure.stop_time)
        )
        self._count = sum(s.start < figure.stop_time for s in found.segments)
        n_plant = sum(len(state.variables.names) for state in loop.plant.states)
        self._library.sizes(n_plant, len(self.start), len(found.segments[0].theta(0.0)))
        self._rows = np.empty((MOST_ROWS, 1 + len(self.start)))
        self._check()
        self._prepare()
        self.methods = (
            "DOP853",
            *(["LSODA"] if hasattr(self._library, "run_lsoda") else []),
            *(["CVODE, Adams", "CVODE, BDF"] if hasattr(self._library, "run_cvode") else []),
        )

    def _compiled(self, figure: Figure, folder: Path) -> Any:
        work = folder / figure.loop.name
        work.mkdir(parents=True, exist_ok=True)
        objects: list[str] = []
        flags = ["-O3", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-flto"]
        headers = Path(fmpy.__file__).parent / "c-code"
        for component in figure.loop.components:
            sources = work / component.name
            with zipfile.ZipFile(component.fmu) as archive:
                for name in archive.namelist():
                    if name.startswith("sources/"):
                        archive.extract(name, sources)
            files = [HERE / "equations.c", *sorted((sources / "sources").glob("*.c"))]
            for file in files:
                target = str(work / f"{component.name}_{file.stem}.o")
                _call(
                    *("gcc", *flags, f"-DFMI2_FUNCTION_PREFIX={component.name}_"),
                    *(f"-I{sources / 'sources'}", f"-I{headers}", "-c", str(file), "-o", target),
                )
                objects.append(target)
        extra: list[str] = []
        defines: list[str] = []
        for name in self._peers:
            try:
                extra += {"LSODA": _lsoda, "CVODE": _cvode}[name](folder)
                defines.append(f"-D{name}")
            except (OSError, subprocess.SubprocessError, StopIteration) as error:
                self.missing += (f"{name}: {error}",)
        library = work / "solvers.so"
        solvers = str(work / "solvers.o")
        _call(
            *("gcc", "-std=c99", *flags, *defines, f"-I{LOOP}"),
            *("-c", str(HERE / "solvers.c"), "-o", solvers),
        )
        _call("g++", *flags, "-shared", solvers, *objects, *extra, "-lm", "-o", str(library))
        found = ctypes.CDLL(str(library))
        for component in figure.case.system.components:
            getattr(found, f"{component.name}_restart")()
            for name, value in component.start.items():
                if not isinstance(value, str):
                    getattr(found, f"{component.name}_assign")(
                        name.encode(), ctypes.c_double(float(value))
                    )
            if not getattr(found, f"{component.name}_close")():
                raise RuntimeError(f"{component.name}: the gains cannot be computed")
        found.run_inlined.restype = ctypes.c_long
        found.evaluation_count.restype = ctypes.c_long
        for name in ("run_lsoda", "run_cvode"):
            if hasattr(found, name):
                getattr(found, name).restype = ctypes.c_long
        return found

    def _check(self) -> None:
        theta = self._reference.segments[0].theta
        t, f = 0.3, np.zeros(len(self.start))
        X = np.ascontiguousarray(self.start + 0.01)
        exact = self._reference.loop.function(X, theta(t))
        self._library.evaluated(
            ctypes.byref(self._segments[0]), ctypes.c_double(t), *_pointers(X, f)
        )
        if not np.abs(f - exact).max() <= AGREEMENT * np.abs(exact).max():
            raise RuntimeError("the FMUs' equations are not those of the theory")

    def _prepare(self) -> None:
        n = len(self.start)
        self._kept = {**method_arrays(n), "nominal": np.ones(n)}
        self._integrator = Integrator(n=n)
        for name, table in self._kept.items():
            setattr(self._integrator, name, table.ctypes.data)

    def run(self, method: str, rtol: float) -> int:
        """Solve the whole figure; the number of rows.

        Raises
        ------
        RuntimeError
            The solver gave up.
        """
        library, count = self._library, ctypes.c_int(self._count)
        rows = ctypes.c_void_p(self._rows.ctypes.data)
        tolerances = ctypes.c_double(rtol), ctypes.c_double(ABSOLUTE * rtol)
        if method == "DOP853":
            self._kept["x"][:] = self.start
            self._integrator.tolerance = rtol
            found = library.run_inlined(ctypes.byref(self._integrator), self._segments, count, rows)
        else:
            X = self.start.copy()
            given = (*_pointers(X), self._segments, count, ctypes.c_int(POINTS), *tolerances, rows)
            if method == "LSODA":
                found = library.run_lsoda(*given)
            else:
                kind = ctypes.c_int(1 if method.endswith("Adams") else 2)
                found = library.run_cvode(kind, *given)
        if found < 0:
            raise RuntimeError(f"{method} gave up at {rtol:g}")
        return int(found)

    def evaluations(self) -> int:
        """Of the right-hand side, since the last call."""
        return int(self._library.evaluation_count())

    def rows(self, count: int) -> Floats:
        """Time and what the figure records, of the last run, shape (count, 1 + M)."""
        loop, segments = self._reference.loop, self._reference.segments
        starts = [segment.start for segment in segments]
        rows = []
        for t, *X in self._rows[:count].tolist():
            segment = segments[max(int(np.searchsorted(starts, t, side="left")) - 1, 0)]
            state = np.array(X)
            values = [*X, *loop.output_function(state, segment.theta(t))]
            rows.append([t, *(values[k] for k in self._columns)])
        return np.array(rows)


def _pointers(*arrays: Floats) -> tuple[ctypes.c_void_p, ...]:
    return tuple(ctypes.c_void_p(array.ctypes.data) for array in arrays)


def _segment(segment: Any, stop: float) -> _Segment:
    """A segment whose theta is that of verify.reference: held values, and sines."""
    found = _Segment(start=segment.start, end=min(segment.end, stop))
    pieces, offsets, *_ = segment.theta.args
    for j, (piece, offset) in enumerate(zip(pieces, offsets, strict=True)):
        if piece.slope or piece.chirps:
            raise RuntimeError("theta(t) has other terms than constants, sines and squares")
        found.held[j] = piece.held + offset
        found.counts[j] = len(piece.smooth)
        for k, sine in enumerate(piece.smooth):
            found.sines[j][k][:] = sine
    return found


def _call(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, timeout=120.0)


def _fetched(package: str, folder: Path, *options: str) -> Path:
    """The one file that pip downloads for a package."""
    target = folder / re.sub(r"\W+", "_", package)
    if not target.is_dir() or not any(target.iterdir()):
        pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "download")
        _call(*pip, "--no-deps", *options, "--dest", str(target), package)
    return next(file for file in target.iterdir() if file.is_file())


def _lsoda(folder: Path) -> Sequence[str]:
    archive = _fetched(LSODA, folder, "--no-binary", "numbalsoda")
    with tarfile.open(archive) as sources:
        sources.extractall(folder / "lsoda", filter="data")
    objects = []
    for name in ("LSODA", "wrapper"):
        file = next((folder / "lsoda").glob(f"*/src/{name}.cpp"))
        objects.append(str(folder / f"{name}.o"))
        _call("g++", "-O3", "-fPIC", "-c", str(file), "-o", objects[-1])
    return objects


def _cvode(folder: Path) -> Sequence[str]:
    archive = _fetched(CVODE, folder, "--only-binary", ":all:")
    with zipfile.ZipFile(archive) as wheel:
        wheel.extractall(folder / "cvode")
    libraries = folder / "cvode" / "scikit_sundae.libs"
    parts = ("core", "nvecserial", "cvode", "sunmatrixdense", "sunlinsoldense")
    files = [str(next(libraries.glob(f"libsundials_{part}-*"))) for part in parts]
    return [*files, f"-Wl,-rpath,{libraries}", f"-Wl,-rpath-link,{libraries}"]
