"""Read pictures of a robot's cameras. Each camera has a separate process, and a reader never waits for it.

with Robot("so101", cameras={"wrist": {}}) as arm:
    frame = arm.read_camera("wrist")
"""

from .frames import Frame, Stale, StaleFrame
from .reader import CameraReader, attach_camera

__all__ = ["CameraReader", "Frame", "Stale", "StaleFrame", "attach_camera"]
