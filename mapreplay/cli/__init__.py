"""The command line: a module a verb, each thin; nothing imports this.

Verbs import what is slow (torch, rerun, polars, numba) only when they run, so that help and
completion are quick.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from typing import Annotated, NoReturn

import typer

from mapreplay.cli.bench import bench_app
from mapreplay.cli.branch import branch
from mapreplay.cli.bundle import bundle
from mapreplay.cli.compare import compare
from mapreplay.cli.diagnose import diagnose
from mapreplay.cli.diff import diff
from mapreplay.cli.experiment import experiment
from mapreplay.cli.export import export
from mapreplay.cli.floorplans import floorplans
from mapreplay.cli.info import info
from mapreplay.cli.ls import ls
from mapreplay.cli.metrics import metrics
from mapreplay.cli.recover import recover
from mapreplay.cli.run import run
from mapreplay.cli.train import train
from mapreplay.cli.verify import verify
from mapreplay.cli.view import view
from mapreplay.cli.whatif import whatif
from mapreplay.errors import MapreplayError

INTERRUPTED = 130

app = typer.Typer(
    name="mapreplay",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _version(wanted: bool) -> None:  # noqa: FBT001 (typer's callback)
    if wanted:
        from importlib.metadata import version

        typer.echo(f"mapreplay {version('mapreplay')}")
        raise typer.Exit


@app.callback()
def _mapreplay(
    context: typer.Context,
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Record, replay and analyse agents that map floor plans with a learned map predictor."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


for _verb in (
    run, view, ls, info, metrics, compare, diagnose, diff, branch, whatif, bundle, recover,
    export, floorplans, train, verify, experiment,
):  # fmt: skip
    app.command()(_verb)
app.add_typer(bench_app, name="bench")


def main() -> None:
    """Entry point: every error is one line on stderr and an exit code."""
    try:
        _run()
    except KeyboardInterrupt:
        # Ctrl-C can come twice: Polars raises it, and then Python does. Once is enough.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print("mapreplay: interrupted", file=sys.stderr)
        with suppress(OSError):
            sys.stdout.flush()
        # Not sys.exit: where the interrupt passed through an exec of ours or a library's, Python
        # remembers it as unhandled, and ends by killing itself instead of with our code.
        os._exit(INTERRUPTED)


def _run() -> None:
    try:
        code = app(prog_name="mapreplay", standalone_mode=False)
    except MapreplayError as error:
        _fail(str(error), error.exit_code)
    except typer.TyperException as error:  # wrong usage
        context = getattr(error, "ctx", None)
        verb = context.command_path if context else "mapreplay"
        _fail(f"{error.format_message()} See `{verb} --help`.", error.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        # Whoever read our output has seen enough; keep Python from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    if code == INTERRUPTED:  # what typer makes of Ctrl-C
        raise KeyboardInterrupt
    sys.exit(code if isinstance(code, int) else 0)


def _fail(line: str, code: int) -> NoReturn:
    print(f"mapreplay: {' '.join(line.split())}", file=sys.stderr)
    sys.exit(code)
