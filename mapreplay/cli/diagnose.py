"""`mapreplay diagnose`: why was the agent sealed in?"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.logs import PathsArgument, WhereOption, read_episodes
from mapreplay.cli.output import (
    LOST,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
    note,
    say,
)
from mapreplay.errors import LogError, MapreplayError, UsageError
from mapreplay.files.whole import write_whole
from mapreplay.text import printable, shell_command

if TYPE_CHECKING:
    from mapreplay.analysis.diagnosis.diagnosis import Diagnosis
    from mapreplay.analysis.diagnosis.reliability import Reliability

FEW = 10
"""Maximum number of logs that are reported in a paragraph each, not only in tables."""
WIDTH = 80


def diagnose(
    paths: PathsArgument,
    where: WhereOption = None,
    html: Annotated[
        Path | None, typer.Option(help="Write an HTML report with maps and probability histories.")
    ] = None,
    save: Annotated[
        bool,
        typer.Option("--save/--no-save", help="Save each diagnosis as JSON next to its log."),
    ] = True,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Explain why agents were sealed in by their own predicted map.

    Reports the blocking cells, the step and evidence of their prediction, and what would have
    helped; also near misses, detours and wrong coverage. One log gives a paragraph, many give
    tables.
    """
    check_outputs(output, html, force=force)
    form = _form(form, output)
    from mapreplay.analysis.diagnosis.corpus import pooled_reliability
    from mapreplay.analysis.diagnosis.sealing_table import sealing_table

    diagnoses, lost = _diagnose(paths, where)
    if not diagnoses:
        note("no log to diagnose")
        return
    found = list(diagnoses.values())
    if save:
        _save(diagnoses)
    if html is not None:
        from mapreplay.analysis.diagnosis.page import diagnosis_page

        page = diagnosis_page([(Path(file), d) for file, d in diagnoses.items()])
        write_whole(html, page.encode(), force=force)
        note(f"written: {html}")
    if form in (Format.CSV, Format.PARQUET):
        emit(
            sealing_table(list(map(printable, diagnoses)), found),
            "mapreplay.sealings/2",
            form,
            output,
            force=force,
        )
    elif form is Format.JSON:
        _emit_json(diagnoses, output, force=force)
    else:
        reliability = pooled_reliability(found)
        if len(diagnoses) <= FEW:
            say("\n\n".join(_told(file, d, reliability) for file, d in diagnoses.items()))
        if len(diagnoses) > 1:
            _print_tables(found)
        if len(diagnoses) > FEW:
            note("for the paragraph on one log: mapreplay diagnose LOG")
    if lost:
        raise typer.Exit(LOST)


def _form(form: Format, output: Path | None) -> Format:
    """The output format; text goes to stdout only."""
    if output is None:
        return form
    known = {".json": Format.JSON, ".csv": Format.CSV, ".parquet": Format.PARQUET}
    if form is Format.TABLE:
        if output.suffix not in known:
            raise UsageError(
                f"-o {output}: should end in {' or '.join(known)}; for a report use --html"
            )
        return known[output.suffix]
    return form


def _diagnose(paths: list[Path], where: list[str] | None) -> tuple[dict[str, Diagnosis], int]:
    """The diagnoses by file, and the number of unreadable or incomplete logs."""
    from mapreplay.analysis.diagnosis.diagnosis import diagnose as diagnose_log
    from mapreplay.cli.progress import progress_bar
    from mapreplay.recorders.log.blame import blaming
    from mapreplay.recorders.log.reader import EpisodeLog

    episodes, lost = read_episodes(paths, where)
    diagnoses: dict[str, Diagnosis] = {}
    problems = []
    with progress_bar() as bar:
        task = bar.add_task("logs", total=len(episodes))
        for episode in episodes:
            try:
                with blaming(episode.path):
                    diagnoses[str(episode.path)] = diagnose_log(EpisodeLog(episode.path))
            except MapreplayError as error:
                problems.append(str(error))
            bar.advance(task)
    if problems and not diagnoses:
        raise LogError(problems[0])
    for problem in problems:
        note(f"not diagnosed: {problem}")
    return diagnoses, lost + len(problems)


def _save(diagnoses: dict[str, Diagnosis]) -> None:
    """Save next to each log; a folder that is not writable is reported once."""
    from mapreplay.analysis.diagnosis.record import record_of, save_next_to

    problems = []
    for file, diagnosis in diagnoses.items():
        try:
            save_next_to(Path(file), record_of(diagnosis))
        except MapreplayError as error:
            problems.append(str(error))
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        note(f"not saved: {problems[0]}{more}")


def _emit_json(diagnoses: dict[str, Diagnosis], output: Path | None, *, force: bool) -> None:
    from mapreplay.analysis.diagnosis.corpus import corpus_record, pooled_reliability
    from mapreplay.analysis.diagnosis.record import record_of, to_json

    found = list(diagnoses.values())
    reliability = pooled_reliability(found)
    records = [
        {"file": printable(file)} | record_of(d, reliability) for file, d in diagnoses.items()
    ]
    if len(records) == 1:
        data = to_json(records[0])
    else:
        data = to_json(
            {
                "schema": "mapreplay.diagnoses/1",
                "logs": records,
                "corpus": corpus_record(found),
            }
        )
    if output is not None:
        write_whole(output, data, force=force)
    else:
        say(data.decode().removesuffix("\n"))


def _told(file: str, diagnosis: Diagnosis, reliability: Reliability) -> str:
    """The diagnosis for a terminal; a command at the end is on a line of its own, to be copied."""
    from mapreplay.analysis.diagnosis.paragraph import paragraph, what_if

    said = printable(paragraph(diagnosis, reliability))
    lines = textwrap.fill(said, WIDTH, break_long_words=False, break_on_hyphens=False)
    command = what_if(diagnosis, Path(file))
    return f"{lines}\n  What if: {shell_command(command)}" if command else lines


def _print_tables(found: list[Diagnosis]) -> None:
    from mapreplay.analysis.diagnosis.tables import all_tables

    for title, frame in all_tables(found):
        if len(frame):
            say(f"\n{title}")
            emit(frame, "", Format.TABLE)
