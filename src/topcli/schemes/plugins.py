"""Plugins: the tables that they extend, the modules beside a plugin file, and the source line of their errors."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import inspect
import pkgutil
import re
import sys
import sysconfig
import threading
import traceback
import types
from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, wraps
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from topcli.contracts import Scheme, Top
from topcli.errors import SchemeCodeError, TopcliError, UsageError
from topcli.tops import TOPS

GROUPS = ("topcli.tops", "topcli.schemes", "topcli.figures")
"""Groups of entry points in which installed packages declare plugins; each may bring anything."""
PLUGIN_FILE = "topcli_scheme_file_"
"""Start of the names of the modules of plugin files; a digest of the path follows."""
_NOT_BESIDE = sys.stdlib_module_names | {"topcli"}


def is_built_in(value: Any) -> bool:
    """True if a function or class belongs to topcli, not to a user's file or another package."""
    return value.__module__.partition(".")[0] == "topcli"


def named_module(value: Any) -> str:
    """Name of the module of a function or class, the same for a plugin file wherever it lies."""
    return PLUGIN_FILE if value.__module__.startswith(PLUGIN_FILE) else value.__module__


def file_of(value: Any) -> str:
    """File of a function or class, or the name of its module if there is none."""
    module = sys.modules.get(value.__module__)
    return str(getattr(module, "__file__", None) or value.__module__)


def sources_of(values: Iterable[Any]) -> dict[str, str]:
    """Source of the functions and classes of plugins, by the names under which a run keeps it.

    For a file that ``--plugin`` names, this includes the modules beside it that it imports; for a package, it is the
    module.
    """
    content: dict[str, bytes] = {}
    for value in values:
        file = file_of(value)
        loaded = [each.content for each in registry.files if value.__module__ in each.modules]
        for found in loaded:
            content |= found
        if not loaded and Path(file).is_file():
            content[f"{value.__module__}.py"] = Path(file).read_bytes()
    return {
        f"source.{re.sub(r'[^A-Za-z0-9_.-]', '.', name)}": text.decode("utf-8", "replace")
        for name, text in content.items()
    }


@dataclass(frozen=True)
class PluginFile:
    """Loaded plugin file: its ``path`` as given, its ``folder``, and the content of its modules by relative path."""

    path: str
    folder: str
    content: dict[str, bytes]
    modules: frozenset[str] = frozenset()
    """Names of the modules, which only the process that loaded them knows."""


P = ParamSpec("P")
T = TypeVar("T")
Table = MutableMapping[Any, Any]
Snapshot = dict[int, dict[Any, Any]]
"""Content of each table of a registry by its ``id``."""


class Registry:
    """Schemes by name and form of a top, and the tables of other parts that plugins extend."""

    def __init__(self) -> None:
        self.schemes: dict[tuple[str, str], Scheme] = {}
        self.for_every_top: dict[str, Callable[[str], None]] = {}
        """Function that registers a scheme, by its name, for a form that comes later, if it can integrate it."""
        self.top_origins: dict[str, str] = {}
        """Distribution or file of each form of a top that a plugin brought."""
        self.origin = "topcli"
        """Distribution or file that is being imported."""
        self.installed: dict[EntryPoint, PluginFailure | list[str]] = {}
        """Plugins of installed packages with the names that they have registered, or the reason why they failed."""
        self.files: list[PluginFile] = []
        self.before_files: Snapshot | None = None
        self.tables: list[tuple[Table, dict[Any, Any]]] = []
        """Tables that plugins extend, each with its built-in content."""
        for table in (self.schemes, TOPS.data, self.for_every_top, self.top_origins):
            self.extend(table)

    def complete(self, form: str, name: str | None = None) -> None:
        """Register the schemes for every top that integrate a form, or only the one called ``name``."""
        for known in [*self.for_every_top] if name is None else {name} & self.for_every_top.keys():
            if (known, form) not in self.schemes:
                with suppress(UsageError):  # the reason why it does not integrate this one
                    self.for_every_top[known](form)

    def extend(self, table: Table) -> None:
        """Let plugins extend ``table``, which holds what is built in."""
        self.tables.append((table, dict(table)))

    def snapshot(self) -> Snapshot:
        """Content of all tables."""
        return {id(table): dict(table) for table, _ in self.tables}

    def restore(self, snapshot: Snapshot) -> None:
        """Give all tables the content of ``snapshot``; one that came in later, its built-in content."""
        for table, built_in in self.tables:
            content = snapshot.get(id(table), built_in)
            table.clear()
            table.update(content)

    def added(self, snapshot: Snapshot) -> list[str]:
        """Names that plugins have registered since ``snapshot``."""
        names = set()
        for table, built_in in self.tables:
            for key in table.keys() - snapshot.get(id(table), built_in).keys():
                if getattr(table[key], "origin", "") != "topcli":  # topcli's schemes, for a new top
                    names.add(key[0] if isinstance(key, tuple) else key)
        return sorted(names)


registry = Registry()


@cache
def _lock() -> Any:
    """Lock of the registry; a value of the module would be part of the identity of code that looks up schemes."""
    return threading.RLock()


def one_at_a_time(function: Callable[P, T]) -> Callable[P, T]:
    """The function, entered by one thread at a time: it looks at the registry, and may extend it."""

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with _lock():
            return function(*args, **kwargs)

    return alone


@cache
def built_in_modules() -> tuple[str, ...]:
    """Names of the built-in modules that may register schemes: all modules in the packages beside this file."""
    root = Path(__file__).parent
    return tuple(
        f"topcli.schemes.{folder.name}.{module.name}"
        for folder in pkgutil.iter_modules([str(root)])
        if folder.ispkg
        for module in pkgutil.iter_modules([str(root / folder.name)])
    )


@cache
def import_built_in() -> None:
    """Import all modules that register schemes of topcli."""
    for module in built_in_modules():
        import_module(module)


def plugin_table(table: Table) -> None:
    """Let plugins extend ``table``, which holds what is built in; those of a plugin that fails are removed."""
    registry.extend(table)


def origin_of(function: Callable[..., Any]) -> str:
    """Distribution or file that registers ``function`` while it is being imported; else the file of the function."""
    if is_built_in(function):
        return "topcli"
    return file_of(function) if registry.origin == "topcli" else registry.origin


def line_of(function: Callable[..., Any]) -> str:
    """``file:line`` of the definition of a function; its file for anything else."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else file_of(function)


def top_origin(top: type[Top]) -> str:
    """Distribution or file of a top."""
    return "topcli" if is_built_in(top) else registry.top_origins.get(top.form) or file_of(top)


class FromSource(importlib.machinery.SourceFileLoader):
    """Compile the source whenever a module is loaded.

    Stored bytecode is compared with its source by size and whole seconds: an edit that follows a run within a
    second and keeps the size would go unnoticed.
    """

    def get_code(self, fullname: str) -> types.CodeType:
        """Code of the module."""
        return self.source_to_code(self.get_data(self.path), self.path)


class _Beside(importlib.abc.MetaPathFinder):
    """Finds the modules and packages of one folder, and keeps the names and the files of what it found."""

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)
        self.found: dict[str, Path | None] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Specification of a module in the folder, or in a package that was found there."""
        package, _, _ = fullname.rpartition(".")
        if (package and package not in self.found) or fullname in _NOT_BESIDE:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path if package else [self.folder], target)
        if spec is None or spec.loader is None:
            return None
        if type(spec.loader) is importlib.machinery.SourceFileLoader:
            spec.loader = FromSource(spec.loader.name, spec.loader.path)
        self.found[fullname] = Path(spec.origin) if spec.has_location and spec.origin else None
        return spec


@contextmanager
def modules_beside(folder: Path) -> Iterator[dict[str, Path | None]]:
    """Make the modules of ``folder`` importable, before all others but those of the standard library and topcli.

    The value holds the files of those that are imported by name, None for one without a file. The modules are
    forgotten at the end: a module of the same name beside another plugin file is another module.
    """
    beside = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__init__.py")}
    beside -= _NOT_BESIDE
    hidden = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in beside}
    for name in hidden:
        del sys.modules[name]
    finder = _Beside(folder)
    importlib.invalidate_caches()
    sys.meta_path.insert(0, finder)
    try:
        yield finder.found
    finally:
        sys.meta_path.remove(finder)
        for name in finder.found:
            sys.modules.pop(name, None)
        sys.modules.update(hidden)


def _is_users(frame: types.FrameType) -> bool:
    """True if the code of a frame is neither topcli's, nor the standard library's, nor an installed package's.

    An installed package that registers schemes is the user's as well.
    """
    file = frame.f_code.co_filename
    if file.startswith("<"):
        return False
    path = Path(file)
    if path.is_relative_to(Path(__file__).parents[1]):
        return False
    if not {"site-packages", "dist-packages"}.isdisjoint(path.parts):
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        return any(package == entry.module.partition(".")[0] for entry in installed_plugins())
    return not path.is_relative_to(sysconfig.get_path("stdlib"))


def users_place(error: BaseException) -> str:
    """``file:line: in function`` of the innermost line of a user's code that an error passed; empty for none."""
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        if _is_users(frame):
            name = frame.f_code.co_name
            return f"{frame.f_code.co_filename}:{line}" + ("" if name == "<module>" else f": in {name}")
    return ""


def users_error(error: Exception) -> SchemeCodeError | None:
    """An error that a user's code raised, as one line that names the place; None for an error of topcli itself."""
    place = users_place(error)
    if isinstance(error, TopcliError) or not place:
        return None
    return SchemeCodeError(f"{place}: {reason_of(error)}")


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
    return (f"{type(error).__name__}: {error}".splitlines() or [type(error).__name__])[0][:400]


@dataclass(frozen=True)
class PluginFailure:
    """Plugin that could not be imported: its name, its distribution or file, and the reason in one line."""

    name: str
    origin: str
    reason: str

    def __str__(self) -> str:
        return f"plugin {self.name!r} of {self.origin} failed: {self.reason}"


def _failure(error: BaseException) -> str:
    """Reason why a plugin cannot be imported, with the place, in one line."""
    if isinstance(error, TopcliError):
        return error.lines[0]
    place = users_place(error)
    return f"{place}: {reason_of(error)}" if place else reason_of(error)


def import_plugin(name: str, origin: str, load: Callable[[], object]) -> PluginFailure | list[str]:
    """Import a plugin and return the names that it registers; if that fails, remove them and return the failure."""
    before, tops, previous = registry.snapshot(), set(TOPS), registry.origin
    registry.origin = origin
    try:
        load()
        if bare := TOPS.keys() - tops - registry.top_origins.keys():
            raise UsageError(f"top {min(bare)!r} is registered without @topcli.top; decorate its class")
    except (KeyboardInterrupt, MemoryError):
        raise
    except BaseException as error:  # including SystemExit: a plugin must not end the program
        registry.restore(before)
        return PluginFailure(name, origin, _failure(error))
    finally:
        registry.origin = previous
    return registry.added(before)


@cache
def installed_plugins() -> tuple[EntryPoint, ...]:
    """Entry points of plugins, by name."""
    found = {(entry.name, entry.value): entry for group in GROUPS for entry in entry_points(group=group)}
    return tuple(found[key] for key in sorted(found))


def distribution_of(entry: EntryPoint) -> str:
    """Name of the distribution that declares an entry point."""
    return entry.dist.name if entry.dist else entry.name


def plugin_failures(name: str | None = None) -> tuple[PluginFailure, ...]:
    """Import the plugins of installed packages, or those called ``name``; return all that have failed."""
    import_built_in()
    for entry in installed_plugins():
        if entry not in registry.installed and name in (None, entry.name.lower()):
            registry.installed[entry] = []  # first, because a plugin may look for names itself
            registry.installed[entry] = import_plugin(entry.name, distribution_of(entry), entry.load)
    return known_failures()


def known_failures() -> tuple[PluginFailure, ...]:
    """Plugins of installed packages that have failed so far."""
    return tuple(found for found in registry.installed.values() if isinstance(found, PluginFailure))


def failed_plugin(name: str) -> PluginFailure | None:
    """Failure of the plugin called ``name``; None if there is none, or if it works."""
    return next((failure for failure in plugin_failures(name) if failure.name.lower() == name), None)


def find_more_tops(name: str) -> list[str]:
    """Import the plugin called ``name``, or else all, and return messages on two that failed.

    Raises SchemeCodeError if the named one fails.
    """
    if failure := failed_plugin(name):
        raise SchemeCodeError(f"top {name!r}: {failure}")
    if not any(TOPS.kind(form) == name or form == name for form in TOPS):
        plugin_failures()
    return list(map(str, known_failures()[:2]))
