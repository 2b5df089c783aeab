"""The process in which one dynamic rule, or one task of another rule, looks at one FMU.

Reads a `Job` from the JSON file that its command line names and leaves the result in the job's
scratch directory. Without a file it reads lines "number file" from standard input, and forks a
process for each.
Standard output and error of these belong to the FMU, which may print what it likes.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from congelation.conformance.bench import Bench, to_text
from congelation.conformance.job import Ability, Job
from congelation.conformance.rule import BY_ID, DynamicRule, NotApplicable, Violated, judge
from congelation.conformance.trajectory import demand, first_difference

__all__ = ["main"]

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Do the job in the file that the command line, or a line of standard input, names."""
    parent = os.getpid() if not sys.argv[1:] else os.getppid()
    path = sys.argv[1] if sys.argv[1:] else _forked()
    if sys.platform == "linux":
        # An FMU that hangs must not outlive the check, however that ends.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it has ended already
            os._exit(1)
    data = json.loads(Path(path).read_text(encoding="utf-8"))
    job = Job(**{**data, "able": Ability(**data["able"])})
    if not sys.argv[1:]:
        nothing = os.open(os.devnull, os.O_RDWR)
        words = os.open(job.words, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number, descriptor in enumerate((nothing, nothing, words)):
            os.dup2(descriptor, number)
        # Temporary files go away with the scratch.
        os.environ |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), job.scratch)
    os.chdir(job.scratch)
    bench = Bench(job)
    if job.task:
        _leave(job.result, _done(bench))
        os._exit(0)
    import_module(job.module)  # which registers the rule
    rule = BY_ID[job.rule]
    if not isinstance(rule, DynamicRule):
        raise TypeError(f"{rule.id} looks at no process")
    _leave(job.result, _judged(rule, bench))
    if not rule.ends_normally:
        # How the process would end is the business of the rules that say so.
        sys.stdout.flush()
        os._exit(0)


def _forked() -> str:
    """Fork for each line of standard input, until there are no more.

    Writes "begun number pid" and "ended number code" to standard output. Returns, in each process
    forked, the file of its job.
    """
    woken, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.set_wakeup_fd(wakes)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    numbers: dict[int, str] = {}
    rest = b""
    while True:
        ready, _, _ = select.select([0, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            while numbers and (found := os.waitpid(-1, os.WNOHANG))[0]:
                pid, status = found
                print("ended", numbers.pop(pid), os.waitstatus_to_exitcode(status), flush=True)
        if 0 not in ready:
            continue
        data = os.read(0, 65536)
        if not data:
            sys.exit()
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            number, _, path = line.decode().partition(" ")
            pid = os.fork()
            os.setpgid(pid, pid)  # in both, as either may be first; it is killed with all its own
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                os.close(woken)
                os.close(wakes)
                return path
            numbers[pid] = number
            print("begun", number, pid, flush=True)


def _judged(rule: DynamicRule, bench: Bench) -> dict[str, object]:
    """What a rule leaves (`congelation.conformance.finding.verdict_of`)."""
    outcome, breaches, reason, cause = judge(rule, bench)
    return {
        "outcome": outcome.name,
        "breaches": [[breach.what, breach.line, breach.file] for breach in breaches],
        "reason": reason,
        "cause": cause,
        "notes": bench.notes,
        "log": bench.said() if breaches else [],
    }


def _done(bench: Bench) -> dict[str, object]:
    """What a task leaves: its text, or why it failed."""
    try:
        return {"text": TASKS[bench.job.task](bench)}
    except (Violated, NotApplicable) as error:
        return {"error": str(error), "log": bench.said()}


def _load(bench: Bench) -> str:
    """Load the library."""
    return bench.library.path.name


def _alone(bench: Bench) -> str:
    """Run the FMU with nothing else in the process."""
    return to_text(bench.alone())


def _again(bench: Bench) -> str:
    """Run one instance after another; where they differ, "" if nowhere."""
    first = bench.alone()
    return first_difference(bench.alone(), first) or ""


def _beside(bench: Bench) -> str:
    """Make two instances."""
    for name in ("first", "second"):
        bench.fresh(name)
    return ""


def _survey(bench: Bench) -> str:
    """Do all that the survey asks for in one process: a run, another one, two instances."""
    first = bench.alone()
    difference = first_difference(bench.alone(), first)
    _beside(bench)
    return json.dumps({"run": to_text(first), "difference": difference})


def _replay(bench: Bench) -> str:
    """Continue from a serialized state; the argument is "point:hexadecimal bytes"."""
    point, data = bench.job.argument.split(":")
    instance = bench.fresh()
    status, state = instance.deserialize(bytes.fromhex(data))
    demand(status, "fmi2DeSerializeFMUstate in another process")
    demand(instance.set_state(state), "fmi2SetFMUstate in another process")
    return to_text(bench.run(instance, first=int(point)))


TASKS: Mapping[str, Callable[[Bench], str]] = {
    "load": _load,
    "alone": _alone,
    "again": _again,
    "beside": _beside,
    "replay": _replay,
    "survey": _survey,
}


def _leave(path: Path, report: Mapping[str, object]) -> None:
    """Write a result so that a reader finds all of it or nothing."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(report), encoding="utf-8")
    part.replace(path)


if __name__ == "__main__":
    main()
