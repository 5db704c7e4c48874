"""The licence report: the statements of distributions, and the requirements that it follows."""

from importlib.metadata import PathDistribution

import pytest

from tools import licences


def distribution_of(folder, name, *lines):
    """An installed distribution with these lines of metadata."""
    info = folder / f"{name}-1.dist-info"
    info.mkdir()
    head = (f"Name: {name}", "Version: 1+here", *lines)
    (info / "METADATA").write_text("\n".join(head) + "\n")
    return PathDistribution(info)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        (["License-Expression: MIT", "License: other"], "MIT"),
        (
            ["License: see file", "Classifier: License :: OSI Approved :: BSD License"],
            "BSD License",
        ),
        (["License: LGPL"], "LGPL"),
        (["License: Own terms", "        of many lines"], "Own terms ..."),
        (["License: ", "Classifier: Typing :: Typed"], "not stated"),
    ],
)
def test_the_most_exact_statement_is_reported(tmp_path, stated, expected):
    assert licences.licence(distribution_of(tmp_path, "one", *stated)) == expected


def test_follows_the_requirements_that_apply_here(tmp_path, monkeypatch):
    requirements = (
        "Requires-Dist: Two.b[fast]>=1",
        "Requires-Dist: never; python_version < '3'",
        "Requires-Dist: unasked; extra == 'all'",
        "Requires-Dist: nvidia-cublas",
    )
    installed = {
        "one": distribution_of(tmp_path, "one", *requirements),
        "Two.b": distribution_of(tmp_path, "two_b", "Requires-Dist: three; extra == 'fast'"),
    }

    def find(name):
        try:
            return installed[name]
        except KeyError:
            raise licences.PackageNotFoundError(name) from None

    monkeypatch.setattr(licences, "distribution", find)
    found, missing = licences.needed(["one"])
    assert (set(found), missing) == ({"one", "two-b"}, {"three"})


def test_copyleft_is_marked(tmp_path):
    terms = {"a": "AGPL-3.0-or-later", "b": "MIT", "c": "MPL-2.0", "d": "LGPL"}
    found = {
        name: distribution_of(tmp_path, name, f"License: {term}") for name, term in terms.items()
    }
    lines = licences.table(found).splitlines()[2:]
    assert lines == [
        "| a | 1 | **AGPL-3.0-or-later** |",
        "| b | 1 | MIT |",
        "| c | 1 | **MPL-2.0** |",
        "| d | 1 | **LGPL** |",
    ]
