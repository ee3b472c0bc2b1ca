# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values of the operands of a failed condition, found from the source of the call that checks it.

pytest does this for ``assert``, which fails on one process alone; :func:`collective.agree` does it
on all. As some operands are collective calls, all processes evaluate them again, in the same order.
"""

from __future__ import annotations

import ast
import functools
import itertools
import linecache
from collections.abc import Iterator
from types import CodeType, FrameType
from typing import Any

import numpy as np

#: Longest text of a value: a few lines of a terminal; arrays and lists of records exceed it.
MAX_CHARACTERS = 400


@functools.cache
def calls_of(filename: str) -> dict[tuple[int, int, int, int], ast.Call]:
    """Return all calls in a file by first line, last line, first column and last column."""
    tree = ast.parse("".join(linecache.getlines(filename)))
    return {
        (node.lineno, node.end_lineno or 0, node.col_offset, node.end_col_offset or 0): node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
    }


def present_call(frame: FrameType) -> ast.Call | None:
    """Return the call that a frame executes, or None if its source is unknown."""
    position = instruction_position(frame.f_code, frame.f_lasti)
    return calls_of(frame.f_code.co_filename).get(position)  # type: ignore[arg-type]


def instruction_position(code: CodeType, offset: int) -> tuple[int | None, ...]:
    """Return first line, last line, first column and last column of an instruction."""
    index = offset // 2  # an instruction has two bytes
    return next(itertools.islice(code.co_positions(), index, None))


def argument(frame: FrameType, index: int) -> str:
    """Return the source of an argument of the call that a frame executes."""
    call = present_call(frame)
    if call is None or index >= len(call.args):
        return "value"
    return ast.unparse(call.args[index])


def explain(frame: FrameType) -> str:
    """Return the first argument of the call that a frame executes, and the values of its operands.

    Collective if the operands are: they are evaluated again.
    """
    call = present_call(frame)
    if call is None:
        return "condition without source"
    condition = call.args[0]
    scope = {**frame.f_globals, **frame.f_locals}
    lines = dict.fromkeys(describe(condition, scope))  # a dict keeps the order, each line once
    return "\n".join([ast.unparse(condition), *(f"    {line}" for line in lines)])


def describe(node: ast.expr, scope: dict[str, Any]) -> Iterator[str]:
    """Yield a line for each operand of a condition that failed.

    Args:
        node: The condition; of a conjunction, the conditions that hold are left out.
        scope: Values of the names in it.
    """
    if isinstance(node, ast.BoolOp):
        for operand in node.values:
            is_cause = isinstance(node.op, ast.Or) or not is_true(operand, scope)
            if is_cause:
                yield from describe(operand, scope)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield from describe(node.operand, scope)
    elif isinstance(node, ast.Compare):
        for operand in (node.left, *node.comparators):
            yield from value_of(operand, scope)
            if isinstance(operand, ast.Compare):  # (count > 0) == (kind == "few")
                yield from describe(operand, scope)
    elif isinstance(node, ast.Call) and is_over_generator(node, "all"):
        yield from describe_counterexample(node.args[0], scope)
    elif isinstance(node, ast.Call) and is_over_generator(node, "any"):
        for name in dict.fromkeys(part.id for part in ast.walk(node) if isinstance(part, ast.Name)):
            if name in scope and not callable(scope[name]):
                yield f"{name} = {shown(scope[name])}"
    elif isinstance(node, ast.Call):
        if isinstance(node.func, ast.Attribute):
            yield from value_of(node.func.value, scope)
        for operand in node.args:
            yield from value_of(operand, scope)
    else:
        yield from value_of(node, scope)


def is_over_generator(node: ast.Call, function: str) -> bool:
    """Return True for ``function(… for … in …)``."""
    has_name = isinstance(node.func, ast.Name) and node.func.id == function
    return has_name and len(node.args) == 1 and isinstance(node.args[0], ast.GeneratorExp)


def describe_counterexample(node: ast.expr, scope: dict[str, Any]) -> Iterator[str]:
    """Yield the first values of a generator's variables where its element is false."""
    assert isinstance(node, ast.GeneratorExp)
    stores = (part for loop in node.generators for part in ast.walk(loop.target))
    names = list(dict.fromkeys(part.id for part in stores if isinstance(part, ast.Name)))
    variables = ast.Tuple([ast.Name(name, ast.Load()) for name in names], ast.Load())
    fails = ast.UnaryOp(ast.Not(), node.elt)
    last = node.generators[-1]
    loops = [
        *node.generators[:-1],
        ast.comprehension(last.target, last.iter, [*last.ifs, fails], last.is_async),
    ]
    found = evaluate(ast.ListComp(variables, loops), scope)
    if not isinstance(found, list) or not found:
        yield f"{ast.unparse(node)} is true when evaluated again"
        return
    inner = {**scope, **dict(zip(names, found[0], strict=True))}
    for name in names:
        yield f"{name} = {shown(inner[name])}"
    yield from describe(node.elt, inner)


def value_of(node: ast.expr, scope: dict[str, Any]) -> Iterator[str]:
    """Yield a line with an expression and its value; none for a module or what is a constant."""
    is_constant = all(not isinstance(part, ast.Name) for part in ast.walk(node))
    if is_constant:
        return
    value = evaluate(node, scope)
    if isinstance(value, type(ast)):
        return
    yield f"{ast.unparse(node)} = {shown(value)}"


def is_true(node: ast.expr, scope: dict[str, Any]) -> bool:
    """Return True if an expression holds; one that raises does not."""
    value = evaluate(node, scope)
    return not isinstance(value, Raised) and bool(value)


class Raised:
    """What an expression raised when it was evaluated again."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def __repr__(self) -> str:
        return f"<raised {self.error!r}>"


def evaluate(node: ast.expr, scope: dict[str, Any]) -> Any:
    """Return the value of an expression, or the exception that it raised."""
    expression = ast.fix_missing_locations(ast.Expression(node))
    try:
        return eval(compile(expression, "<condition>", "eval"), scope)
    except Exception as error:  # any: this only explains a failure
        return Raised(error)


def shown(value: object) -> str:
    """Return a value as text of a few lines."""
    if isinstance(value, np.generic):
        value = value.item()
    with np.printoptions(threshold=40, precision=17):
        text = repr(value)
    if len(text) <= MAX_CHARACTERS:
        return text
    half = MAX_CHARACTERS // 2
    return f"{text[:half]} … {text[-half:]}"
