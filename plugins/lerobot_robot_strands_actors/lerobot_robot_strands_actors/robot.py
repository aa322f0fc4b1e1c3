"""A robot of strands-actors with the interface of a LeRobot robot.

Separate processes control the robot, and LeRobot's process only sends commands to them. If LeRobot's process
is killed or frozen, they stop or hold the robot, as for any script.
"""

import logging
import time
from collections.abc import Mapping
from typing import Any

import strands_actors

from .configs import LocalConfig, RemoteConfig, StrandsConfig
from .lerobot_api import Robot, make_cameras_from_configs
from .units import features, observed_features

OLDEST_S = 2.0
"""Greatest age of a reading, in seconds. A control loop must not act on older ones."""
AGAIN_S = 0.05
"""Pause before a robot that did not answer is asked again, in seconds. The robot holds meanwhile."""

_log = logging.getLogger("strands_actors")


class StrandsRobot(Robot):
    """A LeRobot robot. ``config`` selects its type.

    The constructor starts no process. The features are known before ``connect``.
    """

    config_class = StrandsConfig
    name = "strands"
    # A class attribute, because LeRobot's __del__ reads is_connected even if __init__ has failed.
    _arm: Any = None

    def __init__(self, config: StrandsConfig) -> None:
        super().__init__(config)
        if config.refusals < 1:
            raise ValueError(
                f"refusals is {config.refusals}. Give the number of refused "
                "actions in a row after which send_action raises, at least 1"
            )
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        driver = self._handle().driver
        self._features = features(driver.robot, driver.table, driver.travel(), config.use_degrees)
        self._by_key = {feature.key: feature for feature in self._features}
        self._observed = (*self._features, *observed_features(driver.READ_ONLY_JOINTS))
        self._accepted: dict[str, float] = {}
        self._refused = 0

    # -- features and state

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(self._by_key, float)

    @property
    def observation_features(self) -> dict[str, Any]:
        sizes = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return {**{feature.key: float for feature in self._observed}, **sizes}

    @property
    def is_connected(self) -> bool:
        """True from ``connect`` to ``disconnect``, even if the robot no longer answers. In that case
        ``get_observation`` raises."""
        return self._arm is not None

    @property
    def is_calibrated(self) -> bool:
        # True keeps LeRobot from starting its own calibration. The constructor has read the calibration file, if
        # there is one.
        return True

    def calibrate(self) -> None:
        """Do nothing. Calibrate with ``lerobot-calibrate`` and LeRobot's robot of the same type. This class
        reads the resulting file."""

    def configure(self) -> None:
        """Do nothing. The driver configures the motors when it energises them."""

    # -- connect and disconnect

    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras, then connect the robot and energise it at its present position.

        Args:
            calibrate: Ignored.

        Raises:
            ConnectionError: The robot is already connected, or it cannot be connected, prepared or read.
        """
        if self._arm is not None:
            raise ConnectionError(f"{self.name} is already connected")
        self._arm = self._handle()
        try:
            for camera in self.cameras.values():
                camera.connect()
            if problem := self._arm.connect_eagerly():
                raise ConnectionError(problem)
            self._prepare()
            measured = self._measured()
        except BaseException:
            self._let_go()
            raise
        self._accepted = {
            feature.key: 0.0 if feature.is_velocity else measured[feature.key] for feature in self._features
        }
        self._refused = 0

    def disconnect(self) -> None:
        """Stop the robot, read every motor to confirm the stop, and end the robot's processes.

        Raises:
            ConnectionError: The robot is not connected, or a motor did not confirm the stop.
        """
        if self._arm is None:
            raise ConnectionError(f"{self.name} is not connected")
        result = self._let_go()
        if result["status"] != "success":
            raise ConnectionError(_text(result))

    def _let_go(self) -> Any:
        arm, self._arm = self._arm, None
        try:
            stopped = arm.stop()
            ended = arm.cleanup()
        finally:
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()
        return _last_word(stopped, ended)

    def _prepare(self) -> None:
        service = self._arm.driver.BEFORE_MOTION
        if not (self.config.prepare and service):
            return
        if (result := self._arm.service(service))["status"] != "success":
            raise ConnectionError(_text(result))

    # -- the control loop

    def get_observation(self) -> dict[str, Any]:
        """Return the newest reading of each joint, and the newest picture of each camera.

        Raises:
            ConnectionError: The robot is not connected, the newest reading is older than ``OLDEST_S``, or a
                joint was never read.
        """
        self._require("get_observation")
        observed: dict[str, Any] = self._measured()
        for name, camera in self.cameras.items():
            observed[name] = camera.read_latest()
        return observed

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Send an action, and return the newest action that was accepted.

        If the action is refused, the robot does not move to it, and the previous accepted action is returned.

        Raises:
            ConnectionError: The robot is not connected, or ``config.refusals`` actions in a row were refused.
        """
        self._require("send_action")
        own = self._own(action)
        result = self._arm.send_action(own)
        if result["status"] == "success":
            self._refused = 0
            commanded = result["content"][0]["json"].get("commanded", own)
            self._accepted |= {
                feature.key: feature.to_lerobot(commanded[feature.axis])
                for feature in self._features
                if feature.axis in commanded
            }
            return dict(self._accepted)
        self._refused += 1
        if self._refused >= self.config.refusals:
            raise ConnectionError(f"{self._refused} actions in a row were refused, the last: {_text(result)}")
        if self._refused == 1:
            _log.warning("%s: %s", self.name, _text(result))
        return dict(self._accepted)

    def _own(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Convert an action of LeRobot to the driver's axes and units. An unknown key stays unchanged, so
        that the refusal of the action names this key."""
        own: dict[str, Any] = {}
        for key, value in action.items():
            feature = self._by_key.get(key)
            own[feature.axis if feature else key] = feature.from_lerobot(float(value)) if feature else value
        return own

    def _measured(self) -> dict[str, float]:
        until_s = time.monotonic() + OLDEST_S
        # A busy computer may cause a missing reading. So try again for ``OLDEST_S``.
        while (result := self._arm.state())["status"] != "success":
            if time.monotonic() > until_s:
                raise ConnectionError(_text(result))
            time.sleep(AGAIN_S)
        state = result["content"][0]["json"]
        if not state["age_s"] <= OLDEST_S:
            raise ConnectionError(
                f"{self.name}: the newest reading is {state['age_s']:.1f} s old. Check its cable and power"
            )
        values = {feature: state["positions"].get(feature.axis) for feature in self._observed}
        if missing := [feature.key for feature, value in values.items() if value is None]:
            raise ConnectionError(f"{self.name}: {', '.join(missing)} was never read. Check its cable and power")
        return {feature.key: feature.to_lerobot(value) for feature, value in values.items()}

    def _require(self, method: str) -> None:
        if self._arm is None:
            raise ConnectionError(f"{method}: {self.name} is not connected. Call connect() first")

    # -- the handle

    def _handle(self) -> Any:
        """Return a new robot handle. A handle cannot connect again after ``cleanup``."""
        config = self.config
        keywords: dict[str, Any] = {"mode": "real"}
        if name := config.name or config.id:
            keywords["tool_name"] = name
        if config.mesh is not None:
            keywords["mesh"] = strands_actors.MeshConfig.load(config.mesh)
        if isinstance(config, RemoteConfig):
            return strands_actors.Robot(config.robot, at=config.at, **keywords)
        assert isinstance(config, LocalConfig)
        keywords |= {"transport": "twin"} if config.twin else {}
        keywords |= {"port": config.port} if config.port is not None else {}
        if not config.twin and self.calibration_fpath.is_file():
            keywords["calibration"] = str(self.calibration_fpath)
        return strands_actors.Robot(config.ROBOT, **keywords)


def _last_word(stopped: Any, ended: Any) -> Any:
    """Return the result that reports the state of each motor, which is that of ``cleanup`` or of ``stop``.

    For a robot on this host, ``cleanup`` stops the robot again and reports its motors. For a robot on another
    host, ``cleanup`` only disconnects, so the result of ``stop`` is returned.
    """
    reports = ended["status"] != "success" or "motors" in ended["content"][0]["json"]
    return ended if reports else stopped


def _text(result: Mapping[str, Any]) -> str:
    text: str = result["content"][0]["text"]
    return text
