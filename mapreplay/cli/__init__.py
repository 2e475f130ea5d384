"""The command line: one thin module per verb; no other package imports it.

Verbs import slow libraries (torch, rerun, polars, numba) only when they run, so that help and
completion are quick.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final

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
from mapreplay.cli.output import say
from mapreplay.cli.recover import recover
from mapreplay.cli.run import RunCommand, run
from mapreplay.cli.streams import standard_streams
from mapreplay.cli.train import train
from mapreplay.cli.verify import verify
from mapreplay.cli.view import view
from mapreplay.cli.whatif import whatif
from mapreplay.errors import MapreplayError
from mapreplay.text import one_line, printable

FAILED: Final = 1
INTERRUPTED: Final = 130
DEBUG: Final = "MAPREPLAY_DEBUG"
"""Environment variable: if it is set, unexpected errors are shown with their traceback."""

_FORMER_NAMES: Final = {"output": "out"}
"""Former names of options, which still work."""

app = typer.Typer(
    name="mapreplay",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
        "token_normalize_func": lambda name: _FORMER_NAMES.get(name, name),
    },
)


def _version(wanted: bool) -> None:  # noqa: FBT001 (typer's callback)
    if wanted:
        from importlib.metadata import version

        say(f"mapreplay {version('mapreplay')}")
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
        say(context.get_help())


app.command(cls=RunCommand)(run)
for _verb in (
    view, ls, info, metrics, compare, diagnose, diff, branch, whatif, bundle, recover,
    export, floorplans, train, verify, experiment,
):  # fmt: skip
    app.command()(_verb)
app.add_typer(bench_app, name="bench")


def main() -> None:
    """Entry point: every error is one line on stderr and an exit code."""
    with standard_streams():
        try:
            code = _run()
        except KeyboardInterrupt:
            # Ctrl-C can arrive twice, from Polars and from Python; handle it once.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            print("mapreplay: interrupted", file=sys.stderr)
            with suppress(MapreplayError, OSError):
                sys.stdout.flush()
            # Not sys.exit: where the interrupt passed through an exec of ours or a library's,
            # Python remembers it as unhandled, and ends by killing itself instead of our code.
            os._exit(INTERRUPTED)
    sys.exit(code)


def _run() -> int:
    """Run the command line; returns the exit code."""
    # Other libraries complain on stderr, for example about missing cache folders.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        code = app(prog_name="mapreplay", standalone_mode=False)
        sys.stdout.flush()
    except MapreplayError as error:
        return _fail(str(error), error.exit_code)
    except typer.TyperException as error:  # wrong usage
        context = getattr(error, "ctx", None)
        verb = context.command_path if context else "mapreplay"
        return _fail(f"{error.format_message()} See `{verb} --help`.", error.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        return FAILED  # the reader of our output has ended
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of a library in Rust is no Exception
        if os.environ.get(DEBUG):
            raise
        return _fail(_unexpected(error), FAILED)
    if code == INTERRUPTED:  # what typer makes of Ctrl-C
        raise KeyboardInterrupt
    return code if isinstance(code, int) else 0


def _unexpected(error: BaseException) -> str:
    """The message for an unexpected error."""
    if isinstance(error, MemoryError):
        return "out of memory; free memory, or process less at a time"
    if isinstance(error, FileNotFoundError) and not _is_folder_there():
        return "the current folder no longer exists; change to another one"
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return (
        f"internal error, {type(error).__name__}: {one_line(error)}; please report it with "
        f"the output of the same command with {DEBUG}=1 set"
    )


def _is_folder_there() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return False
    return True


def _fail(line: str, code: int) -> int:
    print(f"mapreplay: {printable(line)}", file=sys.stderr)
    return code
