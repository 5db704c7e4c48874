"""The main job from the wheel alone: in an empty environment, another folder and without a network.

    python -m verification.robustness.empty_environment [ARGUMENT ...]

Builds the wheel, installs it with its dependencies into a new virtual environment, and there runs
`skystack reproduce` with the arguments (default: the quick one) with nothing of this checkout in
sight. Needs hatchling, and an index or a cache of packages to install from. Prints what was
installed and how long it took; exit code 1 where something of it fails.
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
"""By itself: a package in PYTHONPATH would pass for one that is installed."""
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
"""Every Python of the environment begins with it; addresses that are paths stay in the machine."""


class BrokenError(Exception):
    """Something did not work from the wheel alone."""


def build(out: Path) -> tuple[Path, Path]:
    """The wheel and the source distribution of this checkout."""
    _run([sys.executable, "-m", "hatchling", "build", "--directory", str(out)], cwd=ROOT)
    (wheel,), (source,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, source


def make_environment(folder: Path, wheel: Path, borrowed: Sequence[str] | None = None) -> Path:
    """An environment with the wheel in it and no network; returns its Python.

    Dependencies are installed, unless they are `borrowed`: folders that they are imported from.
    """
    venv.create(folder, with_pip=borrowed is None)
    python = folder / "bin" / "python"
    (site,) = folder.glob("lib/*/site-packages")
    if borrowed is None:
        constraints = ["--constraint", str(ROOT / "constraints.txt")]
        _run([str(python), *PIP, "install", "--quiet", *constraints, str(wheel)])
    else:
        there = ["--no-deps", "--no-index", "--target", str(site)]
        _run([sys.executable, *PIP, "install", "--quiet", *there, str(wheel)])
        (site / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    (site / "sitecustomize.py").write_text(NO_NETWORK)
    return python


def run_clean(command: Sequence[str], folder: Path, **variables: str) -> str:
    """What a command says that runs in a folder, with none of this environment's variables."""
    kept = {"PATH": os.environ["PATH"], "HOME": str(folder)}
    return _run(command, cwd=folder, env=kept | variables)


def without_network() -> list[str]:
    """What cuts a command off from every network, compiled code too; nothing if not allowed."""
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
            f"{' '.join(command)} ended with {done.returncode}: {done.stderr[-2000:]}"
        )
    return done.stdout


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code: 0 it works, 1 it does not."""
    with tempfile.TemporaryDirectory(prefix="empty-") as name:
        begun, folder = time.monotonic(), Path(name)
        try:
            wheel, source = build(folder)
            sizes = f"{wheel.stat().st_size / 1e6:.1f}, {source.stat().st_size / 1e6:.1f}"
            sys.stdout.write(f"wheel, source distribution, MB: {sizes}\n")
            python = make_environment(folder / "environment", wheel)
            installed_s = time.monotonic() - begun
            listed = _run([str(python), *PIP, "list", "--format", "freeze"]).splitlines()
            size = sum(path.stat().st_size for path in (folder / "environment").rglob("*"))
            sys.stdout.write(
                f"installed in {installed_s:.0f} s: {len(listed)} distributions, "
                f"{size / 1e6:.0f} MB\n"
            )
            (folder / "home").mkdir()
            job = [str(python), "-m", "skystack", "reproduce", *arguments]
            said = run_clean([*without_network(), *job], folder / "home")
        except BrokenError as wrong:
            sys.stdout.write(f"{wrong}\n")
            return 1
        way = "none at all" if without_network() else "refused to Python's sockets"
        took_s = time.monotonic() - begun - installed_s
        sys.stdout.write(f"{said}network: {way}; {took_s:.0f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
