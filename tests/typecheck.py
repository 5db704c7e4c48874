"""The type checker of the tests: beartype, accepting int for float as in PEP 484.

Wrapping a nested function at each call of its outer function takes a millisecond, which dominates
tests that loop over cycles. Nested functions are therefore checked only if they contain a shape.
"""

import ast

from beartype import BeartypeConf, beartype
from jaxtyping._import_hook import JaxtypingTransformer  # private: there is no public hook

typecheck = beartype(conf=BeartypeConf(is_pep484_tower=True))


def contains_shape(function):
    """Whether a function contains a shape, such as `Float[Array, "n"]`, in any subscript."""
    return any(
        isinstance(each, ast.Subscript)
        and isinstance(each.slice, ast.Tuple)
        and isinstance(each.slice.elts[-1], ast.Constant)
        and isinstance(each.slice.elts[-1].value, str)
        for each in ast.walk(function)
    )


def _visit(transformer, function):
    nested = any(isinstance(each, ast.FunctionDef) for each in transformer._parents)
    if nested and not contains_shape(function):
        return function
    return _wrap(transformer, function)


_wrap = JaxtypingTransformer.visit_FunctionDef
JaxtypingTransformer.visit_FunctionDef = _visit
