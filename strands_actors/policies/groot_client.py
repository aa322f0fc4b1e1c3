"""The policy ``groot``: a policy server of GR00T over ZeroMQ (``zmq://host:port``). See ``groot`` for its protocol.

Every wait is bounded by ``timeout_s``. A message that is too long closes the connection before it is read, so the
client also watches for the end of the connection.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import zmq
from zmq.utils.monitor import recv_monitor_message

from . import groot
from .lerobot import Attach, Eye
from .remote import MAX_BYTES, eyes
from .remote_errors import Misunderstood

Read = TypeVar("Read")

PORT = 5555


class Groot:
    """The client of a GR00T server. It connects in its constructor.

    This package sets ``axes``, ``robot`` and ``cameras``. Numbers are in the driver's units in both directions.

    Args:
        axes: Names of the robot's axes.
        host: Host of the server.
        port: Its port.
        path: Has no effect.
        timeout_s: Longest time for each response, in seconds.
        api_token: The token that the server demands; empty for none.
        joints: The robot's axes by the key of a state or action of the policy. The default fits a policy with one
            such key, or with one and ``gripper``.
        images: The robot's camera by the key of a picture. The default: the camera of the same name.
        robot: Name under which the robot was started.
        cameras: Names of the robot's cameras.
        attach: As in ``Remote``.

    Raises:
        ConnectionError: The server cannot be reached, closes, or sends a wrong message. Its methods raise it, too.
        TimeoutError: The server does not answer in time. Its methods raise it, too.
        ValueError: The policy does not fit the robot's axes or cameras.
    """

    provider_name = "groot"
    reads_instruction = True

    def __init__(
        self,
        axes: Sequence[str],
        host: str = "localhost",
        port: int = PORT,
        path: str = "/",
        timeout_s: float = 5.0,
        api_token: str = "",
        joints: Mapping[str, Sequence[str]] | None = None,
        images: Mapping[str, str] | None = None,
        robot: str = "",
        cameras: Sequence[str] = (),
        attach: Attach | None = None,
    ) -> None:
        self._url = f"zmq://{host}:{port}"
        self._timeout_s = timeout_s
        self._token = api_token
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)
        self._ends = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        with contextlib.ExitStack() as failed:
            failed.callback(self.close)
            try:
                self._socket.connect(f"tcp://{host}:{port}")
            except zmq.ZMQError as failure:
                raise ConnectionError(f"{self._url}: {failure}") from failure
            self._modalities = self._call(groot.modalities_of, "get_modality_config")
            self._joints = groot.joints_of(self._modalities, axes, joints)
            self._eyes = self._eyes_of(images, robot, cameras, attach)
            failed.pop_all()
        self.requires_images = bool(self._eyes)

    def _eyes_of(
        self, images: Mapping[str, str] | None, robot: str, cameras: Sequence[str], attach: Attach | None
    ) -> list[Eye]:
        keys = self._modalities.keys[groot.VIDEO]
        chosen = eyes(images or {key: key for key in keys}, robot, cameras, attach)
        if missing := sorted(set(keys) - {eye.key for eye in chosen}):
            raise ValueError(f"groot: the policy needs pictures {', '.join(missing)[:200]}. Name all in images")
        return chosen

    def close(self) -> None:
        """Close the connection."""
        self._socket.disable_monitor()
        self._ends.close(0)
        self._socket.close(0)
        self._context.term()

    def reset(self, seed: int | None = None) -> None:
        """Request that the policy forgets everything from an earlier run, and wait for the first pictures.

        Args:
            seed: Has no effect.
        """
        for eye in self._eyes:
            eye.wait()
        if self._modalities.nested:
            self._call(lambda content: None, "reset", {"options": None})

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **_: Any
    ) -> list[dict[str, float]]:
        """Request the next chunk from the server, and return it.

        Raises:
            ConnectionError: The connection is lost, or the response is wrong or an error.
            TimeoutError: No response has come within ``timeout_s``.
        """
        pictures = {eye.key: eye.look() for eye in self._eyes}
        data = groot.observation_data(self._modalities, self._joints, observation, pictures, instruction)
        return self._call(
            lambda content: groot.rows_of(self._modalities, self._joints, content), "get_action", data
        )

    def _call(self, read: Callable[[Any], Read], endpoint: str, data: Mapping[str, Any] | None = None) -> Read:
        try:
            self._socket.send(groot.request(endpoint, data, self._token))
            message = self._receive()
        except zmq.ZMQError as failure:
            raise ConnectionError(f"{self._url}: {failure}") from failure
        try:
            return read(groot.answer_of(message))
        except Misunderstood as problem:
            raise ConnectionError(f"{self._url} {problem}") from problem

    def _receive(self) -> bytes:
        poller = zmq.Poller()
        poller.register(self._socket, zmq.POLLIN)
        poller.register(self._ends, zmq.POLLIN)
        ready = dict(poller.poll(round(self._timeout_s * 1e3)))
        if self._socket in ready:
            message: bytes = self._socket.recv()
            return message
        if self._ends in ready:
            recv_monitor_message(self._ends)
            raise ConnectionError(
                f"{self._url} closed the connection, or sent a message of more than {MAX_BYTES} bytes"
            )
        raise TimeoutError(f"{self._url} did not answer within {self._timeout_s:g} s")


__all__ = ["Groot"]
