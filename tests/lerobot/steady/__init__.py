"""A camera of LeRobot's that gives the pictures of ``tests.cameras.sources:steady``, so that both
have the same: ``--robot.discover_packages_path=tests.lerobot.steady``, type ``steady``. What reads
it, in a thread, and hands out the newest, is LeRobot's ``OpenCVCamera``."""

import time
from dataclasses import dataclass

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.opencv import OpenCVCamera, OpenCVCameraConfig


@CameraConfig.register_subclass("steady")
@dataclass
class SteadyConfig(OpenCVCameraConfig):
    pass


class _Capture:
    """Of OpenCV's ``VideoCapture`` what is used once it is open."""

    def __init__(self, config: SteadyConfig) -> None:
        assert config.width and config.height and config.fps
        self._size = config.height, config.width, 3
        self._period_s = 1.0 / config.fps
        self._count = 0
        self._due_s = time.monotonic()

    def read(self) -> tuple[bool, np.ndarray]:
        self._due_s = max(self._due_s + self._period_s, time.monotonic())
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        self._count += 1
        image = np.zeros(self._size, np.uint8)
        image[:, :, 2] = self._count % 256
        return True, image

    def release(self) -> None: ...


class Steady(OpenCVCamera):
    @property
    def is_connected(self) -> bool:
        return self.videocapture is not None

    def connect(self, warmup: bool = True) -> None:
        self.videocapture = _Capture(self.config)
        self._start_read_thread()
