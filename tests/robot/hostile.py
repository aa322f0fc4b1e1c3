"""A policy that forges messages of other actors, over its link and on the mesh, with frames that the kernel
would never send."""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence

from strands_actors.contract.driver import Reason
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.frames import ASK, HOSTS, REPLY, TELL, decode_frame, frame
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node
from strands_actors.policies.registry import Sine
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire, Beat, Resume, Setpoint, StopReport
from strands_actors.supervisors.root.messages import StateIs
from strands_actors.supervisors.wire.messages import Write

ROBOT = "so101"
FAR = 90.0
"""Position in degrees that no sine of this policy reaches."""
EVERY_S = 0.02
"""Period of the attack. With a shorter one the policy itself would be late on a busy machine, and end."""


class Hostile(Sine):
    """A ``Sine`` whose process attacks the tree every ``EVERY_S``, from its first step on.

    ``how`` selects the attack: ``gate`` (pretend to be the gate), ``resume``, ``write`` (past the gate)
    or ``stay`` (do not end).
    """

    def __init__(self, axes: Sequence[str], how: str, holder: str = "", lease: int = 0) -> None:
        super().__init__(axes, amplitude=5.0, hz=0.5)
        self._count = len(axes)
        self._holder, self._lease = holder, lease
        self._attack: Callable[[], None] | None = {
            "gate": self._be_the_gate,
            "resume": self._resume,
            "write": self._write,
            "stay": self._stay,
        }[how]
        self._at = addresses.of(ROBOT)
        self._subscribed: list[object] = []

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        if self._attack is not None:
            threading.Thread(target=self._go_on, args=(self._attack,), daemon=True).start()
            self._attack = None
        return super().step(observation)

    def _go_on(self, attack: Callable[[], None]) -> None:
        self._node = next(thing for thing in gc.get_objects() if isinstance(thing, Node))
        self._cid = 1_000_000
        while True:
            attack()
            time.sleep(EVERY_S)

    def _links(self) -> list[Link]:
        return [link for link in list(self._node._links) if isinstance(link, Link)]

    def _tell(self, to: str, message: Message, kind: int = TELL) -> None:
        """Send a forged frame over the link, and on the mesh to the receiver and to the gate, whose key is
        allowed."""
        self._cid += 1
        mesh = self._node.mesh
        assert isinstance(mesh, ZenohMesh)
        for sender in (self._node.address, self._at.gate, self._at.guardian):
            data = frame(to, kind, self._cid, sender, self._node.address, message)
            for link in self._links():
                link.send_at_once(data)
            for key in {to, self._at.gate}:
                mesh._session.put(key, data)

    def _be_the_gate(self) -> None:
        """Announce this process as the gate, answer each request to the gate, and send reports that were
        not requested."""
        forged = StopReport(Reason.ESTOP, "limp", 99, True, ())

        def receive(data: bytes, way: Link, descriptors: tuple[int, ...] = ()) -> None:
            head = decode_frame(data)
            if head.kind == ASK and head.to == self._at.gate:
                way.send_at_once(frame(head.reply_to, REPLY, head.cid, "", "", forged))
            else:
                Node.receive_frame(self._node, data, way, descriptors)

        self._node.receive_frame = receive  # type: ignore[method-assign, assignment]
        hosts = frame("", HOSTS, 1, self._at.gate, self._at.gate, None)
        for link in self._links():
            link.send_at_once(hosts)
        assert isinstance(self._node.mesh, ZenohMesh)
        self._node.mesh._session.put(self._at.gate, hosts)
        if not self._subscribed:
            self._subscribed.append(self._node.mesh._session.declare_subscriber(self._at.gate, lambda sample: None))
        self._tell(self._at.guardian, StateIs("disarmed", 99, "", "forged"))

    def _resume(self) -> None:
        """Resume the robot, acquire the caller's lease under its name, and send setpoints with it."""
        self._tell(self._at.gate, Resume("an operator"), ASK)
        self._tell(self._at.gate, Acquire(self._holder), ASK)
        self._tell(self._at.gate, Beat(self._lease))
        for epoch in range(1, 12):
            deadline_ns = time.monotonic_ns() + 10**8
            self._tell(self._at.gate, Setpoint(self._lease, epoch, deadline_ns, {"shoulder_pan": FAR}))

    def _stay(self) -> None:
        """Keep the process from ending when it is asked to end."""
        os._exit = lambda code: time.sleep(3600)  # type: ignore[assignment, return-value]

    def _write(self) -> None:
        """Send setpoints to the transport, past the gate."""
        deadline_ns = time.monotonic_ns() + 10**8
        for epoch in range(1, 12):
            self._tell(self._at.transport, Write(epoch, deadline_ns, (FAR,) * self._count))
