"""The type checker of the tests: beartype, with int where float is asked for, as PEP 484 has it.

Wrapping a nested function at each call of the outer one takes a millisecond, most of the time of
tests that loop over cycles. A nested function is therefore checked only if it contains a shape.
"""

import ast

from beartype import BeartypeConf, beartype
from jaxtyping._import_hook import JaxtypingTransformer  # private: there is no public hook

typecheck = beartype(conf=BeartypeConf(is_pep484_tower=True))


def states_shape(function):
    """Whether a function contains a shape, such as `Float[Array, "n"]`, in any subscript."""
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
