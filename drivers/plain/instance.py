"""The user's object, in the one process that has it. Its methods wait for the robot: they are
called in a thread, by somebody who keeps the time, and answer with what went wrong instead of
raising it."""

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
        """Of the last observation: topic and field, ``imu.rpy``, to numbers."""

    @property
    def made(self) -> Any:
        """Return the object; None before ``connect`` and after ``cleanup``."""
        return self._object

    @property
    def observes(self) -> bool:
        """Return whether the class measures anything."""
        return callable(getattr(self._class, "get_observation", None))

    @property
    def has_channel(self) -> bool:
        """Return whether the class can stop its robot without an object."""
        return self._config.has_channel

    def load(self) -> str:
        """Import the class."""

        def run() -> None:
            self._class = self._class or load_class(self._config.location)

        return _told("import", run)

    def make(self) -> str:
        """Make the object, unless there is one; the page's classes touch no hardware there."""

        def run() -> None:
            if self._object is None:
                assert self._class is not None
                self._object = self._class(**self._config.keywords)

        return self.load() or _told(self._config.name, run)

    def connect(self) -> str:
        """Make the object, and connect it by ``connect_eagerly``, else ``connect``."""
        return self.make() or _told("", self._connect)

    def _connect(self) -> str:
        eagerly = getattr(self._object, "connect_eagerly", None)
        if eagerly is not None:
            answer = self._call(eagerly)
            return answer if isinstance(answer, str) else failure_of(answer)
        connect = getattr(self._object, "connect", None)
        return "" if connect is None else failure_of(self._call(connect))

    def reconnect(self) -> str:
        """Connect an object that says it is not connected any more, after its own ``stop``
        perhaps."""
        return _told("", self._reconnect)

    def _reconnect(self) -> str:
        connected = getattr(self._object, "is_connected", True)
        if callable(connected):
            connected = self._call(connected)
        return "" if connected else self._connect()

    def observe(self) -> Mapping[str, Any] | str:
        """Return one observation, or why there is none."""
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

        return _told("get_observation", run) or observed if self.observes else {}

    def _sense(self, attributes: tuple[str, ...]) -> Any:
        """Return the first of these members that has a value. One that raises has none: a sensor
        that fails must not take the positions with it."""
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
        return _told("send_action", lambda: failure_of(self._call(self._object.send_action, dict(action))))

    def stop(self) -> str:
        """Stop the robot."""
        return _told("stop", lambda: failure_of(self._call(self._object.stop)))

    def hold(self) -> str:
        """Keep the robot where it is."""
        return _told("hold", lambda: failure_of(self._call(self._object.hold)))

    def stop_by_channel(self) -> str:
        """Stop the robot without an object: the class's own ``stop_channel(port)``."""

        def run() -> str:
            assert self._class is not None
            return failure_of(self._call(self._class.stop_channel, self._config.keywords.get("port", "")))

        return self.load() or _told("stop_channel", run)

    def cleanup(self) -> str:
        """Give the robot up, by ``cleanup``, else ``disconnect``, else ``close``."""
        given_up, self._object = self._object, None

        def run() -> str:
            for name in ("cleanup", "disconnect", "close"):
                if callable(function := getattr(given_up, name, None)):
                    return failure_of(self._call(function))
            return ""

        return "" if given_up is None else _told("cleanup", run)

    def _call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return what a method answers; a coroutine is run to its end, always in the same loop."""
        answer = function(*args)
        if not inspect.isawaitable(answer):
            return answer
        import asyncio  # a class without coroutines is spared it

        async def wait() -> Any:
            return await answer

        self._loop = self._loop or asyncio.new_event_loop()
        return self._loop.run_until_complete(wait())


def _told(what: str, run: Callable[[], str | None]) -> str:
    """Return what went wrong, with who says so; empty: nothing. ``what``: a method of the robot's class;
    empty: ``connect``, as which verb it is told anyway."""
    try:
        failure = run()
    except Exception as error:  # the user's code may raise anything
        _log.warning("%s raised", what or "connect", exc_info=error)
        failure = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{what}: {failure}" if what and failure else failure or ""
