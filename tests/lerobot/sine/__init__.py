"""A teleoperator of LeRobot's that nobody holds: ``--teleop.discover_packages_path=tests.lerobot.sine
--teleop.type=sine``. It swings the first joint about where it is told; ``past``: for a while it asks
for 400 degrees."""

import math
import time
from dataclasses import dataclass, field

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

PAST_FROM_S, PAST_TO_S = 1.0, 1.3
SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@TeleoperatorConfig.register_subclass("sine")
@dataclass(kw_only=True)
class SineConfig(TeleoperatorConfig):
    past: bool = False
    axes: list[str] = field(default_factory=lambda: list(SO101))


class Sine(Teleoperator):
    config_class = SineConfig
    name = "sine"

    def __init__(self, config: SineConfig) -> None:
        super().__init__(config)
        self.config = config
        self._up = False
        self._begun_s = 0.0

    @property
    def action_features(self) -> dict:
        return {f"{axis}.pos": float for axis in self.config.axes}

    @property
    def feedback_features(self) -> dict:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._up

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self._up, self._begun_s = True, 0.0

    def calibrate(self) -> None: ...
    def configure(self) -> None: ...
    def send_feedback(self, feedback: dict) -> None: ...

    def get_action(self) -> dict:
        self._begun_s = self._begun_s or time.monotonic()  # the robot connects after its teleoperator
        at_s = time.monotonic() - self._begun_s
        action = {f"{axis}.pos": 20.0 if axis == "gripper" else 0.0 for axis in self.config.axes}
        first = f"{self.config.axes[0]}.pos"
        action[first] = 10.0 * math.sin(at_s)
        if self.config.past and PAST_FROM_S < at_s < PAST_TO_S:
            action[first] = 400.0
        return action

    def disconnect(self) -> None:
        self._up = False
