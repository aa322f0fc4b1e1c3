"""Calls into a vendor's SDK, in the wire process. Each call that can wait runs in a worker thread, with a
deadline.

A call that missed its deadline may still take effect later. Only the end of the process prevents that.
So it raises ``ProcessSpent``, and so does every later call.
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
    """Import an SDK. Call it in the wire process only.

    Args:
        module: The name of the module.
        install: The line that installs it, for the message.

    Raises:
        WireDown: It cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise WireDown(f"{module} cannot be used ({error}). {install}") from None


_kept: list[Any] = []


def kept() -> bool:
    """Return True if this process has constructed an interface of an SDK."""
    return bool(_kept)


class SdkCalls:
    """The calls of one SDK in this process.

    Args:
        name: The name of the SDK for messages.
        errors: The exceptions that its calls raise.
    """

    def __init__(self, name: str, errors: tuple[type[Exception], ...]) -> None:
        self._name = name
        self._errors = errors
        self.spent = ""
        """Why this process can no longer use the SDK; empty if it can."""

    async def call(self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args) -> Result:
        """Return ``function(*args)``. A call cannot be abandoned, so a stop waits for it.

        Args:
            name: The name of the call for messages.
            deadline_s: Longest time of the call.
            function: Runs in a worker thread.
            args: Its arguments.

        Raises:
            ProcessSpent: It failed, or did not return in time.
        """
        with trio.CancelScope() as waiting:
            waiting.shield = True
            return await self.open(name, deadline_s, function, *args)
        raise AssertionError("a shielded scope that nobody cancels was left")

    async def open(self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args) -> Result:
        """As ``call``, for a constructor that moves nothing. A stop does not wait for it; it then gives
        up the call, and with it this process."""
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
            self.spent = f"{self._name}: {name} was given up"  # The thread continues all the same.
            raise

    async def construct(
        self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args
    ) -> Result:
        """As ``open``, for an interface that is kept until the process ends. Its destructor may hold the
        interpreter's lock, for half a second or for ever."""
        constructed = None
        try:
            constructed = await self.open(name, deadline_s, function, *args)
        finally:
            _kept.append(constructed)  # A failed constructor may leave a part of it, too.
        return constructed
