"""A robot of strands-actors with the interface of a LeRobot robot.

LeRobot's process is only the caller of the robot's tree. If it is killed or frozen, the tree reacts as to
a killed or frozen script.
"""

import logging
import time
from collections.abc import Mapping
from typing import Any

from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot

import strands_actors

from .configs import LocalConfig, RemoteConfig, StrandsConfig
from .units import features, observed_features

OLDEST_S = 2.0
"""Greatest age of a reading, in seconds. A control loop must not act on older ones."""
AGAIN_S = 0.05
"""Pause before a robot that did not answer is asked again, in seconds. The robot holds meanwhile."""

_log = logging.getLogger("strands_actors")


class StrandsRobot(Robot):
    """A LeRobot robot of any type; ``config`` selects which.

    The constructor starts no process. The features are known before ``connect``.
    """

    config_class = StrandsConfig
    name = "strands"
    # A class attribute, because LeRobot's __del__ reads is_connected even if __init__ has failed.
    _arm: Any = None

    def __init__(self, config: StrandsConfig) -> None:
        super().__init__(config)
        if config.refusals < 1:
            raise ValueError(f"refusals is {config.refusals}. give 1 or more: so many in a row end the loop")
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
        sizes = {name: (one.height, one.width, 3) for name, one in self.config.cameras.items()}
        return {**{feature.key: float for feature in self._observed}, **sizes}

    @property
    def is_connected(self) -> bool:
        """True if there is something to disconnect. If the robot stops answering, this stays True and
        ``get_observation`` raises."""
        return self._arm is not None

    @property
    def is_calibrated(self) -> bool:
        # A calibration file, if there is one, was read by the constructor. LeRobot must not start its own.
        return True

    def calibrate(self) -> None:
        """Do nothing. LeRobot's own ``lerobot-calibrate``, with its own robot of this type, writes the
        file that is read here."""

    def configure(self) -> None:
        """Do nothing. The driver configures the motors when it arms them."""

    # -- connect and disconnect

    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras, then connect the robot and energise it at its present position.

        Args:
            calibrate: Ignored.

        Raises:
            ConnectionError: It is already connected, or it cannot be connected, prepared or read.
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
        """Stop the robot, read every motor back, and end the processes that were started for it.

        Raises:
            ConnectionError: It is not connected, or a motor did not confirm the stop.
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
            ConnectionError: It is not connected, the newest reading is older than ``OLDEST_S``, or a
                joint was never read.
        """
        self._require("get_observation")
        observed: dict[str, Any] = self._measured()
        for name, camera in self.cameras.items():
            observed[name] = camera.read_latest()
        return observed

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Send an action, and return the newest action that was accepted.

        A refused action is not sent. Then the previous accepted action is returned.

        Raises:
            ConnectionError: It is not connected, or ``config.refusals`` actions in a row were refused.
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
        """Return an action of LeRobot with our axes and units. An unknown key stays unchanged, so that
        the gate's refusal names it."""
        own: dict[str, Any] = {}
        for key, value in action.items():
            feature = self._by_key.get(key)
            own[feature.axis if feature else key] = feature.from_lerobot(float(value)) if feature else value
        return own

    def _measured(self) -> dict[str, float]:
        until_s = time.monotonic() + OLDEST_S
        # A busy computer may be the only reason for a missing reading, so try again until then.
        while (result := self._arm.state())["status"] != "success":
            if time.monotonic() > until_s:
                raise ConnectionError(_text(result))
            time.sleep(AGAIN_S)
        state = result["content"][0]["json"]
        if not state["age_s"] <= OLDEST_S:
            raise ConnectionError(
                f"{self.name}: the newest reading is {state['age_s']:.1f} s old. check its cable and power"
            )
        values = {feature: state["positions"].get(feature.axis) for feature in self._observed}
        if missing := [feature.key for feature, value in values.items() if value is None]:
            raise ConnectionError(f"{self.name}: {', '.join(missing)} was never read. check its cable and power")
        return {feature.key: feature.to_lerobot(value) for feature, value in values.items()}

    def _require(self, method: str) -> None:
        if self._arm is None:
            raise ConnectionError(f"{method}: {self.name} is not connected. call connect() first")

    # -- the handle

    def _handle(self) -> Any:
        """Return a new handle. One that was cleaned up cannot connect again."""
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
    """Return the result that reports the motors.

    ``cleanup`` stops a robot of this host once more and reports its motors. A robot of another host keeps
    running there, and ``cleanup`` reports no motors. Then the result of ``stop`` counts.
    """
    reports = ended["status"] != "success" or "motors" in ended["content"][0]["json"]
    return ended if reports else stopped


def _text(result: Mapping[str, Any]) -> str:
    text: str = result["content"][0]["text"]
    return text
