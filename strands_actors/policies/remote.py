"""The policy ``remote``: a policy server over WebSocket, with one of three protocols. The client detects which.

The protocol of this package has one request for each chunk of actions, and one response for each request. Each is
one WebSocket message: msgpack in a binary message, or JSON in a text message (``encoding="json"``). The server
answers in the same encoding.

    request   {"observation": {joint: number}, "instruction": text, "axes": [joint], "hz": control rate}
    response  {"actions": [{joint: number}, ...]}      a chunk, in the driver's units, executed at the control rate
           or {"error": text}                          which ends the rollout

In the protocol of strands-robots (``PolicyServer``, JSON, version 1) the server sends first:
``{"type": "ready", "protocol_version": 1, "metadata": {...}}``. The client then sends ``set_state_keys``,
``set_control_frequency``, ``reset`` and ``get_actions``.

A server of openpi sends first, too: a map in msgpack (``openpi.py``). The options ``state_key`` and ``images`` are
for such a server.

If the server sends nothing for ``GREETING_S``, the client uses the protocol of this package. A later greeting
still switches the protocol, since it comes before any response.

Every wait is bounded: ``timeout_s`` for the connection and for each response. A slow server ends the rollout before
that: when all actions of the last chunk are executed and no new ones have come, the robot holds its position.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from .base import Action, Policy
from .lerobot import Attach, Eye
from .openpi import STATE, OpenPi, is_metadata
from .registry import ENDPOINT_PORT, parse_endpoint
from .remote_errors import Misunderstood
from .remote_protocols import CODECS, Chunks, Facts, JsonV1, Talk, greeting

Read = TypeVar("Read")

MAX_BYTES = 1 << 20

GREETING_S = 0.2
"""How long to wait for a greeting. A server that sends first does so in the thread of the handshake, so its
greeting follows within the delay of a network [assumed]."""


class Remote(Policy):
    """The client of a policy server, for ``start_task``. It connects in its constructor.

    Args:
        axes: Names of the robot's axes.
        host: Host of the server.
        port: Its port.
        path: Its path.
        encoding: ``msgpack`` or ``json``.
        timeout_s: Longest time for the connection and for each response, in seconds.
        state_key: For a server of openpi: the key of the joints' positions in a request.
        images: For a server of openpi: the robot's camera by the key of its picture in a request.
        robot: Name under which the robot was started.
        cameras: Names of the robot's cameras.
        attach: Returns the reader of a camera, by the names of robot and camera. None: ``attach_camera``.

    Raises:
        ConnectionError: The server cannot be reached, closes, or sends a wrong message. Its methods raise
            it, too.
        TimeoutError: The server does not answer in time. Its methods raise it, too.
        ValueError: The encoding is unknown.
    """

    def __init__(
        self,
        axes: Sequence[str],
        host: str = "localhost",
        port: int = 8000,
        path: str = "/",
        encoding: str = "msgpack",
        timeout_s: float = 5.0,
        state_key: str = STATE,
        images: Mapping[str, str] | None = None,
        robot: str = "",
        cameras: Sequence[str] = (),
        attach: Attach | None = None,
    ) -> None:
        if encoding not in CODECS:
            raise ValueError(f"remote: encoding is {encoding!r}. Use one of {', '.join(CODECS)}")
        self.robot_state_keys = list(axes)
        self._state_key = state_key
        self._eyes = eyes(images or {}, robot, cameras, attach)
        self._encoding = encoding
        self._hz = 0.0
        self._timeout_s = timeout_s
        self._url = f"ws://{host}:{port}/{path.removeprefix('/')}"
        self._opened = contextlib.ExitStack()
        try:
            # The connection is direct, since the server is usually near the robot. A proxy that the environment
            # variables name is meant for browsers.
            opening = connect(self._url, open_timeout=timeout_s, compression=None, max_size=MAX_BYTES, proxy=None)
            self._socket = self._opened.enter_context(opening)
        except TimeoutError as error:
            raise TimeoutError(f"{self._url} did not answer within {timeout_s:g} s") from error
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._url}: {error}") from error
        self._talk: Talk = self._greeted() or Chunks(encoding)
        self._may_greet = isinstance(self._talk, Chunks)
        if self._eyes and not isinstance(self._talk, OpenPi):
            raise ValueError(
                f"remote: images are for a server of openpi, and {self._url} is none. Leave images out"
            )
        self._apply_setting("keys", self.robot_state_keys)

    def close(self) -> None:
        """Close the connection."""
        self._opened.close()

    @property
    def provider_name(self) -> str:
        """The name of the policy, ``remote``."""
        return "remote"

    @property
    def requires_images(self) -> bool:
        """True if the server's policy needs pictures. Always False in this package's own protocol."""
        return self._facts.requires_images

    @property
    def supports_rtc(self) -> bool:  # type: ignore[override]  # of the policy at the other end
        """True if the server's policy blends each chunk into the previous one.

        Always False in this package's own protocol.
        """
        return self._facts.supports_rtc

    @property
    def execution_horizon(self) -> int:
        """The number of actions of each chunk that are executed, as the server reports it.

        1 in this package's own protocol.
        """
        return self._facts.execution_horizon

    @property
    def _facts(self) -> Facts:
        return self._talk.facts if isinstance(self._talk, JsonV1) else Facts()

    def set_robot_state_keys(self, robot_state_keys: Sequence[str]) -> None:
        """Set the joints that the policy controls.

        They are sent at once, or in this package's own protocol with each request.
        """
        super().set_robot_state_keys(robot_state_keys)
        self._apply_setting("keys", self.robot_state_keys)

    def set_control_frequency(self, hz: float) -> None:
        """Set the rate at which the actions are executed (Hz).

        It is sent at once, or in this package's own protocol with each request.
        """
        self._hz = hz
        self._apply_setting("hz", hz)

    def reset(self, seed: int | None = None) -> None:
        """Request that the server forgets everything from an earlier run.

        In this package's own protocol nothing is sent. Wait for the first pictures, if the server needs some.
        """
        for eye in self._eyes:
            eye.wait()
        self._apply_setting("reset", seed)

    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next chunk of actions. The event loop is blocked until the response has arrived."""
        return self.get_actions_sync(observation_dict, instruction)

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Request the next chunk from the server, and return it.

        If the server sends its greeting in place of the first response, it uses the protocol of strands-robots.
        Then the request is sent again in that protocol.

        Raises:
            ConnectionError: The connection is lost, or the response is wrong or an error.
            TimeoutError: No response has come within ``timeout_s``.
        """
        if isinstance(self._talk, OpenPi):
            self._talk.pictures = {eye.key: eye.look() for eye in self._eyes}
        answer = self._ask(self._talk.request(observation_dict, instruction))
        if self._may_greet:
            self._may_greet = False
            if (late := self._understand(greeting, answer)) is not None:
                # The server also answers the request in the protocol that it does not speak. Drop this answer.
                self._receive()
                self._change_to(late)
                return self.get_actions_sync(observation_dict, instruction)
        return self._understand(self._talk.chunk, answer)

    # -- one message, or one request with its response

    def _greeted(self) -> JsonV1 | OpenPi | None:
        """Wait for a greeting of the server, and return the protocol of strands-robots or openpi if one comes.

        Return None if no greeting comes in time.
        """
        try:
            message = self._socket.recv(timeout=GREETING_S)
        except TimeoutError:
            return None
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._url}: {error}") from error
        if is_metadata(message):
            return OpenPi(self._state_key)
        protocol = self._understand(greeting, message)
        if protocol is None:
            raise ConnectionError(f"{self._url} sent a wrong first message: {message[:80]!r}")
        return protocol

    def _change_to(self, talk: JsonV1) -> None:
        self._talk = talk
        self._apply_setting("keys", self.robot_state_keys)
        if self._hz:
            self._apply_setting("hz", self._hz)
        self._apply_setting("reset", None)

    def _apply_setting(self, setting: str, value: Any) -> None:
        message = self._talk.apply_setting(setting, value)
        if message is not None and isinstance(self._talk, JsonV1):
            self._understand(self._talk.done, self._ask(message))

    def _ask(self, message: bytes) -> bytes | str:
        try:
            self._socket.send(message, text=self._talk.is_text)
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._url}: {error}") from error
        return self._receive()

    def _receive(self) -> bytes | str:
        try:
            return self._socket.recv(timeout=self._timeout_s)
        except TimeoutError as error:
            raise TimeoutError(f"{self._url} did not answer within {self._timeout_s:g} s") from error
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._url}: {error}") from error

    def _understand(self, read: Callable[[bytes | str], Read], answer: bytes | str) -> Read:
        try:
            return read(answer)
        except Misunderstood as problem:
            raise ConnectionError(f"{self._url} {problem}") from problem


def eyes(images: Mapping[str, str], robot: str, cameras: Sequence[str], attach: Attach | None) -> list[Eye]:
    """Return an ``Eye`` (a camera) for each picture of a request. Raise ``ValueError`` for an unknown camera."""
    if not images:
        return []
    from strands_actors.surfaces.cameras import attach_camera
    from strands_actors.surfaces.cameras.picture_files import cameras_of

    # A caller on another computer does not know the robot's cameras.
    names = cameras or cameras_of(robot)
    if unknown := sorted(set(images.values()) - set(names)):
        has = f"cameras {', '.join(names)}" if names else "no cameras"
        raise ValueError(f"images names {', '.join(unknown)}, and the robot has {has}. Give Robot cameras=")
    return [Eye(key, (attach or attach_camera)(robot, camera), None) for key, camera in images.items()]


class RemotePolicy(Policy):
    """The client of a policy server, for ``run_policy``. It connects when it is first used.

    Args:
        endpoint: ``ws://host:port/path``, in place of host, port and path.
        host: Host of the server.
        port: Port of the server.
        path: Path of the server's address.
        encoding: ``msgpack`` or ``json``.
        timeout_s: Longest time for the connection and for each response, in seconds.
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        host: str = "localhost",
        port: int = ENDPOINT_PORT,
        path: str = "/",
        encoding: str = "msgpack",
        timeout_s: float = 5.0,
    ) -> None:
        if endpoint is not None:
            host, port, path = parse_endpoint(endpoint, ("ws",))
        self._place: dict[str, Any] = {"host": host, "port": port, "path": path}
        self._place |= {"encoding": encoding, "timeout_s": timeout_s}
        self._hz = 0.0
        self._connected: Remote | None = None

    @property
    def _remote(self) -> Remote:
        if self._connected is None:
            self._connected = Remote(self.robot_state_keys, **self._place)
            if self._hz:
                self._connected.set_control_frequency(self._hz)
        return self._connected

    def close(self) -> None:
        """Close the connection. The next use connects again."""
        if self._connected is not None:
            self._connected.close()
        self._connected = None

    @property
    def provider_name(self) -> str:
        """The name of the policy, ``remote``."""
        return "remote"

    @property
    def requires_images(self) -> bool:
        """True if the server's policy needs pictures. Connects first, if necessary."""
        return self._remote.requires_images

    @property
    def supports_rtc(self) -> bool:  # type: ignore[override]  # of the policy at the other end
        """True if the server's policy blends each chunk into the previous one. Connects first, if necessary."""
        return self._remote.supports_rtc

    @property
    def execution_horizon(self) -> int:
        """The number of actions of each chunk that are executed. Connects first, if necessary."""
        return self._remote.execution_horizon

    def set_robot_state_keys(self, robot_state_keys: Sequence[str]) -> None:
        """Set the joints that the policy controls. They are sent at once, or when the client connects."""
        super().set_robot_state_keys(robot_state_keys)
        if self._connected is not None:
            self._connected.set_robot_state_keys(robot_state_keys)

    def set_control_frequency(self, hz: float) -> None:
        """Set the rate at which the actions are executed (Hz). It is sent at once, or when the client connects."""
        self._hz = hz
        if self._connected is not None:
            self._connected.set_control_frequency(hz)

    def reset(self, seed: int | None = None) -> None:
        """Request that the server forgets everything from an earlier run. Connects first, if necessary."""
        self._remote.reset(seed)

    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next chunk of actions. A worker thread waits for it, so that the event loop is not blocked."""
        import asyncio

        return await asyncio.to_thread(self.get_actions_sync, observation_dict, instruction)

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Request the next chunk from the server, and return it. Connects first, if necessary."""
        return self._remote.get_actions_sync(observation_dict, instruction)
