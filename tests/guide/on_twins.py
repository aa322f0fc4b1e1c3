"""Change an example for a real robot so that it runs on the robot's twin, and check the answers of its calls.

Two things change. ``Robot(..., port="192.0.2.10")`` and ``Teleoperator(..., port=...)`` get ``transport="twin"`` in
place of the port. A statement that is a call, such as ``arm.stand()``, fails if its answer is an error.
"""

from __future__ import annotations

import ast
from typing import Any

CHECK = "_answered"
CLASSES = {"Robot", "Teleoperator"}


class _OnTwins(ast.NodeTransformer):
    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        given = {keyword.arg for keyword in node.keywords}
        is_real = "port" in given or any(
            keyword.arg == "mode" and isinstance(keyword.value, ast.Constant) and keyword.value.value == "real"
            for keyword in node.keywords
        )
        if isinstance(node.func, ast.Name) and node.func.id in CLASSES and is_real:
            kept = [keyword for keyword in node.keywords if keyword.arg not in ("port", "transport")]
            node.keywords = [*kept, ast.keyword("transport", ast.Constant("twin"))]
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.value, ast.Call):
            node.value = ast.Call(ast.Name(CHECK, ast.Load()), [node.value], [])
        return node


def on_twins(source: str) -> ast.Module:
    """Return an example as a module that runs on twins."""
    return ast.fix_missing_locations(_OnTwins().visit(ast.parse(source)))


def answered(answer: Any) -> Any:
    """Return the answer of a call.

    Raises:
        RuntimeError: It is an error.
    """
    if isinstance(answer, dict) and answer.get("status", "success") != "success":
        raise RuntimeError(answer)
    return answer
