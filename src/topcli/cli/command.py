"""Classes of all commands: typer's, with help texts free of Python types and with imports when needed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from topcli.studies import STUDIES, find_study

STUDY = "study"
"""Place of a command that follows from a study."""
_TYPE = re.compile(r" <[^>]*>$")


class Command(TyperCommand):
    """A command whose help lists arguments without types such as ``<list[str]>``."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options."""
        write = formatter.write_dl
        formatter.write_dl = lambda rows, *args, **kwargs: write(
            [(_TYPE.sub("", name), text) for name, text in rows], *args, **kwargs
        )
        super().format_options(ctx, formatter)
        formatter.write_dl = write


class Commands(MutableMapping[str, Any]):
    """Commands by name, given as ``module.function`` or ``module.group`` and imported when they are first needed.

    A command imports its own module only; the help, a completion and an unknown name import what they list.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._commands: dict[str, Any] = dict(places)

    def __getitem__(self, name: str) -> Any:
        found = self._commands[name]
        if isinstance(found, str):
            found = self._commands[name] = _imported(name, found)
        return found

    def __setitem__(self, name: str, command: Any) -> None:
        self._commands[name] = command

    def __delitem__(self, name: str) -> None:
        del self._commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._commands)

    def __len__(self) -> int:
        return len(self._commands)


class StudyCommand(TyperCommand):
    """Command of a study that is imported when it is used; its place in the help of all commands needs no import."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the command itself."""
        from topcli.cli.study import command

        name = str(self.name)
        return _typer_command(command(find_study(name)), name).make_context(info_name, args, parent, **extra)


def _imported(name: str, place: str) -> Any:
    """The command called ``name``, from ``module.function`` or ``module.group`` in this package, or that of a study."""
    if place == STUDY:
        return StudyCommand(name=name, callback=None, help=STUDIES[name].help)
    module, attribute = place.split(".")
    return _typer_command(getattr(import_module(f"topcli.cli.{module}"), attribute), name)


def _typer_command(found: Any, name: str) -> Any:
    """Command of typer from a function or a group of commands."""
    if not isinstance(found, typer.Typer):
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name, cls=Command)(found)
        found = single
    command = get_command(found)
    command.name = name
    return command


class LazyGroup(TyperGroup):
    """Base of a group whose ``places`` name its commands and where they are."""

    places: Mapping[str, str] = {}

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Commands(self.places)
