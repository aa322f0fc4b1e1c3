"""Make a program from the text that a client has sent to a script port.

The text is a ``stopj``, the control script of ur-rtde (which is imitated), or any text that ``urscript`` can run.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from . import commands as c
from .control_script import ControlScript
from .controller import Controller, Program
from .functions import ScriptError
from .urscript import Script, parse

_OFFSET = re.compile(rb"reg_offset_int = # int register offset\s*(\d+)")
_CONTROL = b"def rtde_control()"
_PATH = re.compile(rb"# inject move path\n(.*?)^\s*end", re.MULTILINE | re.DOTALL)


def run_text(text: bytes, controller: Controller) -> None:
    """Run a text that was sent to a script port.

    If the text does not compile, nothing is started, and the reason is written into the controller's log.
    """
    try:
        make = program_of(text, controller)
    except ScriptError as error:
        controller.note(f"compile error: {error}")
        return
    if text.lstrip().startswith(b"sec "):
        controller.run_secondary(make)
    else:
        controller.start_program(make)


def program_of(text: bytes, controller: Controller) -> Callable[[], Program]:
    """Compile a text. Return a function that starts it as a program. Raise ``ScriptError`` if it does not
    compile."""
    if c.classify_script(text) == "safe":
        return lambda: Halting(controller)
    if _CONTROL in text:
        offset_match, path = _OFFSET.search(text), _PATH.search(text)
        offset = int(offset_match.group(1)) if offset_match else 0
        moves = parse(path.group(1).decode("utf-8", "replace")) if path else ()
        return lambda: ControlScript(controller, offset, moves)
    statements = parse(text.decode("utf-8", "replace"))
    return lambda: Script(controller, statements)


class Standing:
    """A program that does nothing until it is stopped."""

    def react_to_inputs(self) -> None:
        pass

    def step(self) -> None:
        pass


class Halting(Standing):
    """The program ``stopj``. It stops the arm, and ends when the arm stands still."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        controller.halt()

    def step(self) -> None:
        if self._controller.is_steady():
            self._controller.stop_program()
