"""Make small mistakes in Python source. This module is pure: text in, texts out.

mutation     before                       after
delay        async def make_safe(): ...   its first statement waits for 0.3 s
skip         self._write(frame)           pass
turn         if late:                     if not (late):
edge         now >= until                 now > until
swap         a and b                      a or b
flip         return True                  return False
let through  return Refused(...)          return None
off by one   epoch + 1                    epoch
forget one   for axis in axes:            for axis in list(axes)[1:]:
drop         {row: ..., row: ...}         a row of a table is gone
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from typing import NamedTuple

DELAY_S = 0.3
_EDGES: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.In: "not in",
    ast.NotIn: "in",
    ast.Is: "is not",
    ast.IsNot: "is",
}
_LOGS = ("_log", "note", "_tell_decided", "audit")
"""Calls that only inform people. They are not mutated."""


class Mutation(NamedTuple):
    """One mistake.

    Attributes:
        kind: The kind of mutation, as in the table above.
        function: The function with its class, or ``table``.
        line: The line in the file.
        before: The original code in one line.
        after: The wrong code in one line.
        source: The whole file with the mistake.
    """

    kind: str
    function: str
    line: int
    before: str
    after: str
    source: str

    @property
    def key(self) -> str:
        """Return a name that stays the same when other lines change."""
        return f"{self.kind} | {self.function} | {self.before} | {self.after}"


class _Edit(NamedTuple):
    kind: str
    node: ast.AST
    after: str


def mutations(source: str, functions: Collection[str] = ()) -> Iterator[Mutation]:
    """Return every mutation of a file.

    Args:
        source: The file.
        functions: Names of the functions that are mutated. Empty for all, and the tables of the file.
    """
    data = source.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    seen: set[tuple[int, int, str]] = set()
    for where, edit in _edits(ast.parse(source), functions):
        node = edit.node
        assert isinstance(node, ast.expr | ast.stmt)
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        if (begin, end, edit.after) in seen:
            continue
        seen.add((begin, end, edit.after))
        before = data[begin:end].decode()
        after = edit.after.replace("\n", "\n" + " " * node.col_offset)
        mutated = data[:begin] + after.encode() + data[end:]
        shown = " ".join(before.split())[:90], " ".join(after.split())[:90]
        yield Mutation(edit.kind, where, node.lineno, *shown, mutated.decode())


def _edits(tree: ast.Module, functions: Collection[str]) -> Iterator[tuple[str, _Edit]]:
    def visit(body: list[ast.stmt], inside: str) -> Iterator[tuple[str, _Edit]]:
        for node in body:
            if isinstance(node, ast.ClassDef):
                yield from visit(node.body, f"{inside}{node.name}.")
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                if not functions or node.name in functions:
                    for edit in _in_function(node):
                        yield f"{inside}{node.name}", edit
            elif not functions and isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                for edit in _rows(node.value):
                    yield inside or "table", edit

    yield from visit(tree.body, "")


def _rows(value: ast.expr) -> Iterator[_Edit]:
    """Return one edit for each row of a table, which removes that row."""
    if isinstance(value, ast.Dict) and len(value.values) > 1:
        for index in range(len(value.values)):
            fewer = ast.Dict(
                [key for number, key in enumerate(value.keys) if number != index],
                [row for number, row in enumerate(value.values) if number != index],
            )
            yield _Edit("drop", value, ast.unparse(fewer))
    called = isinstance(value, ast.Call) and len(value.args) == 1
    rows = value.args[0] if called and isinstance(value, ast.Call) else value
    if isinstance(rows, ast.Set) and len(rows.elts) > 1:
        for at in range(len(rows.elts)):
            yield _Edit("drop", rows, ast.unparse(ast.Set([row for n, row in enumerate(rows.elts) if n != at])))


def _in_function(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[_Edit]:
    body = function.body
    first = body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        body = body[1:]
    if isinstance(function, ast.AsyncFunctionDef) and body and not _is_nothing(body[0]):
        wait = f"import trio as _late; await _late.sleep({DELAY_S})\n{ast.unparse(body[0])}"
        yield _Edit("delay", body[0], wait)
    may_be_none = function.returns is not None and "None" in ast.unparse(function.returns)
    for node in ast.walk(function):
        yield from _of_node(node, may_be_none)


def _of_node(node: ast.AST, may_be_none: bool) -> Iterator[_Edit]:
    match node:
        case ast.Expr(value=ast.Call() | ast.Await()) if not _tells_people(node):
            yield _Edit("skip", node, "pass")
        case ast.Assign(targets=[ast.Attribute()]) | ast.AugAssign(target=ast.Attribute()):
            yield _Edit("skip", node, "pass")
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if not (isinstance(test, ast.Constant) or _binds(test)):
                yield _Edit("turn", test, f"not ({ast.unparse(test)})")
        case ast.Compare(left=left, ops=[op], comparators=[right]) if not _binds(node):
            yield _Edit("edge", node, f"{ast.unparse(left)} {_EDGES[type(op)]} {ast.unparse(right)}")
        case ast.BoolOp(op=op, values=values) if not _binds(node):
            word = " or " if isinstance(op, ast.And) else " and "
            yield _Edit("swap", node, f"({word.join(f'({ast.unparse(value)})' for value in values)})")
        case ast.Return(value=ast.Constant(value=bool(value))):
            yield _Edit("flip", node, f"return {not value}")
        case ast.Return(value=ast.Call(func=ast.Name(id="Refused"))) if may_be_none:
            yield _Edit("let through", node, "return None")
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=ast.Constant(value=1)):
            yield _Edit("off by one", node, ast.unparse(left))
        case ast.For(iter=rows):
            yield _Edit("forget one", rows, f"list({ast.unparse(rows)})[1:]")
        case _:
            return


def _binds(node: ast.AST) -> bool:
    """Return whether an expression binds a name or has an f-string. ``ast.unparse`` might change it."""
    return any(isinstance(each, ast.NamedExpr | ast.JoinedStr) for each in ast.walk(node))


def _is_nothing(node: ast.stmt) -> bool:
    return isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))


def _tells_people(node: ast.Expr) -> bool:
    call = node.value.value if isinstance(node.value, ast.Await) else node.value
    if not isinstance(call, ast.Call):
        return False
    function = call.func
    while isinstance(function, ast.Attribute):
        if function.attr in _LOGS:
            return True
        function = function.value
    return isinstance(function, ast.Name) and function.id in _LOGS
