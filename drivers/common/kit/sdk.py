"""Call a vendor's SDK in the process that talks to the robot. Each call that can block runs in a worker thread,
with a deadline.

A call that missed its deadline may still take effect later, unless the process ends. So it raises ``ProcessSpent``,
as does every later call, and the process must be replaced.
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
    """Import a vendor's SDK. Call it only in the process that talks to the robot.

    Args:
        module: The name of the module.
        install: The command that installs the SDK, for the message.

    Raises:
        WireDown: The SDK cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise WireDown(f"{module} cannot be used ({error}). {install}") from None


_kept: list[Any] = []


def kept() -> bool:
    """Return True if this process has constructed an SDK object that it must keep until its end (see
    ``construct``)."""
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
        """Return ``function(*args)``. The call cannot be interrupted, so a stop waits until it returns.

        Args:
            name: The name of the call for messages.
            deadline_s: Longest time of the call.
            function: Runs in a worker thread.
            args: The arguments of ``function``.

        Raises:
            ProcessSpent: The call failed, or did not return in time.
        """
        with trio.CancelScope() as waiting:
            waiting.shield = True
            return await self.open(name, deadline_s, function, *args)
        raise AssertionError("a shielded scope that nobody cancels was left")

    async def open(self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args) -> Result:
        """Return ``function(*args)`` as ``call`` does, for a constructor that moves nothing.

        A stop does not wait for this call, but cancels it. Afterwards this process can no longer use the SDK.
        """
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
            # The thread cannot be stopped, so the call may still take effect.
            self.spent = f"{self._name}: {name} was given up"
            raise

    async def construct(
        self, name: str, deadline_s: float, function: Callable[[*Args], Result], *args: *Args
    ) -> Result:
        """Construct an SDK object as ``open`` does, and keep it until the process ends. The destructor of the
        object may block all Python threads for half a second, or for ever."""
        constructed = None
        try:
            constructed = await self.open(name, deadline_s, function, *args)
        finally:
            # Keep the SDK object even if its constructor failed, because a part of it may exist.
            _kept.append(constructed)
        return constructed
