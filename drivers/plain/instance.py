"""The user's object, in the only process that has it. Its methods wait for the robot, so the caller runs
them in a thread with a deadline. They return an error text instead of raising."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Mapping
from typing import Any

from .class_location import load_class
from .config import PlainConfig
from .members import SENSED, failure_of, rows_of

_log = logging.getLogger("strands_actors")


class Instance:
    def __init__(self, config: PlainConfig) -> None:
        self._config = config
        self._class: type[Any] | None = None
        self._object: Any = None
        self._loop: Any = None
        self.sensed: dict[str, tuple[float, ...]] = {}
        """Numbers of the last observation, by topic and field (``imu.rpy``)."""

    @property
    def made(self) -> Any:
        """Return the object; None before ``connect`` and after ``cleanup``."""
        return self._object

    @property
    def observes(self) -> bool:
        """Return True if the class has ``get_observation``."""
        return callable(getattr(self._class, "get_observation", None))

    @property
    def has_channel(self) -> bool:
        """Return True if the class can stop its robot without an object."""
        return self._config.has_channel

    def load(self) -> str:
        """Import the class."""

        def run() -> None:
            self._class = self._class or load_class(self._config.location)

        return _attempt("import", run)

    def make(self) -> str:
        """Make the object, unless there is one. By the drivers page this does not touch the hardware."""

        def run() -> None:
            if self._object is None:
                assert self._class is not None
                self._object = self._class(**self._config.keywords)

        return self.load() or _attempt(self._config.name, run)

    def connect(self) -> str:
        """Make the object, and connect it by ``connect_eagerly``, or else by ``connect``."""
        return self.make() or _attempt("", self._connect)

    def _connect(self) -> str:
        eagerly = getattr(self._object, "connect_eagerly", None)
        if eagerly is not None:
            answer = self._call(eagerly)
            return answer if isinstance(answer, str) else failure_of(answer)
        connect = getattr(self._object, "connect", None)
        return "" if connect is None else failure_of(self._call(connect))

    def reconnect(self) -> str:
        """Connect an object again that reports that it is not connected, perhaps since its ``stop``."""
        return _attempt("", self._reconnect)

    def _reconnect(self) -> str:
        connected = getattr(self._object, "is_connected", True)
        if callable(connected):
            connected = self._call(connected)
        return "" if connected else self._connect()

    def observe(self) -> Mapping[str, Any] | str:
        """Return one observation, or the reason why there is no observation."""
        observed: Mapping[str, Any] = {}

        def run() -> str:
            nonlocal observed
            answer = self._call(self._object.get_observation)
            if not isinstance(answer, Mapping):
                return f"it returned {type(answer).__name__}, no mapping"
            if failure := failure_of(answer):
                return failure
            observed = answer
            self.sensed = {
                name: row
                for topic, attributes in SENSED.items()
                for name, row in rows_of(topic, self._sense(attributes)).items()
            }
            return "" if answer else "it is empty"

        return _attempt("get_observation", run) or observed if self.observes else {}

    def _sense(self, attributes: tuple[str, ...]) -> Any:
        """Return the first of these members that has a value. A member that raises is skipped, so that a
        failing sensor does not cost the positions."""
        for name in attributes:
            try:
                value = getattr(self._object, name, None)
            except Exception as error:  # a property of the user's code may raise anything
                _log.debug("%s.%s raised", self._config.name, name, exc_info=error)
                continue
            if value is not None:
                return value
        return None

    def send(self, action: Mapping[str, float]) -> str:
        """Give the object one action."""
        return _attempt("send_action", lambda: failure_of(self._call(self._object.send_action, dict(action))))

    def stop(self) -> str:
        """Stop the robot."""
        return _attempt("stop", lambda: failure_of(self._call(self._object.stop)))

    def hold(self) -> str:
        """Keep the robot where it is."""
        return _attempt("hold", lambda: failure_of(self._call(self._object.hold)))

    def stop_by_channel(self) -> str:
        """Stop the robot without an object: the class's own ``stop_channel(port)``."""

        def run() -> str:
            assert self._class is not None
            return failure_of(self._call(self._class.stop_channel, self._config.keywords.get("port", "")))

        return self.load() or _attempt("stop_channel", run)

    def cleanup(self) -> str:
        """Disconnect the robot, by ``cleanup``, or else ``disconnect``, or else ``close``."""
        given_up, self._object = self._object, None

        def run() -> str:
            for name in ("cleanup", "disconnect", "close"):
                if callable(function := getattr(given_up, name, None)):
                    return failure_of(self._call(function))
            return ""

        return "" if given_up is None else _attempt("cleanup", run)

    def _call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return the answer of a method. A coroutine is run to its end, always in the same loop."""
        answer = function(*args)
        if not inspect.isawaitable(answer):
            return answer
        import asyncio  # a class without coroutines is spared it

        async def wait() -> Any:
            return await answer

        self._loop = self._loop or asyncio.new_event_loop()
        return self._loop.run_until_complete(wait())


def _attempt(what: str, run: Callable[[], str | None]) -> str:
    """Run a call and return its error text, with the name of the method; empty for success.

    Args:
        what: A method of the class; empty for ``connect``, whose caller adds that name itself.
        run: The call. It returns an error text, or raises.
    """
    try:
        failure = run()
    except Exception as error:  # the user's code may raise anything
        _log.warning("%s raised", what or "connect", exc_info=error)
        failure = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{what}: {failure}" if what and failure else failure or ""
