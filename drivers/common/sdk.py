"""Calls into a vendor's SDK, in the wire process: each that can wait in a worker thread, with a
deadline.

A call that missed its deadline may still do what it was told, later. Nothing less than the end of
the process keeps it from that, so it raises ``ProcessSpent``, and so does every call after it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple

import trio

from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.kernel.threads import call_in_thread

Args = TypeVarTuple("Args")
Result = TypeVar("Result")


def load_sdk(module: str, install: str) -> Any:
    """Import an SDK; only ever called in the wire process. Raise ``WireDown`` with the line that
    installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise WireDown(f"{module} cannot be used ({error}). {install}") from None


_kept: list[Any] = []


def kept() -> bool:
    """Return whether this process has constructed an interface of an SDK."""
    return bool(_kept)


class SdkCalls:
    """One SDK in this process. ``errors``: the exceptions its calls fail with."""

    def __init__(self, name: str, errors: tuple[type[Exception], ...]) -> None:
        self._name = name
        self._errors = errors
        self.spent = ""
        """Why this process can use the SDK no more; empty: it can."""

    async def call(self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args) -> Result:
        """Return ``function(*args)``. A stop waits for it, at most ``deadline_s``: a call cannot be
        abandoned. Raise ``ProcessSpent`` when it fails or does not return in time."""
        with trio.CancelScope() as waiting:
            waiting.shield = True
            return await self.open(name, deadline_s, function, *args)
        raise AssertionError("a shielded scope that nobody cancels was left")

    async def open(self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args) -> Result:
        """As ``call``, of a constructor that moves nothing: a stop does not wait for it, and it is
        then given up, and this process with it."""
        if self.spent:
            raise ProcessSpent(self.spent)
        try:
            with trio.fail_after(deadline_s):
                return await call_in_thread(function, *args)
        except trio.TooSlowError:
            self.spent = f"{self._name}: {name} did not return within {deadline_s * 1e3:g} ms"
            raise ProcessSpent(self.spent) from None
        except self._errors as error:
            self.spent = f"{self._name}: {name} failed ({error})"
            raise ProcessSpent(self.spent) from None
        except trio.Cancelled:
            self.spent = f"{self._name}: {name} was given up"  # it goes on all the same
            raise

    async def construct(
        self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args
    ) -> Result:
        """As ``open``, of an interface that is kept until the process ends: its destructor may hold
        the interpreter's lock, for half a second or for ever."""
        constructed = None
        try:
            constructed = await self.open(name, deadline_s, function, *args)
        finally:
            _kept.append(constructed)  # half of one that failed may be there, too
        return constructed
