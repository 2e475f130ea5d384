"""Options of a verb that are derived from a pydantic model: each is defined once, as a field."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from functools import cached_property, partial
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Annotated, Any, Final, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand
from typer.main import get_command

from mapreplay.errors import UsageError

if TYPE_CHECKING:
    from pydantic import BaseModel

_SHORT: Final = {"out": ("--out", "-o")}


def command_of(load_model: Callable[[], type[BaseModel]]) -> type[TyperCommand]:
    """The class of a command that has an option for each field of a model.

    Name, type, default and help of an option are those of the field. The verb finds the options
    that were given, by field, in `typer.Context.obj`; defaults and limits are left to the model.

    Args:
        load_model: Imports the model. Called when the options are needed, so that the list of
            verbs does not wait for pydantic.
    """

    class ModelCommand(TyperCommand):
        @cached_property
        def _derived(self) -> list[Any]:
            return _parameters(load_model())

        def get_params(self, ctx: Any) -> list[Any]:
            return [*self._derived, *super().get_params(ctx)]

        def invoke(self, ctx: Any) -> Any:
            values = {option.name: ctx.params.pop(option.name) for option in self._derived}
            ctx.obj = {key: value for key, value in values.items() if _is_given(ctx, key)}
            return super().invoke(ctx)

    return ModelCommand


def _is_given(context: typer.Context, key: str) -> bool:
    source = context.get_parameter_source(key)
    return source is not None and source.name == "COMMANDLINE"


def _parameters(model: type[BaseModel]) -> list[Any]:
    """The parameters that typer makes of a function with the fields of `model` as arguments.

    The model's own fields come first, then those that it inherits.
    """

    def verb(**_: object) -> None: ...

    hints = get_type_hints(model)
    own = [name for name in model.__annotations__ if name in model.model_fields]
    arguments = []
    for name in dict.fromkeys([*own, *model.model_fields]):
        field = model.model_fields[name]
        kind, how = _as_on_the_command_line(name, hints[name])
        option = typer.Option(*_SHORT.get(name, ()), help=field.description, **how)
        arguments.append(
            Parameter(
                name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=Annotated[kind, option],
            )
        )
    verb.__signature__ = Signature(arguments)  # type: ignore[attr-defined]
    verb.__annotations__ = {argument.name: argument.annotation for argument in arguments}
    app = typer.Typer(add_completion=False)
    app.command()(verb)
    return get_command(app).params


def _as_on_the_command_line(name: str, kind: Any) -> tuple[Any, dict[str, Any]]:
    """The type that typer is given for a field, and arguments of `typer.Option`."""
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        values = [member.value for member in kind]  # checked by the model
        return str, {"metavar": f"<{'|'.join(values)}>", "autocompletion": lambda: values}
    if any(get_origin(part) is tuple for part in get_args(kind)):
        return str | None, {"metavar": "ROW,COL", "parser": partial(_cell, f"--{name}")}
    return kind, {}


def _cell(flag: str, text: str) -> tuple[int, int]:
    row, comma, col = text.partition(",")
    if not (comma and row.strip().isdecimal() and col.strip().isdecimal()):
        raise UsageError(f"{flag} {text}: expected ROW,COL, two cell numbers, like 12,40")
    return int(row), int(col)
