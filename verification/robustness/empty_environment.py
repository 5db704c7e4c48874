"""Run a reproduction from the wheel alone: in an empty environment and without a network.

    python -m verification.robustness.empty_environment [ARGUMENT ...]

Builds the wheel, installs it with its dependencies into a new virtual environment, and runs
`skystack reproduce` there with the arguments (default: --quick), in a folder without access to this
checkout. Needs hatchling, and an index or a cache of packages to install from. Prints what was
installed and the times; exit code 1 if anything fails.
"""

import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PIP = ["-I", "-m", "pip", "--disable-pip-version-check"]
"""Isolated (-I), because pip would regard packages in PYTHONPATH as installed."""
LIMIT_S = 3600.0

NO_NETWORK = """
import sys

def refuse(event, arguments):
    if event in ("socket.getaddrinfo", "socket.gethostbyname"):
        raise OSError(f"no network here: {arguments[0]}")
    if event in ("socket.connect", "socket.sendto") and isinstance(arguments[-1], tuple):
        raise OSError(f"no network here: {arguments[-1]}")

sys.addaudithook(refuse)
"""
"""The environment's `sitecustomize` module. Addresses that are paths are local, and allowed."""


class BrokenError(Exception):
    """A step failed from the wheel alone."""


def build(out: Path) -> tuple[Path, Path]:
    """The wheel and the source distribution of this checkout."""
    _run([sys.executable, "-m", "hatchling", "build", "--directory", str(out)], cwd=ROOT)
    (wheel,), (source,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, source


def make_environment(folder: Path, wheel: Path, borrowed: Sequence[str] | None = None) -> Path:
    """Create an environment with the wheel and without a network; returns its Python.

    Dependencies are installed, or imported from the folders in `borrowed`.
    """
    venv.create(folder, with_pip=borrowed is None)
    python = folder / "bin" / "python"
    (site,) = folder.glob("lib/*/site-packages")
    if borrowed is None:
        constraints = ["--constraint", str(ROOT / "constraints.txt")]
        _run([str(python), *PIP, "install", "--quiet", *constraints, str(wheel)])
    else:
        target = ["--no-deps", "--no-index", "--target", str(site)]
        _run([sys.executable, *PIP, "install", "--quiet", *target, str(wheel)])
        (site / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    (site / "sitecustomize.py").write_text(NO_NETWORK)
    return python


def run_clean(command: Sequence[str], folder: Path, **variables: str) -> str:
    """The output of a command run in a folder, without this environment's variables."""
    needed = {"PATH": os.environ["PATH"], "HOME": str(folder)}
    return _run(command, cwd=folder, env=needed | variables)


def without_network() -> list[str]:
    """The prefix that removes all networks from a command, or nothing if that is not permitted."""
    prefix = ["unshare", "--map-root-user", "--net"]
    try:
        subprocess.run([*prefix, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return []
    return prefix


def _run(
    command: Sequence[str], cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, check=False, cwd=cwd, env=env
    )
    if done.returncode != 0:
        raise BrokenError(
            f"{' '.join(command)} exited with {done.returncode}: {done.stderr[-2000:]}"
        )
    return done.stdout


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code: 0 success, 1 failure."""
    with tempfile.TemporaryDirectory(prefix="empty-") as name:
        started, folder = time.monotonic(), Path(name)
        try:
            wheel, source = build(folder)
            sizes = f"{wheel.stat().st_size / 1e6:.1f}, {source.stat().st_size / 1e6:.1f}"
            sys.stdout.write(f"wheel, source distribution, MB: {sizes}\n")
            python = make_environment(folder / "environment", wheel)
            installed_s = time.monotonic() - started
            distributions = _run([str(python), *PIP, "list", "--format", "freeze"]).splitlines()
            size = sum(path.stat().st_size for path in (folder / "environment").rglob("*"))
            sys.stdout.write(
                f"installed in {installed_s:.0f} s: {len(distributions)} distributions, "
                f"{size / 1e6:.0f} MB\n"
            )
            (folder / "home").mkdir()
            job = [str(python), "-m", "skystack", "reproduce", *arguments]
            output = run_clean([*without_network(), *job], folder / "home")
        except BrokenError as error:
            sys.stdout.write(f"{error}\n")
            return 1
        network = "none" if without_network() else "refused to Python's sockets"
        took_s = time.monotonic() - started - installed_s
        sys.stdout.write(f"{output}network: {network}; {took_s:.0f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
