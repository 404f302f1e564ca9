"""The options that mean the same in whatever command has them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    Decorator = Callable[[Callable[..., None]], Callable[..., None]]


class PathName(click.Path):
    """A path that is not empty; whether it can be read is told by whoever reads it."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, readable=False)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path. An empty text would mean the working folder, which nobody asked for."""
        if value == "":
            self.fail("is empty; a file or a folder must have a name", param, ctx)
        return super().convert(value, param, ctx)


PATH = PathName()


def path_option(*names: str, metavar: str = "FILE", **more: Any) -> Decorator:
    """An option that takes the path of a file."""
    return click.option(*names, metavar=metavar, type=PATH, **more)


def ci_options(cases: str) -> Decorator:
    """Adds --summary and --junit, what CI shows of a result; `cases` are JUnit's test cases."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        command = path_option("--junit", help=f"The {cases} as JUnit XML.")(command)
        return path_option("--summary", help="A table in Markdown.")(command)

    return decorate


def said_options(quiet: str = "Nothing on stderr but errors.") -> Decorator:
    """Adds -q and -v, how much a command says on stderr; `quiet` is what -q leaves."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        tracebacks = "Tracebacks on stderr."
        command = click.option("-v", "--verbose", is_flag=True, help=tracebacks)(command)
        return click.option("-q", "--quiet", is_flag=True, help=quiet)(command)

    return decorate
