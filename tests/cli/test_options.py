"""The options of `run` are the fields of its model, and no others are written down."""

from pathlib import Path
from typing import Annotated

import pytest
import typer
from pydantic import BaseModel, Field
from typer.testing import CliRunner

from commands import Run
from mapreplay.cli.options import command_of
from mapreplay.config import MapKind, RunConfig


class Base(BaseModel):
    count: int = Field(default=3, description="How many.")
    where: tuple[int, int] | None = Field(default=None, description="A cell.")
    area: MapKind = MapKind.FUSED


class Model(Base):
    whole_thing: Annotated[bool, Field(strict=True)] = Field(default=False, description="All.")
    out: Path | None = None


app = typer.Typer(rich_markup_mode=None)


@app.command(cls=command_of(lambda: Model))
def verb(context: typer.Context, extra: int = 1) -> None:
    """A verb."""
    typer.echo(f"{context.obj} {extra}")


def test_a_field_is_an_option_with_its_help_and_default() -> None:
    shown = " ".join(CliRunner().invoke(app, ["--help"]).output.split())
    for words in (
        "--whole-thing / --no-whole-thing All. [default: no-whole-thing] -o, --out <path>",
        "--count <int> How many. [default: 3] --where ROW,COL A cell.",
        "--area <observed|fused> [default: fused] --extra <int> [default: 1]",
    ):
        assert words in shown


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ([], {}),
        (["--count", "3"], {"count": 3}),
        (["--where", "4,5"], {"where": (4, 5)}),
        (["--no-whole-thing", "-o", "a"], {"whole_thing": False, "out": Path("a")}),
    ],
)
def test_only_what_was_given_is_passed_on(words: list[str], given: dict[str, object]) -> None:
    assert CliRunner().invoke(app, words).output == f"{given} 1\n"


def test_the_values_of_an_option_are_completed() -> None:
    asked = {"_ROOT_COMPLETE": "complete_bash", "COMP_WORDS": "root --area ob", "COMP_CWORD": "2"}
    assert CliRunner().invoke(app, [], env=asked, prog_name="root").output == "observed\n"


def test_every_field_of_the_model_is_an_option_of_run_with_a_help_text(cli: Run) -> None:
    shown = cli("run", "--help").out
    for name, field in RunConfig.model_fields.items():
        assert f"--{name.replace('_', '-')} " in shown
        assert field.description


@pytest.mark.parametrize("words", ["--seed -1", "--coverage 0", "--jobs 0", "--rays 9"])
def test_limits_are_those_of_the_model(cli: Run, words: str) -> None:
    result = cli("run", *words.split())
    assert result.code == 2
    assert f"run: {words.split(maxsplit=1)[0].strip('-')} = " in result.err
