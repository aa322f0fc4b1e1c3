"""Run a command with no more rights than an ordinary user has, also when the tests run as root.

A serial port that is locked (TIOCEXCL, as rustypot does it) can still be opened by root, so tests that run as root
would not notice that another process cannot open it. The command keeps root's user id, because the interpreter may
lie in root's home, and loses all capabilities. Without them the kernel checks root like any other user.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

DROP = ("setpriv", "--bounding-set=-all", "--inh-caps=-all", "--no-new-privs", "--")
"""util-linux has this program."""


def as_ordinary_user(command: Sequence[str]) -> list[str]:
    """Return the command that runs ``command`` so."""
    return [*(DROP if os.geteuid() == 0 else ()), *command]
