"""The client for a Reachy Mini: it calls the REST service of the robot's daemon with the package requests."""

from __future__ import annotations

import threading
import time

import requests

from .hand import BaseClient, wave

STEP_RAD = 0.1
FAR_RAD = 0.5
MOVE_S = 2.0
TIMEOUT_S = 5.0


class Client(BaseClient):
    """The client. Each thread has its own ``requests.Session``, since these sessions are not thread-safe."""

    def __init__(self, robot: str, port: str) -> None:
        self._base = f"http://{port}/api/move"
        self._far = FAR_RAD
        self._kept = threading.local()
        self._session().get(f"http://{port}/api/daemon/status", timeout=TIMEOUT_S).raise_for_status()

    def _session(self) -> requests.Session:
        if not hasattr(self._kept, "session"):
            self._kept.session = requests.Session()
            self._kept.session.trust_env = False
        session: requests.Session = self._kept.session
        return session

    def _post(self, path: str, body: dict[str, object]) -> None:
        self._session().post(f"{self._base}/{path}", json=body, timeout=TIMEOUT_S).raise_for_status()

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._post("set_target", {"target_body_yaw": STEP_RAD * wave(number)})
        return began_ns

    def move(self, number: int) -> None:
        self._far = -self._far
        self._post("goto", {"body_yaw": self._far, "duration": MOVE_S})

    def stop(self) -> None:
        """Request the running moves and stop each of them, because the service has no request that stops
        everything.
        """
        running = self._session().get(f"{self._base}/running", timeout=TIMEOUT_S).json()
        for move in running:
            self._post("stop", move)
