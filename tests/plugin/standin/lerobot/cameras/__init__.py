from __future__ import annotations

from dataclasses import dataclass


@dataclass(kw_only=True)
class CameraConfig:
    width: int | None = None
    height: int | None = None
    fps: int | None = None
    broken: bool = False


class Camera:
    def __init__(self, config: CameraConfig) -> None:
        self.config = config
        self.is_connected = False

    def connect(self, warmup: bool = True) -> None:
        if self.config.broken:
            raise ConnectionError("no such camera")
        self.is_connected = True

    def read_latest(self, max_age_ms: int = 500) -> str:
        assert self.is_connected
        return "a picture"

    def disconnect(self) -> None:
        assert self.is_connected
        self.is_connected = False
