"""The command line: ``congelation COMMAND``; every command is a thin layer over the packages.

The exit codes are those of `congelation.cli.shared.EXIT_CODES`. What a user can set right is one
line on stderr, never a traceback.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from typing import Annotated, NoReturn, TextIO

import typer

from congelation.cli.shared import BAD_INPUT, EXIT_CODES, FAILED, UNREAD, complain, interruptible
from congelation.errors import CongelationError, InvalidInput
from congelation.results.identity import code_version

__all__ = ["app", "load", "main"]

_COMMANDS: Mapping[str, str] = {
    "new": "cli.specs",
    "examples": "cli.specs",
    "build": "cli.specs",
    "info": "cli.specs",
    "certify": "cli.specs",
    "attack": "cli.searches",
    "tune": "cli.searches",
    "run": "cli.runs",
    "sweep": "cli.runs",
    "report": "cli.results",
    "open": "cli.results",
    "ls": "cli.results",
    "show": "cli.results",
    "export": "cli.results",
    "check": "cli.check",
    "schema": "cli.schema",
    "export-ssp": "cli.runs",
}
"""The module of each command. Only that of the command which is called is imported: SciPy, CasADi
and the optimisers take a second, which a run has no use for."""


def _app(commands: Iterable[str], ready: Callable[[], None] = lambda: None) -> typer.Typer:
    """The command line with some of its commands, before which `ready` is called."""
    app = typer.Typer(
        name="congelation",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        epilog="Exit codes: "
        + "; ".join(f"{code} {meaning}" for code, meaning in EXIT_CODES.items())
        + ".",
    )
    app.callback()(_root)
    for name in commands:
        module = import_module(f"congelation.{_COMMANDS[name]}")
        app.command(name)(interruptible(getattr(module, name.replace("-", "_")), ready))
    return app


def load(words: Sequence[str]) -> None:
    """Import what the command called by `words` needs."""
    for name in _called(words):
        import_module(f"congelation.{_COMMANDS[name]}")


def _called(words: Sequence[str]) -> Iterable[str]:
    """The command that is called; all of them where none is, but for the version."""
    called = next((word for word in words if not word.startswith("-")), "")
    if called in _COMMANDS:
        return [called]
    return () if "--version" in words else _COMMANDS


def __getattr__(name: str) -> typer.Typer:
    """`app`, the command line with all commands."""
    if name != "app":
        raise AttributeError(f"module 'congelation.cli' has no attribute '{name}'")
    return _app(_COMMANDS)


def main(arguments: Sequence[str] | None = None, ready: Callable[[], None] = lambda: None) -> None:
    """Run the command line, with the arguments of the process unless others are given, and exit.

    `ready` is called when everything is imported and the words are read, before the command begins.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    # Typer has no option whose value may be left out.
    words = ["--trust=bars" if word == "--trust" else word for word in words]
    for stream in (sys.stdout, sys.stderr):
        # A title may have characters that the terminal's encoding lacks; they are escaped.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        _require_folder()
        # The shell's --out "$FOLDER" with nothing in it would be the folder that it is called from.
        for before, word in zip(["", *words], words, strict=False):
            option, sign, value = word.partition("=")
            if not word or (word.startswith("--") and sign and not value):
                where = option or before
                raise InvalidInput(
                    f"an argument is empty{' after ' + where if where else ''}; give it a value, "
                    "or leave it out"
                )
        try:
            _app(_called(words), ready)(words)
        finally:
            if sys.stdout is not None:  # closed by who started this process
                sys.stdout.flush()
    except SystemExit as ended:
        # What Typer and Rich make of a closed pipe is exit code 1, that of a failed run.
        if isinstance(ended.__context__, BrokenPipeError):
            _end_unread(sys.stdout)
        raise
    except OSError as error:
        if error.errno == errno.EPIPE:
            _end_unread(sys.stdout)
        where = "the output cannot be written" if error.filename is None else error.filename
        _end_unread(sys.stdout, f"{where}: {error.strerror}")
    except InvalidInput as error:
        complain(str(error))
        sys.exit(BAD_INPUT)
    except CongelationError as error:
        complain(str(error))
        sys.exit(FAILED)


def _require_folder() -> None:
    """Refuse to work in a folder that was removed: paths lead nowhere, no process starts there."""
    try:
        os.getcwd()
    except FileNotFoundError as error:
        raise InvalidInput("the current folder was removed; change to one that exists") from error


def _end_unread(stream: TextIO, complaint: str | None = None) -> NoReturn:
    """End where what is printed can go nowhere.

    A full disk is complained of. Where the reader has enough (``| head``), nothing is said, and the
    exit code is that with which shells report other programs, which end by SIGPIPE then.
    """
    # What is left in the buffer would be tried again, and complained of, at the end of Python.
    if isinstance(stream, io.TextIOWrapper):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if complaint is None:
        sys.exit(UNREAD)
    complain(complaint)
    sys.exit(FAILED)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"congelation {code_version()}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Adaptive control of linear systems with time-varying parameters, co-simulated as FMUs."""
