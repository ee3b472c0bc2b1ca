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
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

#: Folder of the code whose loops are shown; pytest and the package have loops of their own.
TESTS = Path(__file__).parents[1]

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
        node: The condition. Operands of ``and`` that hold are left out.
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
    elif isinstance(node, ast.IfExp):
        yield from value_of(node.test, scope)
        yield from describe(node.body if is_true(node.test, scope) else node.orelse, scope)
    elif is_over_entries(node):
        yield from describe_entries(node, scope)
    elif isinstance(node, ast.Call):
        if not isinstance(evaluate(node, scope), bool | np.bool_):  # as in ``not warnings()``
            yield from value_of(node, scope)
        if isinstance(node.func, ast.Attribute):
            yield from value_of(node.func.value, scope)
        for operand in node.args:
            yield from value_of(operand, scope)
    else:
        yield from value_of(node, scope)


def loop_variables(frame: FrameType) -> list[str]:
    """Return the values of the variables of all loops in which a check is called, one a line.

    These are the ``for`` loops around the call, in its function and in the functions that call it,
    up to the test. They show which case of a loop fails.

    Args:
        frame: Frame that calls the check.
    """
    lines: list[str] = []
    for level in frames_up_to_test(frame):
        for loop in loops_of(level.f_code.co_filename):
            is_inside = loop.body[0].lineno <= level.f_lineno <= (loop.body[-1].end_lineno or 0)
            if is_inside:
                names = [part.id for part in ast.walk(loop.target) if isinstance(part, ast.Name)]
                known = [name for name in names if name in level.f_locals]
                lines += [f"{name} = {shown(level.f_locals[name])}" for name in known]
    return list(dict.fromkeys(lines))  # in order, each once


def frames_up_to_test(frame: FrameType) -> Iterator[FrameType]:
    """Yield a frame and those that have called it, up to that of the test, if they are of tests."""
    level: FrameType | None = frame
    while level is not None:
        if TESTS in Path(level.f_code.co_filename).parents:
            yield level
            if level.f_code.co_name.startswith("test_"):
                return
        level = level.f_back


@functools.cache
def loops_of(filename: str) -> list[ast.For]:
    """Return all ``for`` loops in a file, an outer one before those in it."""
    tree = ast.parse("".join(linecache.getlines(filename)))
    return [node for node in ast.walk(tree) if isinstance(node, ast.For)]


def is_over_entries(node: ast.expr) -> bool:
    """Return True for ``np.all(array)`` and ``array.all()``, and the same with any."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    return node.func.attr in ("all", "any") and len(node.args) == int(is_of_numpy(node))


def is_of_numpy(node: ast.Call) -> bool:
    """Return True for ``np.function(…)``."""
    assert isinstance(node.func, ast.Attribute)
    return isinstance(node.func.value, ast.Name) and node.func.value.id == "np"


def describe_entries(node: ast.expr, scope: dict[str, Any]) -> Iterator[str]:
    """Yield the array, or both sides of a comparison and the first entry that decides it.

    For ``all`` that is the first entry where the comparison is false. For ``any`` it is the first
    one where it is true, because the condition is then ``not any(…)``.

    Args:
        node: A call of :func:`is_over_entries`.
        scope: Values of the names in it.
    """
    assert isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    entries = node.args[0] if is_of_numpy(node) else node.func.value
    if not isinstance(entries, ast.Compare) or len(entries.comparators) > 1:
        yield from value_of(entries, scope)
        return
    sides = [entries.left, *entries.comparators]
    values = [evaluate(side, scope) for side in sides]
    flags = np.asarray(evaluate(entries, scope))
    is_cause = node.func.attr == "any"
    places = np.argwhere(flags == is_cause)
    if flags.dtype == bool and len(places):
        place = ", ".join(str(int(i)) for i in places[0])
        count = f"{len(places)} of {flags.size} entries"
        yield f"{is_cause} for {count}, the first of which is [{place}]"
        for side, value in zip(sides, values, strict=True):
            entry = np.broadcast_to(value, flags.shape)[tuple(places[0])]
            yield f"({ast.unparse(side)})[{place}] = {shown(entry)}"
    for side in sides:
        yield from value_of(side, scope)


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
    """Yield a line with an expression and its value, unless it is a constant or a module."""
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
