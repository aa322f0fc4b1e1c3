"""Name the wires behind connections that the kit of ``twin_robot.py`` models: driver, twin, and what moves it."""

from __future__ import annotations

from strands_actors.drivers.common.codecs.grpc_messages import MAX_MESSAGE
from strands_actors.drivers.common.twin.grpc import GrpcHost
from strands_actors.drivers.common.twin.http import serving as serving_http
from strands_actors.drivers.common.twin.tcp import Handler
from strands_actors.drivers.common.twin.websocket import serving_websocket
from strands_actors.drivers.earthrover.robots import TABLES as ROVERS
from strands_actors.drivers.earthrover.twin import RoverTwin
from strands_actors.drivers.rby1.robots import TABLES as RBY1S
from strands_actors.drivers.rby1.twin import controller as rby1_controller
from strands_actors.drivers.rby1.twin.service import RBY1Service
from strands_actors.drivers.spot import session as spot_session
from strands_actors.drivers.spot.config import SpotConfig
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin import services as spot_services
from strands_actors.drivers.spot.twin.mechanism import REST
from strands_actors.drivers.yahboom.twin import M3ProTwin, bridge

from .robot_model import Actions, Seam
from .session_arm import SlowActions
from .stream_robot import StreamRobot


class Rover(StreamRobot):
    """HTTP: an EarthRover behind the service of its SDK process."""

    PORT = "192.0.2.11"
    DRIVER = "strands_actors.drivers.earthrover.driver:EarthRover"
    MARK = "linear"
    SETTLE_S = 8.0  # a stop is repeated for 2.7 s

    def make_twin(self) -> None:
        self.twin = RoverTwin(ROVERS.table(self.robot), self.now_s)

    def handler(self) -> Handler:
        return serving_http(self.twin)

    @property
    def follows_commands(self) -> bool:
        return any(self.twin.rover.commanded)

    def pass_time(self) -> None:
        self.twin.rover.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()


class Mecanum(StreamRobot):
    """WebSocket: the base of an M3 Pro behind rosbridge. Its arm rests."""

    PORT = "192.0.2.12"
    DRIVER = "strands_actors.drivers.yahboom.driver:YahboomM3Pro"
    MARK = "linear.x"
    SETTLE_S = 6.0
    TIMED = (bridge,)

    def make_twin(self) -> None:
        self.twin = M3ProTwin(self.robot, self.now_s)

    def handler(self) -> Handler:
        serve = bridge.serving(self.twin.graph)
        return serving_websocket(lambda path: serve)

    @property
    def follows_commands(self) -> bool:
        return any(self.twin.mechanism.commanded)

    def pass_time(self) -> None:
        self.twin.mechanism.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()


class Humanoid(StreamRobot):
    """gRPC: an RB-Y1, which follows commands from the time when its controller is enabled until a cancel."""

    PORT = "192.0.2.13:50051"
    DRIVER = "strands_actors.drivers.rby1.driver:RBY1"
    MARK = "head_1"
    SETTLE_S = 9.0  # a stop tries for 2.8 s
    TIMED = (rby1_controller,)

    def make_twin(self) -> None:
        self.controller = rby1_controller.Controller(RBY1S.table(self.robot), self.now_s)
        self.service = RBY1Service(self.controller)
        self.host = GrpcHost(self.service)

    def handler(self) -> Handler:
        return self.host.serve

    def actions(self) -> Actions:
        return SlowActions(self.world.rng("actions"), self.MARK, "head_0", "left_arm_2")

    @property
    def follows_commands(self) -> bool:
        return self.controller.driven

    def pass_time(self) -> None:
        self.service.tick()
        self.host.flush()

    def switch_off_and_on(self) -> None:
        self.controller.wake_up()


class Walker(StreamRobot):
    """gRPC without TLS: a Spot, which keeps a twist until its end time, and counts as energised until then."""

    PORT = "192.0.2.17?ca=/no/such/file"
    DRIVER = "strands_actors.drivers.spot.driver:Spot"
    FIRST = (("stand", {}),)
    MARK = "vx"
    SETTLE_S = 20.0  # it sits down before its motors go off
    OPENERS = ((spot_session, "open_tls"),)
    TIMED = (spot_session, spot_services)

    def make_twin(self) -> None:
        self.twin = SpotTwin(self.robot, self.now_s, haste=5.0, wall_ns=self.time.time_ns)
        self.host = GrpcHost(self.twin, MAX_MESSAGE)

    def handler(self) -> Handler:
        return self.host.serve

    def seams(self) -> tuple[Seam, ...]:
        return (*super().seams(), (SpotConfig, "tls", lambda config: None))

    @property
    def follows_commands(self) -> bool:
        return self.twin.mechanism.target_twist != REST

    def pass_time(self) -> None:
        self.twin.pass_time()
        self.host.flush()

    def switch_off_and_on(self) -> None:
        self.twin.mechanism.reset()
