"""The command line: ``congelation COMMAND``; every command is a thin layer over the packages.

Exit codes: 0 done; 1 a run failed or a check did not hold; 2 the input or the usage is wrong;
130 interrupted. What a user can set right is one line on stderr, never a traceback.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from congelation.cli.designs import certify
from congelation.cli.results import export, ls, report, show
from congelation.cli.runs import export_ssp, run, sweep
from congelation.cli.shared import BAD_INPUT, FAILED, complain
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
)
for command in (run, sweep, report, ls, show, export, certify, check):
    app.command()(command)
app.command("export-ssp")(export_ssp)


def main() -> None:
    """Run the command line and exit."""
    try:
        app()
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
