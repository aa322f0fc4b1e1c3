"""A separate link, for the supervising process (root), to a base that is driven over ROS 2. It
writes a zero twist to ``/cmd_vel`` and reads ``/odom_raw``, by DDS.

rclpy can hang, and must not be loaded in the root. The root therefore speaks RTPS, the protocol of
DDS, itself. To the robot it is one more DDS participant. This was never run on a robot.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.rtps import Participant
from strands_actors.kernel.clock import Clock

from . import messages as m
from .config import YahboomConfig, domain_of_environment
from .links import News, look_until, report_of

TWIST_TOPIC, TWIST_TYPE = "rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"
ODOMETRY_TOPIC, ODOMETRY_TYPE = "rt/odom_raw", "nav_msgs::msg::dds_::Odometry_"

CDR = b"\0\1\0\0"
"""Encapsulation of every payload, little endian CDR."""

LOOK_S = 0.01
"""Period at which a wait checks its condition."""

_TWIST = struct.Struct("<6d")
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_COVARIANCE = 36 * 8


class DdsLink:
    """The connection of the root process to the base of one robot. It sends only stops.

    Args:
        config: The settings of the robot.
        clock: The clock of this process.
        address: This machine's address; empty for the address of its default route.
        peers: Addresses at which to search for participants; empty to search by multicast.
    """

    def __init__(self, config: YahboomConfig, clock: Clock, address: str = "", peers: tuple[str, ...] = ()) -> None:
        self.news = News()
        self._config = config
        self._clock = clock
        self._address = address
        self._peers = peers
        self._participant: Participant | None = None
        self._serving = False

    @property
    def is_open(self) -> bool:
        return self._participant is not None

    async def listen(self) -> None:
        await self.connect()

    async def connect(self) -> None:
        """Join the DDS domain, and wait until the base subscribes to commands."""
        if self._participant is None:
            address = self._address or own_address()
            try:
                participant = Participant(
                    domain_of_environment(), address, self._peers, not self._peers, clock=self._clock
                )
            except ValueError as error:
                raise WireDown(f"dds: {error}") from None
            self._participant = participant
            self._writer = participant.writer(TWIST_TOPIC, TWIST_TYPE, reliable=True)
            participant.reader(ODOMETRY_TOPIC, ODOMETRY_TYPE, self._on_odometry)
        if self._writer.matched:
            return
        with trio.move_on_after(self._config.timeout_s):
            await self._until(lambda: self._writer.matched > 0)
            return
        raise WireDown(
            f"dds: no node subscribes to {m.CMD_VEL} in domain {domain_of_environment()}. Check the base"
        )

    async def receive_messages(self) -> None:
        if self._participant is None:
            raise WireDown("dds: not connected. Reconnect")
        self._serving = True
        try:
            await self._participant.run()
        finally:
            self._serving = False

    def zero(self) -> None:
        if self._participant is None:
            raise WireDown("dds: not connected. Reconnect")
        if not self._writer.write_stop(CDR + encode_twist(m.REST)):
            raise WireDown(f"dds: no node subscribes to {m.CMD_VEL}. Check the base")

    async def acknowledged(self, within_s: float) -> None:
        """Wait until every reliable subscriber has acknowledged all messages. Raise ``WireDown``
        after ``within_s`` seconds."""
        with trio.move_on_after(within_s):
            await self._until(lambda: self._writer.matched > 0 and self._writer.unacknowledged == 0)
            return
        raise WireDown(f"dds: no acknowledgement within {within_s * 1e3:.0f} ms. Check the base's node")

    async def next_report(self, within_s: float) -> Report:
        before = self.news.odometry
        with trio.move_on_after(within_s):
            await self._until(lambda: self.news.odometry is not before)
        newest = self.news.odometry
        if newest is None or newest is before:
            raise WireDown(f"dds: no odometry within {within_s * 1e3:.0f} ms. Check the base")
        return report_of(newest)

    def close(self) -> None:
        if self._participant is not None:
            self._participant.close()
        self._participant = None

    async def _until(self, is_so: Callable[[], bool]) -> None:
        def look() -> bool:
            if self._participant is None:
                raise WireDown("dds: closed")
            if not self._serving:
                self._participant.poll()
            return is_so()

        await look_until(self._clock, LOOK_S, look)

    def _on_odometry(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        try:
            self.news.take(m.ODOMETRY, decode_odometry(bytes(payload[len(CDR) :])), t_ns)
        except MalformedFrame:
            self.news.malformed += 1


def encode_twist(twist: m.Twist) -> bytes:
    """Encode a ``geometry_msgs/msg/Twist`` in CDR."""
    return _TWIST.pack(twist.x, twist.y, 0.0, 0.0, 0.0, twist.yaw)


def decode_odometry(body: bytes) -> m.Odometry:
    """Decode a ``nav_msgs/msg/Odometry`` in little endian CDR, without its covariances. Raise
    ``MalformedFrame``."""
    try:
        sec, nanosec = _STAMP.unpack_from(body)
        offset = _STAMP.size
        for _ in ("frame_id", "child_frame_id"):
            offset += -offset % 4
            offset += _LENGTH.size + _LENGTH.unpack_from(body, offset)[0]
        offset += -offset % 8
        x_m, y_m, _, qx, qy, qz, qw = _POSE.unpack_from(body, offset)
        vx, vy, _, _, _, wz = _TWIST.unpack_from(body, offset + _POSE.size + _COVARIANCE)
    except struct.error as error:
        raise MalformedFrame(f"Odometry: {error}") from None
    return m.Odometry(sec * 10**9 + nanosec, x_m, y_m, m.yaw_of(m.Quaternion(qx, qy, qz, qw)), m.Twist(vx, vy, wz))


def own_address() -> str:
    """Return this machine's address towards other participants; the loopback address if there is no
    network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            # The address at which DDS participants discover each other.
            sock.connect(("239.255.0.1", 7400))
        except OSError:
            return "127.0.0.1"
        address: str = sock.getsockname()[0]
        return address
