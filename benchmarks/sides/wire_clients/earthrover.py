"""The client for an EarthRover: it calls the HTTP service of the vendor's SDK with the package requests."""

from __future__ import annotations

import threading
import time

import requests

from .hand import BaseClient, wave

SPEED = 0.3
TIMEOUT_S = 5.0


class Client(BaseClient):
    """The client. Each thread has its own ``requests.Session``, since these sessions are not thread-safe."""

    def __init__(self, robot: str, port: str) -> None:
        self._base = f"http://{port}"
        self._kept = threading.local()

    def _control(self, linear: float, angular: float) -> None:
        if not hasattr(self._kept, "session"):
            self._kept.session = requests.Session()
            self._kept.session.trust_env = False
        command = {"linear": linear, "angular": angular, "lamp": 0}
        self._kept.session.post(
            f"{self._base}/control", json={"command": command}, timeout=TIMEOUT_S
        ).raise_for_status()

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._control(SPEED * wave(number), 0.0)
        return began_ns

    def stop(self) -> None:
        self._control(0, 0)
