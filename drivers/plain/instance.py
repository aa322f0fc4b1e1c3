"""Make, keep and call the object of the user's driver class, in the only process that has one.

The methods of ``Instance`` call the object and wait for it. The caller runs them in a thread with a timeout. They
return an error text and raise no exception.
"""

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
        """Sensor values of the last observation, by topic and field (``imu.rpy``)."""

    @property
    def made(self) -> Any:
        """Return the object of the class; None before ``connect`` and after ``cleanup``."""
        return self._object

    @property
    def observes(self) -> bool:
        """Return True if the class has the method ``get_observation``."""
        return callable(getattr(self._class, "get_observation", None))

    @property
    def has_channel(self) -> bool:
        """Return True if the class can stop its robot without an object."""
        return self._config.has_channel

    def load(self) -> str:
        """Import the class. Return an error text; empty for success."""

        def run() -> None:
            self._class = self._class or load_class(self._config.location)

        return _attempt("import", run)

    def make(self) -> str:
        """Make the object, unless it exists. By the rules of ``docs/drivers.md`` this does not touch the hardware.
        Return an error text; empty for success."""

        def run() -> None:
            if self._object is None:
                assert self._class is not None
                self._object = self._class(**self._config.keywords)

        return self.load() or _attempt(self._config.name, run)

    def connect(self) -> str:
        """Make the object and call its ``connect_eagerly``, or its ``connect``. Return an error text; empty for
        success."""
        return self.make() or _attempt("", self._connect)

    def _connect(self) -> str:
        eagerly = getattr(self._object, "connect_eagerly", None)
        if eagerly is not None:
            answer = self._call(eagerly)
            return answer if isinstance(answer, str) else failure_of(answer)
        connect = getattr(self._object, "connect", None)
        return "" if connect is None else failure_of(self._call(connect))

    def reconnect(self) -> str:
        """Connect the object again if its ``is_connected`` is false, for example after a stop. Return an error
        text; empty for success."""
        return _attempt("", self._reconnect)

    def _reconnect(self) -> str:
        connected = getattr(self._object, "is_connected", True)
        if callable(connected):
            connected = self._call(connected)
        return "" if connected else self._connect()

    def observe(self) -> Mapping[str, Any] | str:
        """Return one observation, or an error text if there is no observation."""
        observed: Mapping[str, Any] = {}

        def run() -> str:
            nonlocal observed
            answer = self._call(self._object.get_observation)
            if not isinstance(answer, Mapping):
                return f"it returned {type(answer).__name__} and not a mapping"
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
        """Return the first value of these attributes that is not None. An attribute that raises is skipped, so
        that a failing sensor does not spoil the whole observation."""
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
        """Pass one action to the object. Return an error text; empty for success."""
        return _attempt("send_action", lambda: failure_of(self._call(self._object.send_action, dict(action))))

    def stop(self) -> str:
        """Call ``stop`` of the object. Return an error text; empty for success."""
        return _attempt("stop", lambda: failure_of(self._call(self._object.stop)))

    def hold(self) -> str:
        """Call ``hold`` of the object, which keeps the robot at its position. Return an error text; empty for
        success."""
        return _attempt("hold", lambda: failure_of(self._call(self._object.hold)))

    def stop_by_channel(self) -> str:
        """Stop the robot without an object, by the class's ``stop_channel(port)``. Return an error text; empty for
        success."""

        def run() -> str:
            assert self._class is not None
            return failure_of(self._call(self._class.stop_channel, self._config.keywords.get("port", "")))

        return self.load() or _attempt("stop_channel", run)

    def cleanup(self) -> str:
        """Call ``cleanup``, ``disconnect`` or ``close`` of the object, the first that it has. Return an error
        text; empty for success."""
        driver_object, self._object = self._object, None

        def run() -> str:
            for name in ("cleanup", "disconnect", "close"):
                if callable(function := getattr(driver_object, name, None)):
                    return failure_of(self._call(function))
            return ""

        return "" if driver_object is None else _attempt("cleanup", run)

    def _call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Call a method and return its result. A coroutine runs until it is done, always in the same event loop."""
        answer = function(*args)
        if not inspect.isawaitable(answer):
            return answer
        # Import asyncio only for a class that has coroutines.
        import asyncio

        async def wait() -> Any:
            return await answer

        self._loop = self._loop or asyncio.new_event_loop()
        return self._loop.run_until_complete(wait())


def _attempt(method: str, run: Callable[[], str | None]) -> str:
    """Run a call and return its error text with the name of the method. The text is empty for success.

    Args:
        method: Name of the method. It is empty for ``connect``, since the caller of ``connect`` adds the name.
        run: The call. It returns an error text, or raises an exception.
    """
    try:
        failure = run()
    except Exception as error:  # the user's code may raise anything
        _log.warning("%s raised", method or "connect", exc_info=error)
        failure = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{method}: {failure}" if method and failure else failure or ""
