"""The commands of a developer, on a machine with Python 3.11 or newer; see README.md.

    python3 dev.py reproduce [ARGUMENT ...]   run `skystack reproduce` (default: a first look)
    python3 dev.py test [ARGUMENT ...]        run the tests; slow ones only in files that are named
    python3 dev.py test --all [ARGUMENT ...]  run all tests and check their coverage
                                              (arguments are passed to pytest)
    python3 dev.py check                      check lint, format and types
    python3 dev.py docs                       build the documentation, docs/_build/index.html

Each command first creates the virtual environment `.venv` with everything that it needs.
"""

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
PYTHON = ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
_ALL = (
    *("test", "bluebird", "bluesky", "docs", "film", "fuzzing", "live"),
    *("onnx", "pettingzoo", "ray", "sb3", "tensorboard"),
)
EXTRAS = {"reproduce": (), "test": _ALL, "check": _ALL, "docs": ("docs",)}
"""The extras that each command needs."""
PROGRAMS, MOST_BYTES = ENVIRONMENT / "test-programs", 1024**3
"""The folder in which tests keep compiled programs, and its maximum size when a run starts."""
COVERED = ("simulator/*", "tasks/*", "stacking.py", "learning/*")
"""The tests must cover at least 90 % of the lines and branches of each of these."""


def prepare(*extras: str) -> None:
    """Create the environment, or update it if the requirements have changed.

    It is created again for another version of Python.
    """
    wanted = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in wanted)).hexdigest()
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    stamp = ENVIRONMENT / "requirements.txt"
    written = stamp.read_text().split() if stamp.exists() else []
    python, before, *installed = [*written, "", ""]  # at least two
    usable = PYTHON.exists() and python == version
    if usable and before == digest and set(extras) <= set(installed):
        return
    if not usable:
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
    install = [str(PYTHON), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    package = f".[{','.join(extras)}]" if extras else "."
    requirements = ["--constraint", "constraints.txt", "--editable", package]
    subprocess.run([*install, *requirements], cwd=ROOT, check=True)
    stamp.write_text(" ".join([version, digest, *extras]))


def run(*command: str) -> int:
    """Run a Python module of the environment in the project folder; returns its exit code."""
    return subprocess.run([str(PYTHON), "-m", *command], cwd=ROOT, check=False).returncode


def keep_programs() -> None:
    """Let the tests keep compiled programs for later runs, and delete the oldest ones."""
    os.environ.setdefault("SKYSTACK_TEST_CACHE", str(PROGRAMS))
    newest = sorted(PROGRAMS.glob("*-cache"), key=lambda file: -file.stat().st_mtime)
    total = 0
    for file in newest:
        total += file.stat().st_size
        if total > MOST_BYTES:
            file.unlink()


def covered(files: str) -> int:
    """Report lines and branches that no test covers; returns 2 if the coverage is too low."""
    report = ("report", "--fail-under=90", "--show-missing", "--skip-covered")
    return run("coverage", *report, f"--include=src/skystack/{files}")


def main(arguments: list[str]) -> int:
    if not arguments or arguments[0] not in EXTRAS:
        sys.stderr.write(__doc__ or "")
        return 2
    verb, *rest = arguments
    prepare(*EXTRAS[verb])
    if verb == "reproduce":
        return run("skystack", "reproduce", *rest)
    if verb == "test":
        keep_programs()
        if "--all" in rest:
            rest.remove("--all")
            return run("pytest", "--cov", "--cov-report=", *rest) or max(map(covered, COVERED))
        named = any((ROOT / word.split("::")[0]).exists() for word in rest)
        return run("pytest", *(() if named else ("-m", "not slow")), *rest)
    if verb == "docs":
        code = run("sphinx", "-W", "--keep-going", "-q", "docs", "docs/_build", *rest)
        if code == 0:
            sys.stderr.write(f"documentation: {ROOT / 'docs' / '_build' / 'index.html'}\n")
        return code
    checks = (["ruff", "check"], ["ruff", "format", "--check"], ["mypy"])
    return max(run(*check) for check in checks)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
    except subprocess.CalledProcessError as error:
        sys.exit(f"dev.py: installation failed: {error}")
