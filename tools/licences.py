"""The licences of all that skystack installs: writes docs/licences.md.

    python -m tools.licences

Says what the distributions themselves state, for those that the core needs and those that each
extra adds; all extras must be installed. Versions are those of this environment.
"""

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from skystack.io.files import atomic_write

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
CORE = "core"
OF_TORCH = ("nvidia-", "cuda-", "triton")
"""Comes with some builds of torch and not with others; the page says so once."""
_COPYLEFT = re.compile(r"GPL|General Public|MPL|Mozilla|EPL|CDDL")
_HEAD = """# Licences

skystack itself is Apache-2.0. Below is what it installs, with the licence that each distribution
states in its own metadata: what the core needs, then what each extra adds to that. **Bold** is
copyleft of any kind. Versions are those of the environment in which this was written, by

    python -m tools.licences

- **The core** is permissive, but for certifi (MPL-2.0, which covers its own files only; pyproj
  needs it for downloads that skystack never asks for).
- **Only with an extra** comes stronger copyleft: BluebirdDT (`[bluebird]`, AGPL-3.0-or-later),
  BlueSky's navigation data and OpenAP (`[bluesky]`, GPL and LGPL), Pebble (both, LGPL). Nothing of
  theirs is in skystack's wheel, and nothing but `skystack.platforms` and `skystack bench` imports
  them. Who passes on an environment that holds them has their terms to keep.
- docutils (`[docs]`) is in the public domain but for parts; its GPL is that of a file for Emacs.
  hypothesis and pathspec (`[test]`) only test and build.
- atheris (`[fuzzing]`) states none in its metadata; the licence file in its wheel is Apache-2.0.
- **Metadata tells of Python packages, not of all that is in their wheels.** Those for Linux of
  shapely hold GEOS (LGPL-2.1), those of numpy and scipy the run-time libraries of GCC (GPL with the
  exception for them) and libquadmath (LGPL-2.1-or-later). Their own licence files say so.
- torch (`[sb3]`) for Linux with CUDA brings NVIDIA's libraries, under NVIDIA's terms (`nvidia-*`,
  and triton, MIT). The build for processors, listed here, does not.

This is a list, not legal advice.
"""


def requirements() -> dict[str, list[str]]:
    """What pyproject.toml asks for: of the core, then of each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return {CORE: project["dependencies"], **project["optional-dependencies"]}


def needed(asked: Iterable[str]) -> tuple[dict[str, Distribution], set[str]]:
    """All that requirements lead to here, by canonical name, and the names not installed."""
    found: dict[str, Distribution] = {}
    missing: set[str] = set()
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [Requirement(line) for line in asked]
    while waiting:
        each = waiting.pop()
        name, extras = canonicalize_name(each.name), frozenset(each.extras)
        if (name, extras) in seen or name.startswith(OF_TORCH):
            continue
        seen.add((name, extras))
        try:
            found[name] = distribution(each.name)
        except PackageNotFoundError:
            missing.add(name)
            continue
        waiting += _of(found[name], extras)
    return found, missing


def _of(installed: Distribution, extras: frozenset[str]) -> Iterator[Requirement]:
    for line in installed.requires or ():
        each = Requirement(line)
        marker = each.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield each


def licence(installed: Distribution) -> str:
    """What a distribution states: an SPDX expression, else classifiers, else the short field."""
    stated = installed.metadata
    if expression := stated.get_all("License-Expression"):
        return str(expression[0])
    classifiers = stated.get_all("Classifier") or ()
    named = [each.rpartition(" :: ")[2] for each in classifiers if each.startswith("License ::")]
    if named:
        return ", ".join(named)
    said = "".join(stated.get_all("License") or ()).strip()
    first, *more = said.splitlines() or ["not stated"]
    return f"{first} ..." if more else first


def table(found: dict[str, Distribution]) -> str:
    """As Markdown."""
    lines = ["| distribution | version | licence |", "|---|---|---|"]
    for name, installed in sorted(found.items()):
        said = licence(installed).replace("|", "/")
        shown = f"**{said}**" if _COPYLEFT.search(said) else said
        lines.append(f"| {name} | {installed.version.partition('+')[0]} | {shown} |")
    return "\n".join(lines) + "\n"


def page() -> tuple[str, set[str]]:
    """The page, and the names of what should be on it and is not installed here."""
    parts, core, absent = [_HEAD], set[str](), set[str]()
    for extra, asked in requirements().items():
        found, missing = needed(asked)
        absent |= missing
        shown = {name: each for name, each in found.items() if name not in core}
        core = core or set(found)
        title = "The core" if extra == CORE else f"`[{extra}]`"
        parts.append(f"## {title}\n\n{table(shown)}")
    return "\n".join(parts), absent


def main() -> int:
    """Returns the exit code: 0 written, 2 something is not installed."""
    text, absent = page()
    if absent:
        sys.stderr.write(f"not installed: {', '.join(sorted(absent))} (allowed: all extras)\n")
        return 2
    atomic_write(PAGE, text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
