"""The errors with which the simulated base answers a call, or ends an action."""

from __future__ import annotations

from strands_actors.drivers.kinova.protocol import ERROR_OF_DEVICE, ERROR_OF_SERVER, SubError


class CallFailed(Exception):
    """Raised in the simulated base if it must answer a call with an error, or end an action with it."""

    def __init__(self, sub_error: SubError, text: str = "", code: int = ERROR_OF_DEVICE) -> None:
        """Args:
        sub_error: The reason.
        text: The description that the client shows. By default it is the name of the reason.
        code: The part that failed: the arm, or the protocol.
        """
        super().__init__(text or sub_error.name)
        self.sub_error = sub_error
        self.code = code


class ProtocolFailed(CallFailed):
    """The error of a request that does not reach the arm: an unknown function, session or user."""

    def __init__(self, sub_error: SubError, text: str = "") -> None:
        super().__init__(sub_error, text, ERROR_OF_SERVER)
