"""Find the classes of users' controllers, `module:Class` or `file.py:Class`, and their files."""

import importlib
import importlib.util
import symtable
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from importlib.machinery import PathFinder
from modulefinder import ModuleFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from skystack.errors import InputError, error_context, suggestion
from skystack.io.files import read_whole
from skystack.io.signals import exit_code

METHOD = "generate_action"
Create = Callable[[], Any]
"""Creates an instance of a user's class."""
_loaded_before: set[str] = set()
"""The modules that were loaded before the first one of a user."""


def is_user_code(name: str) -> bool:
    """Whether the name of an agent is `module:Class` or `file.py:Class`."""
    module, colon, member = name.rpartition(":")
    return bool(colon and module) and member.isidentifier()


def is_file_name(where: str) -> bool:
    """Whether the part before the class is the name of a file rather than of a module."""
    return Path(where).suffix.lower() == ".py"


def find_user_code(name: str) -> Create:
    """The class of a `module:Class` or `file.py:Class`. Its module is imported, so it is executed.

    The module, and all modules of the user's that it imports, are imported anew by each call, so
    that hours do not depend on earlier ones. Modules are also looked for in the working directory.
    Raises InputError if the module cannot be imported, or if the class has no method
    `generate_action`.
    """
    where, _, member = name.rpartition(":")
    with error_context(name), redirect_stdout(sys.stderr), as_input_error("cannot be imported"):
        _forget_modules()
        module = _of_file(Path(where)) if is_file_name(where) else _of_path(where)
        found = getattr(module, member, None)
        if found is None:
            raise InputError(f"there is no {member} in {where}")
        if not callable(found) or not callable(getattr(found, METHOD, None)):
            raise InputError(f"{member} is not a class with a method {METHOD}")
        create: Create = found
        return create


def user_code_files(name: str) -> list[Path]:
    """The file of a `module:Class` or `file.py:Class`, then those that it imports from its folder.

    Nothing is executed, so files that are imported in other ways are missing. Empty if the module
    has no file. Raises InputError if there is no such file, module or class, or for a syntax error.
    """
    where, _, member = name.rpartition(":")
    with error_context(name), redirect_stdout(sys.stderr), as_input_error("cannot be imported"):
        file = _existing(Path(where)) if is_file_name(where) else _module_file(where)
        if file is None:
            return []
        if file.suffix != ".py" or _is_library(str(file)):
            return [file]
        _check_defines(file, where, member)
        return [file, *_imported(file, where)]


def _check_defines(file: Path, where: str, member: str) -> None:
    """Raise InputError if a file cannot define a class."""
    text = read_whole(file).decode()
    names = [
        each.get_name()
        for each in symtable.symtable(text, str(file), "exec").get_symbols()
        if each.is_assigned() or each.is_imported() or each.is_namespace()
    ]
    if member not in names and "import *" not in text and "__getattr__" not in names:
        raise InputError(f"there is no {member} in {where}{suggestion(member, names)}")


def _imported(file: Path, where: str) -> list[Path]:
    """The other files that a file imports, directly or not, from the folder of its package."""
    depth = 0 if is_file_name(where) else where.count(".") + (file.stem == "__init__")
    finder = ModuleFinder([str(file.resolve().parents[depth])], excludes=["skystack"])
    if is_file_name(where):
        finder.run_script(str(file))
    else:
        finder.import_hook(where)
    files = (getattr(module, "__file__", None) for module in finder.modules.values())
    return sorted({Path(each).resolve() for each in files if each} - {file.resolve()})


def _module_file(where: str) -> Path | None:
    """The file of a module. Unlike `importlib.util.find_spec`, it does not import its packages."""
    _search_working_directory()
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


def _forget_modules() -> None:
    """Forget the modules of users that earlier calls have imported."""
    if not _loaded_before:
        _loaded_before.update(sys.modules)
    for name in sys.modules.keys() - _loaded_before:
        file = getattr(sys.modules[name], "__file__", None)
        if file and file.endswith(".py") and not _is_library(file):
            del sys.modules[name]


def _of_file(path: Path) -> ModuleType:
    """The module in a file, whatever its name. Its neighbours can be imported."""
    folder = str(_existing(path).resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)  # last: its neighbours must not replace other modules
    spec = importlib.util.spec_from_file_location(f"_skystack_user_{path.stem}", path)
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
    """The type and the message of an exception, which may fail to make one."""
    name = type(error).__name__
    try:
        message = " ".join(str(error).split())
    except Exception:
        return name
    return f"{name}: {message}" if message else name


def _is_library(file: str) -> bool:
    """Whether a file is not the user's."""
    libraries = (str(Path(__file__).parents[1]), sysconfig.get_path("stdlib"))
    return file.startswith(("<", *libraries)) or "site-packages" in file
