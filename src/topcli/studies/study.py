"""A study: a question put to experiments, declared once for the command line, Python, pages and files.

The module of a study has a function ``measure`` with a NumPy docstring, its tables, notes and faults, and the ``Study``
that names them; ``STUDIES`` of this folder lists it. Its command has an option for each parameter of ``measure`` and
takes the help from the docstring; the Python function has the same parameters; ``--json``, the chapter of a page and
the DataFrames show the same data.

The module imports what measures only within ``measure``, so that the help of the command is quick. That is in a module
of its own, whose name begins with that of the study: ``order_ladders``, ``roundoff_copies``, ``compare_runs``,
``analyse_series``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from topcli.errors import ExitCode, UsageError, shortened
from topcli.studies import STUDIES, find_study
from topcli.table import Table

if TYPE_CHECKING:
    from topcli.contracts import Array

Data = dict[str, Any]
LADDER_STEPS = 4_000_000
"""Largest number of steps of a run of the study ``order``, for its option and for the module that measures."""


@dataclass(frozen=True)
class Flag:
    """Form in which a parameter of a study is given on the command line.

    Attributes
    ----------
    option : str
        Name of the option, such as ``"--h"``; empty for a positional argument.
    metavar : str
        Word for the value in the help. SCHEME, TOP and CONFIG are completed.
    names : callable, optional
        The names that complete another value.
    read : callable, optional
        Value of the parameter from the texts or numbers of the option. Raises UsageError.
    default : str
        Words for the default in the help.
    least, most : float, optional
        Bounds of a number.
    required : bool
        The command needs at least one of several positional arguments.
    several : bool
        The option may be repeated for a parameter that is not a sequence.
    alone : bool
        The option excludes ``--json``.
    """

    option: str = ""
    metavar: str = ""
    names: Callable[[], Iterable[str]] | None = None
    read: Callable[[Any], Any] | None = None
    default: str = ""
    least: float | None = None
    most: float | None = None
    required: bool = False
    several: bool = False
    alone: bool = False


PYTHON_ONLY = Flag("-")
"""Mark of a parameter that the command does not have."""


def _whole(text: object) -> int:
    """Number of steps, also written as 1e6. Raises UsageError."""
    try:
        number = float(str(text))
        if number >= 1.0 and number == int(number):
            return int(number)
    except (ValueError, OverflowError):
        pass
    raise UsageError(f"--steps {shortened(str(text))}: must be a whole number from 1, such as 1e6")


def scheme_names(default: str) -> Flag:
    """Names of schemes as arguments; ``default`` says in words which ones are taken if none is named."""
    return Flag("", "SCHEME", default=default)


def top_flag(default: str) -> Flag:
    """The option ``--top``."""
    return Flag("--top", "TOP", default=default)


def config_flag(default: str) -> Flag:
    """The option ``--config``."""
    return Flag("--config", "CONFIG", default=default)


def steps_flag(default: str) -> Flag:
    """The option ``--steps``, a whole number that may be written as 1e6."""
    return Flag("--steps", "N", read=_whole, default=default)


Config = str | Path | Mapping[str, Any] | None
Overrides = Annotated[Sequence[str], Flag("--set", "KEY=VALUE")]


@dataclass(frozen=True)
class Result:
    """Outcome of a study.

    Attributes
    ----------
    data : dict
        Everything that was measured, plain and ready for JSON.
    arrays : mapping of str to ndarray
        Columns that a picture needs and ``data`` does not have.
    file : Path, optional
        File in the folder of results that keeps this result; that of the default options only.
    of : object, optional
        What was measured, for texts and attributes that need more than the data.
    """

    data: Data
    arrays: Mapping[str, Array] = field(default_factory=dict)
    file: Path | None = None
    of: Any = None


class Head(NamedTuple):
    """Head of the chapter on a result: its title, what it is about, and its outcome in a word, which is good or not."""

    title: str
    subtitle: str = ""
    state: str = "measured"
    good: bool = True
    message: str = ""


class Faults(NamedTuple):
    """Messages about what went wrong, and the exit code of the command."""

    code: ExitCode = ExitCode.SUCCESS
    lines: Sequence[str] = ()


Parts = Sequence[tuple[str, str]]
"""Form of a top and name of a scheme, for each scheme that took part."""


def _no_lines(data: Data) -> Iterable[str]:
    return ()


def _no_answer(data: Data) -> str:
    return ""


def _no_faults(data: Data) -> Faults:
    return Faults()


def _no_parts(data: Data) -> Parts:
    return ()


@dataclass(frozen=True)
class Study:
    """Declaration of a study.

    Attributes
    ----------
    name : str
        Name of the command and of the Python function.
    measure : callable
        Function that takes the options, and ``watch``, and returns a ``Result``.
    head : callable
        Head of the chapter on a result.
    tables : sequence of Table, or callable
        Tables of a result; the first is ``table`` in Python.
    answer : callable
        Sentence that answers the question of the study and can be quoted: the first line on a terminal, and the
        message of the chapter; empty if there is none.
    printed : callable, optional
        Tables and texts of a ``Result`` on a terminal, with its details or not, as ``--verbose`` asks; by default the
        answer and the tables. Its keyword parameters are flags of the command.
    frames : sequence of Table
        Tables that are DataFrames only.
    notes : callable
        Sentences that explain a result.
    faults : callable
        What went wrong, and the exit code.
    figure : str
        Function ``module:function`` of a result that loads the figure.
    draws : str
        What ``--plot`` draws, in a few words; empty for a figure of pages only.
    captions : sequence of str, or callable
        A caption for each panel; without captions, pages show no picture.
    plotted : str
        Function ``module:function`` of a result and the options of ``plot`` in Python that returns a panel and its
        data; by default the first panel of the figure.
    stem : callable
        Name of the files of the figure.
    parts : callable
        Tops and schemes to cite.
    unit : str
        What the progress counts.
    file : Path, optional
        File in the folder of results that holds the result of the default options.
    known : callable
        True for data of the study that was stored without the name of the command.
    extras : mapping
        Further attributes of the Python result, each a function of the ``Result``.
    """

    name: str
    measure: Callable[..., Result]
    head: Callable[[Data], Head]
    tables: Sequence[Table] | Callable[[Data], Sequence[Table]]
    answer: Callable[[Data], str] = _no_answer
    printed: Callable[..., Iterable[Table | str]] | None = None
    frames: Sequence[Table] = ()
    notes: Callable[[Data], Iterable[str]] = _no_lines
    faults: Callable[[Data], Faults] = _no_faults
    figure: str = ""
    draws: str = "the result"
    captions: Sequence[str] | Callable[[Data], Sequence[str]] = ()
    plotted: str = ""
    stem: Callable[[Data], str] = lambda data: str(data["name"])
    parts: Callable[[Data], Parts] = _no_parts
    unit: str = "steps"
    file: Path | None = None
    known: Callable[[Data], bool] = lambda data: False
    extras: Mapping[str, Callable[[Result], Any]] = field(default_factory=dict)

    def tables_of(self, data: Data) -> Sequence[Table]:
        """Tables of a result."""
        return self.tables(data) if callable(self.tables) else self.tables

    def figure_name(self, data: Data) -> str:
        """Name of the figure of a result, without the ending of its file."""
        return f"{self.name}_{self.stem(data)}"

    def printed_of(self, result: Result, verbose: bool, **flags: Any) -> Iterable[Table | str]:
        """Tables and texts on a terminal; all details if ``verbose``."""
        if self.printed is not None:
            return self.printed(result, verbose, **flags)
        answer, tables = self.answer(result.data), self.tables_of(result.data)
        return [*([answer] if answer else []), *(table for table in tables if verbose or not table.detail)]

    def as_dict(self, result: Result) -> Data:
        """Plain data of a result, ready for JSON, with the rows of its arrays that a picture needs."""
        from topcli.runs.report import finite
        from topcli.store.envelope import thinned

        named = {"schema_version": 1, "command": self.name, **result.data}
        if not result.arrays:
            return named
        return finite({**named, "series": {name: array.tolist() for name, array in thinned(result.arrays).items()}})

    def write(self, result: Result, path: Path) -> Path:
        """Write a result for ``topcli report``, whole or not at all. Raises UsageError and RunError."""
        from topcli.store.files import write_study
        from topcli.store.provenance import environment

        return write_study(path, {**self.as_dict(result), "environment": environment()})


def stored_result(data: Data) -> Result:
    """Result from its plain data; the series may be missing, or no numbers in a damaged file."""
    import numpy as np

    series = data.get("series")
    columns = series if isinstance(series, dict) else {}
    try:
        return Result(data, {name: np.array(values, dtype=float) for name, values in columns.items()})
    except (TypeError, ValueError):
        return Result(data, {})


def study_of(data: Data) -> Study | None:
    """Study that plain data is the result of; None if it is none."""
    for study in map(find_study, STUDIES):
        if data.get("command") == study.name or study.known(data):
            return study
    return None


def study_file(folder: Path) -> Path | None:
    """File of a study in a folder of its own; None if there is none."""
    return next((path for name in STUDIES if os.path.isfile(path := folder / f"{name}.json")), None)


def cited_parts(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Top and scheme of each entry of a study, and of its reference if that is a scheme."""
    from topcli.runs.references import EXACT

    reference = data.get("reference") or {}
    names = [str(row["scheme"]).partition(":")[0] for row in data["schemes"]]
    return parts_of(data["config"], [*names, *([EXACT] if reference.get("kind") == EXACT else [])])


def parts_of(config: Mapping[str, Any], schemes: Iterable[str]) -> list[tuple[str, str]]:
    """Form of the top of a resolved config, and each of the ``schemes``."""
    from topcli.config.formulas import declared_class
    from topcli.schemes.own_tops import top_class

    form = (declared_class(config["top"]) or top_class(config["top"]["kind"], config.get("initial") or ())).form
    return [(form, name) for name in schemes]


def top_title(config: Mapping[str, Any]) -> str:
    """Title of the top of a resolved config, or its name if there is no such top."""
    from topcli.config.formulas import declared_class
    from topcli.tops import TOPS

    kind = config["top"]["kind"]
    if declared := declared_class(config["top"]):
        return declared.title
    known = [top for top in TOPS.values() if top.kind == kind]
    fits = [top for top in known if set(top.vectors) == set(config["initial"])]
    return (fits or known)[0].title if known else str(kind)
