"""Plugins: Python files that ``--plugin`` names, entry points of installed packages, and the places of their errors."""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from topcli.contracts import Scheme, Top
from topcli.errors import SchemeCodeError, TopcliError, UsageError

GROUPS = ("topcli.tops", "topcli.schemes", "topcli.figures")
"""Groups of entry points in which installed packages declare plugins; each may bring anything."""
PLUGIN_FILE = "topcli_plugin_"
"""Start of the names of the modules of plugin files; a digest of the path follows."""


@dataclass(frozen=True)
class PluginFailure:
    """Plugin of an installed package that could not be imported: its name, its package, and the reason in one line."""

    name: str
    origin: str
    reason: str

    def __str__(self) -> str:
        return f"plugin {self.name!r} of {self.origin} failed: {self.reason}"


FILES: dict[Path, str] = {}
"""Plugin files that have been loaded, by absolute path, in that order, as they were named."""
FAILURES: list[PluginFailure] = []
"""Plugins of installed packages that could not be imported so far."""
SOURCES: dict[Any, dict[str, str]] = {}
"""Texts of the module of each registered function and class when it was registered, and of those that it needs."""
REGISTERED: list[str] = []
"""Names of tops, schemes, measures, figures and cases that came from outside topcli."""


def made_from(top: type[Top], scheme: Scheme) -> list[Any]:
    """Class of a top, and the functions ``build`` of a scheme and of those that it is composed of or wraps."""
    build = inspect.unwrap(scheme.build)
    cells = [cell.cell_contents for cell in getattr(build, "__closure__", None) or ()]
    bases = [made_from(top, base)[1:] for base in cells if isinstance(base, Scheme)]
    return [top, build, *(maker for makers in bases for maker in makers)]


def own_sources(top: type[Top], scheme: Scheme) -> dict[str, str]:
    """``sources_of`` a top and a scheme, as far as they are not topcli's own."""
    return sources_of(maker for maker in made_from(top, scheme) if not is_built_in(maker))


def is_built_in(value: Any) -> bool:
    """True if a function or class belongs to topcli, not to a user's file or another package."""
    return value.__module__.partition(".")[0] == "topcli"


def file_of(value: Any) -> str:
    """File of a function or class, or the name of its module if there is none."""
    module = sys.modules.get(value.__module__)
    return str(getattr(module, "__file__", None) or value.__module__)


def line_of(function: Callable[..., Any]) -> str:
    """``file:line`` of the definition of a function; its file for anything else."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else file_of(function)


def origin_of(value: Any) -> str:
    """``topcli``, the installed package, or the file of a function or class, which is noted as registered."""
    if is_built_in(value):
        return "topcli"
    file = file_of(value)
    REGISTERED.append(getattr(value, "__name__", ""))
    with suppress(SchemeCodeError):  # without a file; refused where a result is stored
        SOURCES[value] = _texts(value.__module__)
    return value.__module__.partition(".")[0] if _is_installed(file) else file


def _is_installed(file: str) -> bool:
    return not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)


def load_plugin_file(path: Path) -> None:
    """Run a Python file, which may import modules beside it, and so register what it declares.

    Raises UsageError if the file cannot be read or run, or registers nothing.
    """
    where = path.resolve()
    if where in FILES:
        return
    try:
        text = path.read_bytes()
    except (OSError, ValueError):
        raise UsageError(f"plugin {path}: no such file") from None
    if path.suffix != ".py":
        raise UsageError(f"plugin {path}: not a Python file (expected a name ending in .py)")
    module = ModuleType(PLUGIN_FILE + hashlib.sha256(str(where).encode()).hexdigest()[:12])
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    count = len(REGISTERED)
    with _modules_beside(where.parent):
        try:
            exec(compile(text, str(path), "exec"), module.__dict__)
        except Exception as error:
            reason = str(users_error(error) or reason_of(error))
            raise UsageError(reason if reason.startswith(str(path)) else f"plugin {path}: {reason}") from error
    if len(REGISTERED) == count:
        raise UsageError(
            f"plugin {path}: registers nothing; decorate a class with @topcli.top, or a function with "
            "@topcli.scheme(...) or @topcli.measure(...)"
        )
    FILES[where] = str(path)


@contextmanager
def _modules_beside(folder: Path) -> Iterator[None]:
    """Make the modules of ``folder`` importable within the block.

    They are forgotten at the end: a module of the same name beside another plugin file is another module.
    """
    names = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__init__.py")}
    names -= sys.stdlib_module_names | {"topcli"}

    def taken() -> dict[str, ModuleType]:
        """Modules of these names, which are no longer loaded."""
        modules = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in names}
        for name in modules:
            del sys.modules[name]
        return modules

    hidden = taken()
    sys.path.insert(0, str(folder))
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # bytecode misses an edit within one second
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = written
        taken()
        sys.modules.update(hidden)


@cache
def installed_plugins() -> tuple[EntryPoint, ...]:
    """Entry points of plugins, by name."""
    entries = {(entry.name, entry.value): entry for group in GROUPS for entry in entry_points(group=group)}
    return tuple(entries[key] for key in sorted(entries))


@cache
def _import_installed() -> None:
    for entry in installed_plugins():
        try:
            entry.load()
        except (KeyboardInterrupt, MemoryError):
            raise
        except BaseException as error:  # including SystemExit: a plugin must not end the program
            origin = entry.dist.name if entry.dist else entry.name
            reason = str(users_error(error) or reason_of(error)) if isinstance(error, Exception) else reason_of(error)
            FAILURES.append(PluginFailure(entry.name, origin, reason))


def plugin_failures() -> list[PluginFailure]:
    """Import the plugins of installed packages; one that fails stops nothing else. Return all that have failed."""
    _import_installed()
    return FAILURES


def _texts(name: str) -> dict[str, str]:
    """Texts of a user's module and of those that it needs, by the names of their copies in a run folder.

    Of a package these are all its files, of a file those beside it that it imports. Raises SchemeCodeError for a module
    without a file.
    """
    place = getattr(sys.modules.get(name), "__file__", None)
    if not place or not Path(place).is_file():  # of a prompt, or a script read from a pipe
        raise SchemeCodeError(
            f"what is defined in {name} has no file, and only the text of a file can tell results apart; "
            "write it into a file, or use topcli.simulate, which stores nothing"
        )
    file, package = Path(place), name.partition(".")[0]
    files, top = [file], file.parent
    if package != name or file.name == "__init__.py":
        root = next((folder for folder in file.parents if folder.name == package), top)
        files, top = sorted(root.rglob("*.py")), root.parent
    elif not _is_installed(str(file)):
        for path in files:  # which grows
            files += [helper for helper in _beside(path) if helper not in files]
    return {
        f"source.{re.sub(r'[^A-Za-z0-9_.-]', '.', str(path.relative_to(top)))}": path.read_text("utf-8", "replace")
        for path in files
    }


def _beside(path: Path) -> list[Path]:
    """Files of the modules and packages beside a file that it may import, also inside its functions."""
    imports = re.findall(r"^\s*(?:from|import)\s(.*)", path.read_text("utf-8", "replace"), re.MULTILINE)
    words = set(re.findall(r"\w+", " ".join(imports))) - sys.stdlib_module_names - {"topcli"}
    modules = (path.with_name(f"{word}.py") for word in sorted(words))
    packages = (file for word in sorted(words) for file in sorted((path.parent / word).rglob("*.py")))
    return [*filter(Path.is_file, modules), *packages]


def sources_of(values: Iterable[Any]) -> dict[str, str]:
    """Texts of the modules of users' functions and classes and of those that they need, by the names of their copies.

    It is the text at the time when they were registered. Raises SchemeCodeError for what has no file.
    """
    texts: dict[str, str] = {}
    for value in values:
        texts |= SOURCES.get(value) or _texts(value.__module__)
    return texts


TOPCLI = str(Path(__file__).parents[1])
STANDARD = sysconfig.get_path("stdlib")


def users_place(error: BaseException) -> str:
    """``file:line: in function`` of the innermost line of a user's code that an error passed; empty for none.

    An installed package that registers plugins is the user's as well.
    """
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        plugin = any(package == entry.module.partition(".")[0] for entry in installed_plugins())
        if file.startswith(("<", TOPCLI)) or (not plugin and (_is_installed(file) or file.startswith(STANDARD))):
            continue
        return f"{file}:{line}" + ("" if name == "<module>" else f": in {name}")
    return ""


def users_error(error: Exception) -> SchemeCodeError | None:
    """An error that a user's code raised, as one line that names the place; None for an error of topcli's own code."""
    if isinstance(error, TopcliError):
        return None
    place = users_place(error)
    return SchemeCodeError(f"{place}: {reason_of(error)}") if place else None


@contextmanager
def without_users_errors() -> Iterator[None]:
    """Leave the block at an error of a user's code, which is reported where that code is used."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, SchemeCodeError) or users_error(error)):
            raise


def reason_of(error: BaseException) -> str:
    """Type and first line of the message of an error."""
    if isinstance(error, TopcliError):
        return error.lines[0]
    return (f"{type(error).__name__}: {error}".splitlines() or [type(error).__name__])[0][:400]
