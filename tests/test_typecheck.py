"""The tests' type checker checks every function, except nested ones without shapes."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError, install_import_hook

MODULE = """
from jaxtyping import Float
import numpy as np


def outer(vector: Float[np.ndarray, " n"], nested: str):
    def shaped(one: Float[np.ndarray, " n"], two: Float[np.ndarray, " n"]) -> None: ...
    def plain(number: int) -> int:
        return number

    if nested == "shaped":
        return shaped(vector, np.zeros(2))
    return plain("text")
"""


@pytest.fixture
def outer(tmp_path, monkeypatch):
    (tmp_path / "nesting.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    with install_import_hook("nesting", "tests.typecheck.typecheck"):
        import nesting

        return nesting.outer


@pytest.mark.slow
def test_checks_shapes_in_outer_and_nested_functions(outer):
    with pytest.raises(TypeCheckError, match=r"parameters of nesting\.outer\."):
        outer(np.zeros((2, 2)), "plain")
    with pytest.raises(TypeCheckError, match=r"parameters of nesting\.outer\.<locals>\.shaped"):
        outer(np.zeros(3), "shaped")
    assert outer(np.zeros(2), "shaped") is None
    assert outer(np.zeros(3), "plain") == "text"
