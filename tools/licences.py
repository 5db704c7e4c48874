"""List the licences of all that skystack installs in docs/licences.md.

    python -m tools.licences

Lists what the distributions themselves state, for the core and for what each extra adds; all extras
must be installed. Versions are those of this environment.
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
"""Prefixes of distributions that only some builds of torch install; the page mentions them once."""
_COPYLEFT = re.compile(r"GPL|General Public|MPL|Mozilla|EPL|CDDL")
_HEAD = """# Licences

skystack itself is Apache-2.0. This page lists what it installs, with the licence that each
distribution states in its own metadata: first the core, then what each extra adds. Copyleft of any
kind is **bold**. Versions are those of the environment in which this page was written, by

    python -m tools.licences

- **The core** is permissive, except for certifi (MPL-2.0, which covers only its own files; pyproj
  needs it for downloads that skystack never makes).
- **Only extras have stronger copyleft**: BluebirdDT (`[bluebird]`, AGPL-3.0-or-later), BlueSky's
  navigation data and OpenAP (`[bluesky]`, GPL and LGPL), Pebble (both, LGPL). Nothing of theirs is
  in skystack's wheel, and only `skystack.platforms` and `skystack bench` import them. If you pass
  on an environment that contains them, their terms apply.
- docutils (`[docs]`) is in the public domain except for some parts; the GPL applies to a file for
  Emacs. hypothesis, pathspec and tqdm (`[test]`) are used only to test and build.
- atheris (`[fuzzing]`) states no licence in its metadata; the licence file in its wheel is
  Apache-2.0.
- **Metadata describes Python packages, not everything in their wheels.** For Linux, the wheels of
  shapely contain GEOS (LGPL-2.1), and those of numpy and scipy contain the run-time libraries of
  GCC (GPL with their exception) and libquadmath (LGPL-2.1-or-later), as their licence files state.
- imageio-ffmpeg (`[film]`) is BSD-2-Clause, but its wheels contain the program ffmpeg, which is
  GPL-3.0-or-later as built there. skystack runs it as a separate process.
- torch (`[sb3]`) for Linux with CUDA includes NVIDIA's libraries, under NVIDIA's terms (`nvidia-*`,
  and triton, MIT). The CPU build, listed here, does not.

This is a list, not legal advice.
"""


def requirements() -> dict[str, list[str]]:
    """The requirements in pyproject.toml: those of the core, then those of each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return {CORE: project["dependencies"], **project["optional-dependencies"]}


def needed(wanted: Iterable[str]) -> tuple[dict[str, Distribution], set[str]]:
    """All distributions that the requirements install, by canonical name, and missing names."""
    found: dict[str, Distribution] = {}
    missing: set[str] = set()
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [Requirement(line) for line in wanted]
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
        waiting += _requirements_of(found[name], extras)
    return found, missing


def _requirements_of(installed: Distribution, extras: frozenset[str]) -> Iterator[Requirement]:
    for line in installed.requires or ():
        each = Requirement(line)
        marker = each.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield each


def licence(installed: Distribution) -> str:
    """The stated licence: an SPDX expression, otherwise classifiers, otherwise the text field."""
    metadata = installed.metadata
    if expression := metadata.get_all("License-Expression"):
        return str(expression[0])
    classifiers = metadata.get_all("Classifier") or ()
    named = [each.rpartition(" :: ")[2] for each in classifiers if each.startswith("License ::")]
    if named:
        return ", ".join(named)
    text = "".join(metadata.get_all("License") or ()).strip()
    first, *more = text.splitlines() or ["not stated"]
    return f"{first} ..." if more else first


def table(found: dict[str, Distribution]) -> str:
    """The distributions as a Markdown table."""
    lines = ["| distribution | version | licence |", "|---|---|---|"]
    for name, installed in sorted(found.items()):
        stated = licence(installed).replace("|", "/")
        shown = f"**{stated}**" if _COPYLEFT.search(stated) else stated
        lines.append(f"| {name} | {installed.version.partition('+')[0]} | {shown} |")
    return "\n".join(lines) + "\n"


def page() -> tuple[str, set[str]]:
    """The text of the page, and the names of distributions that are not installed here."""
    parts, core, absent = [_HEAD], set[str](), set[str]()
    for extra, wanted in requirements().items():
        found, missing = needed(wanted)
        absent |= missing
        shown = {name: each for name, each in found.items() if name not in core}
        core = core or set(found)
        title = "The core" if extra == CORE else f"`[{extra}]`"
        parts.append(f"## {title}\n\n{table(shown)}")
    return "\n".join(parts), absent


def main() -> int:
    """Returns the exit code: 0 written, 2 a distribution is missing."""
    text, absent = page()
    if absent:
        sys.stderr.write(f"not installed: {', '.join(sorted(absent))} (install all extras)\n")
        return 2
    atomic_write(PAGE, text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
