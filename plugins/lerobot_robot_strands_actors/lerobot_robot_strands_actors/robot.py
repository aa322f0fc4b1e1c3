"""One robot of strands-actors in the shape that LeRobot's loops know.

LeRobot's process is the caller of the robot's tree, and nothing else of it: killed or frozen, it is
what a killed or frozen script is.
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
"""A loop that is shown an older reading steers by what no longer is."""
AGAIN_S = 0.05
"""Until a robot that did not answer is asked again. It holds meanwhile."""

_log = logging.getLogger("strands_actors")


class StrandsRobot(Robot):
    """``config`` says which. Made, it has started nothing; its features are known."""

    config_class = StrandsConfig
    name = "strands"
    _arm: Any = None  # also of one whose __init__ failed: LeRobot's __del__ asks

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

    # -- what it is

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(self._by_key, float)

    @property
    def observation_features(self) -> dict[str, Any]:
        sizes = {name: (one.height, one.width, 3) for name, one in self.config.cameras.items()}
        return {**{feature.key: float for feature in self._observed}, **sizes}

    @property
    def is_connected(self) -> bool:
        """Whether there is something to disconnect. A robot that is not heard any more raises in
        ``get_observation``."""
        return self._arm is not None

    @property
    def is_calibrated(self) -> bool:
        return True  # by a file that was read when this was made, or without one: nothing is asked here

    def calibrate(self) -> None:
        """Nothing: LeRobot's own ``lerobot-calibrate`` of its robot of this kind writes the file
        that is read here."""

    def configure(self) -> None:
        """Nothing: the driver configures the motors when it arms them."""

    # -- its life

    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras, and then connect and energise the robot where it stands. Raise
        ``ConnectionError`` with the reason."""
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
        """Stop, read every motor back, and end what was started for the robot. Raise
        ``ConnectionError`` when a motor did not confirm."""
        if self._arm is None:
            raise ConnectionError(f"{self.name} is not connected")
        told = self._let_go()
        if told["status"] != "success":
            raise ConnectionError(_text(told))

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
        if (told := self._arm.service(service))["status"] != "success":
            raise ConnectionError(_text(told))

    # -- its loop

    def get_observation(self) -> dict[str, Any]:
        """Raise ``ConnectionError`` when the newest reading is older than ``OLDEST_S``."""
        self._require("get_observation")
        observed: dict[str, Any] = self._measured()
        for name, camera in self.cameras.items():
            observed[name] = camera.read_latest()
        return observed

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Return what was accepted: of a refused action the last one that was not. Raise
        ``ConnectionError`` when ``refusals`` in a row were refused."""
        self._require("send_action")
        own = self._own(action)
        told = self._arm.send_action(own)
        if told["status"] == "success":
            self._refused = 0
            commanded = told["content"][0]["json"].get("commanded", own)
            self._accepted |= {
                feature.key: feature.to_lerobot(commanded[feature.axis])
                for feature in self._features
                if feature.axis in commanded
            }
            return dict(self._accepted)
        self._refused += 1
        if self._refused >= self.config.refusals:
            raise ConnectionError(f"{self._refused} actions in a row were refused, the last: {_text(told)}")
        if self._refused == 1:
            _log.warning("%s: %s", self.name, _text(told))
        return dict(self._accepted)

    def _own(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Return an action of LeRobot's by our axes. A key of nobody's goes on as it is, and is
        refused there by its name."""
        own: dict[str, Any] = {}
        for key, value in action.items():
            feature = self._by_key.get(key)
            own[feature.axis if feature else key] = feature.from_lerobot(float(value)) if feature else value
        return own

    def _measured(self) -> dict[str, float]:
        until_s = time.monotonic() + OLDEST_S
        while (told := self._arm.state())["status"] != "success":
            if time.monotonic() > until_s:  # until then a busy machine may be all that is wrong
                raise ConnectionError(_text(told))
            time.sleep(AGAIN_S)
        state = told["content"][0]["json"]
        if not state["age_s"] <= OLDEST_S:
            raise ConnectionError(
                f"{self.name}: the newest reading is {state['age_s']:.1f} s old. check its cable and power"
            )
        found = {feature: state["positions"].get(feature.axis) for feature in self._observed}
        if missing := [feature.key for feature, value in found.items() if value is None]:
            raise ConnectionError(f"{self.name}: {', '.join(missing)} was never read. check its cable and power")
        return {feature.key: feature.to_lerobot(value) for feature, value in found.items()}

    def _require(self, what: str) -> None:
        if self._arm is None:
            raise ConnectionError(f"{what}: {self.name} is not connected. call connect() first")

    # -- the handle

    def _handle(self) -> Any:
        """Return a new handle: one that was cleaned up connects no more."""
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
    """Return what became of the motors. What ended the tree has stopped the robot once more; a
    robot of another host goes on there, and nothing of ours was ended."""
    says = ended["status"] != "success" or "motors" in ended["content"][0]["json"]
    return ended if says else stopped


def _text(told: Mapping[str, Any]) -> str:
    text: str = told["content"][0]["text"]
    return text
