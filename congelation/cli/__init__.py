"""The command line: ``congelation COMMAND``; every command is a thin layer over the packages.

The exit codes are those of `congelation.cli.shared.EXIT_CODES`. What a user can set right is one
line on stderr, never a traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from congelation.cli.design import attack, tune
from congelation.cli.designs import build, certify, examples, info, new
from congelation.cli.results import export, ls, open_report, report, show
from congelation.cli.runs import export_ssp, run, sweep
from congelation.cli.schema import schema
from congelation.cli.shared import BAD_INPUT, EXIT_CODES, FAILED, complain, interruptible
from congelation.conformance.command import check
from congelation.errors import CongelationError, InvalidInput
from congelation.results.identity import code_version

__all__ = ["app", "main"]

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
for command in (
    new,
    examples,
    build,
    info,
    certify,
    attack,
    tune,
    run,
    sweep,
    report,
    ls,
    show,
    export,
    check,
    schema,
):
    app.command()(interruptible(command))
app.command("open")(interruptible(open_report))
app.command("export-ssp")(interruptible(export_ssp))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, with the arguments of the process unless others are given, and exit."""
    try:
        app(arguments if arguments is None else list(arguments))
    except InvalidInput as error:
        complain(str(error))
        sys.exit(BAD_INPUT)
    except CongelationError as error:
        complain(str(error))
        sys.exit(FAILED)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"congelation {code_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Adaptive control of linear systems with time-varying parameters, co-simulated as FMUs."""
