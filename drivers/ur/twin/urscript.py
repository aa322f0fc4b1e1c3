"""Run programs in a part of URScript: calls, assignments, ``while``, ``if`` and functions, without threads.

Any other statement is a compile error. Except for poses (``p[...]``), expressions of URScript are also valid
Python. So Python's parser reads them, and this module evaluates the syntax tree node by node. No text is ever
executed as Python.
"""

from __future__ import annotations

import ast
import inspect
import operator
import re
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

from .controller import Controller
from .functions import Functions, Pose, ScriptError, Waits
from .motion import Unreachable
from .requests import FUNCTIONS

STEPS_A_TICK = 200
"""Most statements that a program runs in one tick. After that it continues in the next tick."""

LONGEST_LINE = 10_000

LARGEST = 1e300

AT_ONCE = Waits(lambda: True)

_COMMENT = re.compile(r'("[^"]*")|#.*')
_ASSIGN = re.compile(r"(?:global\s+|local\s+)?([A-Za-z_]\w*)\s*((?:\[[^\]=]*\])?)\s*=(?!=)\s*(.+)", re.DOTALL)
_HEAD = re.compile(r"(def|sec|thread|while|if|elif|else|for)\b\s*(.*?):?$", re.DOTALL)
_FUNCTION = re.compile(r"([A-Za-z_]\w*)\s*\(([^)]*)\)")


class Statement(NamedTuple):
    line: int
    kind: str
    name: str = ""
    value: ast.expr | None = None
    blocks: tuple[tuple[ast.expr | None, tuple[Statement, ...]], ...] = ()
    names: tuple[str, ...] = ()


def parse(text: str) -> tuple[Statement, ...]:
    """Compile the text of a program to statements. Raise ``ScriptError`` if it does not compile."""
    lines = [_COMMENT.sub(lambda match: match.group(1) or "", line).strip() for line in text.split("\n")]
    parser = _Parser([(number, line) for number, line in enumerate(lines, 1) if line])
    try:
        return parser.whole()
    except RecursionError:
        raise ScriptError("blocks within blocks, too deep") from None


class _Parser:
    def __init__(self, lines: Sequence[tuple[int, str]]) -> None:
        self._lines = lines
        self._index = 0

    def whole(self) -> tuple[Statement, ...]:
        """Parse the whole text. If it is only one function, return the statements in this function."""
        statements = self._block(top=True)
        if len(statements) == 1 and statements[0].kind == "def":
            return statements[0].blocks[0][1]
        return statements

    def _block(self, top: bool = False) -> tuple[Statement, ...]:
        statements: list[Statement] = []
        while self._index < len(self._lines):
            number, line = self._lines[self._index]
            word = line.split(maxsplit=1)[0].rstrip(":")
            if word in ("end", "elif", "else") and not top:
                return tuple(statements)
            self._index += 1
            statements.append(self._statement(number, line))
        if not top:
            raise ScriptError(f"line {self._lines[-1][0]}: an end is missing")
        return tuple(statements)

    def _statement(self, number: int, line: str) -> Statement:
        if len(line) > LONGEST_LINE:
            raise ScriptError(f"line {number}: longer than {LONGEST_LINE} characters")
        head = _HEAD.fullmatch(line)
        if head is not None:
            return self._compound(number, head.group(1), head.group(2).strip())
        if line in ("break", "continue", "pass"):
            return Statement(number, line)
        if line == "halt":
            return Statement(number, "return")
        if line.split(maxsplit=1)[0] == "return":
            rest = line.removeprefix("return").strip()
            return Statement(number, "return", value=_expression(number, rest) if rest else None)
        assignment = _ASSIGN.fullmatch(line)
        if assignment is not None:
            name, place, value = assignment.groups()
            index = _expression(number, place[1:-1]) if place else None
            return Statement(number, "assign", name, _expression(number, value), ((index, ()),))
        return Statement(number, "call", value=_expression(number, line))

    def _compound(self, number: int, word: str, rest: str) -> Statement:
        if word in ("def", "sec"):
            match = _FUNCTION.fullmatch(rest)
            if match is None:
                raise ScriptError(f"line {number}: {word} needs a name and parentheses")
            names = tuple(name.strip() for name in match.group(2).split(",") if name.strip())
            return Statement(number, "def", match.group(1), blocks=((None, self._ended(number)),), names=names)
        if word == "while":
            return Statement(number, "while", blocks=((_expression(number, rest), self._ended(number)),))
        if word == "if":
            blocks: list[tuple[ast.expr | None, tuple[Statement, ...]]] = []
            blocks.append((_expression(number, rest), self._block()))
            while (
                self._index < len(self._lines)
                and (head := _HEAD.fullmatch(self._lines[self._index][1])) is not None
            ):
                self._index += 1
                condition = _expression(number, head.group(2).strip()) if head.group(1) == "elif" else None
                blocks.append((condition, self._block()))
            self._take_end(number)
            return Statement(number, "if", blocks=tuple(blocks))
        raise ScriptError(f"line {number}: {word} is not available on this controller")

    def _ended(self, number: int) -> tuple[Statement, ...]:
        block = self._block()
        self._take_end(number)
        return block

    def _take_end(self, number: int) -> None:
        if self._index >= len(self._lines) or self._lines[self._index][1] != "end":
            raise ScriptError(f"line {number}: an end is missing")
        self._index += 1


def _expression(number: int, text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ScriptError(f"line {number}: syntax error in {text[:60]!r}") from None


# -- running a parsed program


class _Return(Exception):
    def __init__(self, value: Any) -> None:
        super().__init__()
        self.value = value


class _Break(Exception):
    pass


class _Continue(Exception):
    pass


_ARITHMETIC: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_NUMBERS = (int, float, bool)


class Script:
    """A running program. It ends after its last line, or at an error, which is written into the controller's
    log."""

    def __init__(
        self,
        controller: Controller,
        statements: Sequence[Statement],
        on_progress: Callable[[int], None] | None = None,
    ) -> None:
        self._controller = controller
        self._functions = Functions(controller, on_progress)
        self._signatures: dict[str, inspect.Signature] = {}
        """Signatures of functions that were already called, to save time if a loop calls them in each tick."""
        self._defined: dict[str, Statement] = {}
        self._globals: dict[str, Any] = {}
        self._run = self._block(statements, self._globals)
        self._waits: Waits | None = None
        self._remaining_steps = STEPS_A_TICK

    def react_to_inputs(self) -> None:
        """Do nothing, because the program reads a register only when it runs a line that does so."""

    def step(self) -> None:
        try:
            over = self.advance()
        except Unreachable as unreachable:
            self._controller.protect(str(unreachable))
        except ScriptError as error:
            self._controller.fail(str(error))
        else:
            if over and self._controller.program is self:
                self._controller.stop_program()

    def advance(self) -> bool:
        """Run the program until a line has to wait, or until its end. Return True if it has ended.

        Raises:
            ScriptError: A line cannot be run.
            Unreachable: The arm cannot make a requested motion.
        """
        if self._waits is not None and not self._waits():
            return False
        self._remaining_steps = STEPS_A_TICK
        try:
            self._waits = next(self._run)
        except StopIteration:
            return True
        except _Return:
            return True
        except (_Break, _Continue):
            raise ScriptError("break or continue outside a loop") from None
        return False

    def _block(self, statements: Sequence[Statement], names: dict[str, Any]) -> Generator[Waits, None, None]:
        for statement in statements:
            self._remaining_steps -= 1
            if self._remaining_steps < 0:
                yield AT_ONCE
            if statement.kind != "pass":
                self._controller.program_line = statement.line
            try:
                yield from self._run_statement(statement, names)
            except (TypeError, ValueError, ArithmeticError, LookupError, RecursionError) as error:
                raise ScriptError(f"line {statement.line}: {error or type(error).__name__}") from None

    def _run_statement(self, statement: Statement, names: dict[str, Any]) -> Generator[Waits, None, None]:
        match statement.kind:
            case "def":
                self._defined[statement.name] = statement
            case "assign":
                self._assign(statement, names)
            case "return":
                raise _Return(None if statement.value is None else self._value(statement.value, names))
            case "break":
                raise _Break
            case "continue":
                raise _Continue
            case "while":
                yield from self._while(statement, names)
            case "if":
                for condition, block in statement.blocks:
                    if condition is None or self._value(condition, names):
                        yield from self._block(block, names)
                        break
            case "call":
                yield from self._call(statement, names)

    def _while(self, statement: Statement, names: dict[str, Any]) -> Generator[Waits, None, None]:
        ((condition, block),) = statement.blocks
        assert condition is not None
        while self._value(condition, names):
            self._remaining_steps -= 1
            if self._remaining_steps < 0:
                yield AT_ONCE
            try:
                yield from self._block(block, names)
            except _Break:
                return
            except _Continue:
                continue

    def _assign(self, statement: Statement, names: dict[str, Any]) -> None:
        assert statement.value is not None
        value, index = self._value(statement.value, names), statement.blocks[0][0]
        if index is None:
            (names if statement.name not in self._globals else self._globals)[statement.name] = value
        elif statement.name in (
            "digital_out",
            "analog_out",
        ):  # Old scripts set an output like ``digital_out[1]=True``.
            getattr(self._functions, f"set_{statement.name}")(self._value(index, names), value)
        else:
            self._name(statement.name, names)[self._value(index, names)] = value

    def _call(self, statement: Statement, names: dict[str, Any]) -> Generator[Waits, None, None]:
        node = statement.value
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in self._defined:
            function = self._defined[node.func.id]
            values = [self._value(argument, names) for argument in node.args]
            if len(values) != len(function.names):
                raise ScriptError(f"line {statement.line}: {function.name} takes {len(function.names)} values")
            try:
                yield from self._block(function.blocks[0][1], dict(zip(function.names, values, strict=True)))
            except _Return:
                return
            return
        assert node is not None
        waits = self._value(node, names)
        if isinstance(waits, Waits):
            yield waits

    # -- values of expressions

    def _value(self, node: ast.expr, names: dict[str, Any]) -> Any:
        match node:
            case ast.Constant(value=bool() | int() | float() | str() as value):
                return value
            case ast.Name(id=name):
                return self._name(name, names)
            case ast.List(elts=parts):
                return [self._value(part, names) for part in parts]
            case ast.Tuple(elts=parts):
                return [self._value(part, names) for part in parts]
            case ast.Subscript(value=ast.Name(id="p"), slice=ast.Tuple(elts=parts)):
                return Pose(self._value(part, names) for part in parts)
            case ast.Subscript(value=of, slice=index):
                return self._value(of, names)[self._value(index, names)]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._value(operand, names)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return +self._value(operand, names)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return not self._value(operand, names)
            case ast.BoolOp(op=op, values=parts):
                return (all if isinstance(op, ast.And) else any)(self._value(part, names) for part in parts)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
                first, second = self._value(left, names), self._value(right, names)
                if not (isinstance(first, _NUMBERS) and isinstance(second, _NUMBERS)):
                    raise TypeError("both sides of an arithmetic operator must be numbers")
                result = _ARITHMETIC[type(op)](first, second)
                if not -LARGEST <= result <= LARGEST:
                    raise ArithmeticError("a number too large")
                return result
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _ARITHMETIC:
                return _ARITHMETIC[type(op)](self._value(left, names), self._value(right, names))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=keywords):
                return self._called(name, arguments, keywords, names)
        raise ScriptError("an expression that is not available on this controller")

    def _called(
        self, name: str, arguments: Sequence[ast.expr], keywords: Sequence[ast.keyword], names: dict[str, Any]
    ) -> Any:
        function = getattr(self._functions, name) if name in FUNCTIONS else None
        if function is None:
            raise ScriptError(f"{name} is not available on this controller")
        if name not in self._signatures:
            self._signatures[name] = inspect.signature(function)
        bound = self._signatures[name].bind(
            *(self._value(argument, names) for argument in arguments),
            **{keyword.arg or "": self._value(keyword.value, names) for keyword in keywords},
        )
        return function(*bound.args, **bound.kwargs)

    def _name(self, name: str, names: dict[str, Any]) -> Any:
        for scope in (names, self._globals, _CONSTANTS):
            if name in scope:
                return scope[name]
        raise ScriptError(f"{name} is not defined")


_CONSTANTS = {"true": True, "false": False}
