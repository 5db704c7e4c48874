"""Find the classes of users' controllers, `module:Class` or `file.py:Class`, and their files."""

import importlib
import importlib.util
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from skystack.errors import InputError, error_context, suggestion
from skystack.io.files import file_digest
from skystack.io.signals import exit_code

METHOD = "generate_action"
Create = Callable[[], Any]
"""Creates an instance of a user's class."""
_LIBRARIES = (Path(__file__).parents[1], Path(sysconfig.get_path("stdlib")))
_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}


def is_user_code(name: str) -> bool:
    """Whether the name of an agent is `module:Class` or `file.py:Class`."""
    module, colon, member = name.rpartition(":")
    return bool(colon and module) and member.isidentifier()


def is_file_name(where: str) -> bool:
    """Whether the part before the class is the name of a file rather than of a module."""
    return Path(where).suffix.lower() == ".py"


def find_user_code(name: str) -> Create:
    """The class of a `module:Class` or `file.py:Class`. The module is imported, so it is executed.

    Modules are also looked for in the working directory. Raises InputError if the module cannot be
    imported, or if the class has no method `generate_action`.
    """
    where, _, member = name.rpartition(":")
    with error_context(name), redirect_stdout(sys.stderr), as_input_error("cannot be imported"):
        module = _of_file(Path(where)) if is_file_name(where) else _of_path(where)
        found = getattr(module, member, None)
        if found is None:
            raise InputError(f"there is no {member} in {where}{suggestion(member, dir(module))}")
        if not callable(found) or not callable(getattr(found, METHOD, None)):
            raise InputError(f"{member} is not a class with a method {METHOD}")
        create: Create = found
        return create


def user_code_file(name: str) -> Path | None:
    """The file of a `module:Class` or `file.py:Class`; None if the module has none.

    Raises InputError if there is no such file or module. Nothing is executed.
    """
    where, _, _ = name.rpartition(":")
    if is_file_name(where):
        return _existing(Path(where))
    _search_working_directory()
    with error_context(name), as_input_error("cannot be imported"):
        return _module_file(where)


def imported_files() -> dict[str, str]:
    """The files of all imported modules that are the user's, with their digests."""
    files = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    digests = {}
    for path in {file for file in files if isinstance(file, str) and not _is_library(file)}:
        with suppress(InputError):  # such as one in an archive
            digests[path] = file_digest(Path(path))
    return digests


def _module_file(where: str) -> Path | None:
    """The file of a module. Unlike `importlib.util.find_spec`, it does not import its parents."""
    package, *inner = where.split(".")
    spec, name = importlib.util.find_spec(package), package
    for each in inner:
        name = f"{name}.{each}"
        folders = None if spec is None else spec.submodule_search_locations
        spec = None if folders is None else PathFinder.find_spec(name, folders)
    if spec is None:
        raise InputError(f"there is no module {where}")
    return Path(spec.origin) if spec.has_location and spec.origin else None


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(f"{path} does not exist or is not a file")
    return path


def _of_file(path: Path) -> ModuleType:
    """The module in a file, whatever its name. Its neighbours can be imported."""
    folder = str(_existing(path).resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)  # last: its neighbours must not replace other modules
    # Absolute, because the module may change the working directory.
    spec = importlib.util.spec_from_file_location(f"_skystack_user_{path.stem}", path.absolute())
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file (allowed: .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return module


def _of_path(where: str) -> ModuleType:
    _search_working_directory()
    return importlib.import_module(where)


def _search_working_directory() -> None:
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))


@contextmanager
def as_input_error(what: str) -> Iterator[None]:
    """Convert any exception of a user's code to an InputError that names the line.

    Only an interruption by a signal is raised as it is.
    """
    try:
        yield
    except InputError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and exit_code() is not None:
            raise
        frames = traceback.extract_tb(error.__traceback__)
        users = [each for each in frames if not _is_library(each.filename)]
        last = f" ({Path(users[-1].filename).name}, line {users[-1].lineno})" if users else ""
        raise InputError(f"{what}: {_text(error)}{last}") from error


def _text(error: BaseException) -> str:
    """The type and the message of an exception; only the type if `str` fails on it."""
    name = type(error).__name__
    try:
        message = " ".join(str(error).split())
    except Exception:
        return name
    return f"{name}: {message}" if message else name


def _is_library(file: str) -> bool:
    """Whether a file belongs to a library rather than to the user."""
    path = Path(file)
    return (
        not path.is_absolute()  # of frozen or compiled code
        or any(path.is_relative_to(each) for each in _LIBRARIES)
        or not _LIBRARY_FOLDERS.isdisjoint(path.parts)
    )
