"""Read the robot's camera, which its daemon streams over WebRTC (``cameras={"head": {}}``).

Pictures go directly to the camera's own process, not through the processes that control the robot.
"""

from __future__ import annotations

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.extras import missing
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.webrtc import WebRtcVideo

from .driver import Reachy

PRODUCER = "reachymini"
"""Name that the daemon's media server gives itself (1.13.0)."""


async def open_camera(settings: CameraSettings) -> WebRtcVideo:
    """Open the camera stream at the first address that offers one. Raise ``WireDown`` with the error of every
    address."""
    if reason := missing("reachy", "a picture of the robot's camera"):
        raise WireDown(reason)
    config = Reachy(settings.robot, settings.port, settings.options).config
    problems = []
    for host, _ in config.addresses():
        video = WebRtcVideo(f"ws://{f'[{host}]' if ':' in host else host}:{config.media_port}", PRODUCER)
        try:
            await video.open()
        except WireDown as down:
            problems.append(str(down))
        else:
            return video
    raise WireDown("; ".join(problems))
