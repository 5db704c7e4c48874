"""The type checker of the tests: beartype, with int where float is asked for, as PEP 484 has it.

A nested function is created at every call of the outer one, and wrapping it takes a millisecond. In
loops over cycles that was most of the time of the tests, so a nested function is only checked if
its annotations hold a shape.
"""

import ast

from beartype import BeartypeConf, beartype
from jaxtyping._import_hook import JaxtypingTransformer  # private: nothing public can do it

typecheck = beartype(conf=BeartypeConf(is_pep484_tower=True))


def states_shape(function):
    """Whether an annotation in a function holds a shape, as in `Float[Array, "n"]`."""
    return any(
        isinstance(each, ast.Subscript)
        and isinstance(each.slice, ast.Tuple)
        and isinstance(each.slice.elts[-1], ast.Constant)
        and isinstance(each.slice.elts[-1].value, str)
        for each in ast.walk(function)
    )


def _visit(transformer, function):
    inside = any(isinstance(each, ast.FunctionDef) for each in transformer._parents)
    if inside and not states_shape(function):
        return function
    return _wrap(transformer, function)


_wrap = JaxtypingTransformer.visit_FunctionDef
JaxtypingTransformer.visit_FunctionDef = _visit
