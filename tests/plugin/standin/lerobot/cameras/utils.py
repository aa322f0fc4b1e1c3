from __future__ import annotations

from . import Camera, CameraConfig


def make_cameras_from_configs(configs: dict[str, CameraConfig]) -> dict[str, Camera]:
    return {name: Camera(config) for name, config in configs.items()}
