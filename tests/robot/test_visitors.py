"""SAF-017: a program that connects to the sockets in the run directory has no rights, even if it claims
another address. It receives no lease, gets no lease, moves nothing, and cannot answer for an actor. The
tests read the simulated robot's wire log.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.kernel.channels.zenoh_session import config, unix_endpoint
from strands_actors.kernel.frames import ASK, REPLY, TELL, decode_frame, frame
from strands_actors.kernel.messages import Message
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire, Beat, Lease, Perform, Release, Setpoint, StopReport
from strands_actors.supervisors.root.messages import Rollout, Shutdown, StartTask, StateIs, StopTask
from strands_actors.supervisors.wire.messages import Write
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until
from tests.trees import begin_moving

from .helpers import COUNTS_PER_DEGREE, IDS, goals, limps

AT = addresses.of("so101")
FAR = 90.0
"""Degrees. No other command of these tests moves the arm so far."""
BOUND_S = 1.0
"""Much longer than the published bound, because the machine may be busy."""


class Visitor:
    """A program of the same user with its own zenoh session, connected to every socket that it finds. It
    knows what the source code contains, but no secret.
    """

    def __init__(self, run_dir: Path) -> None:
        sockets = sorted(run_dir.glob("*.sock"))
        assert {"so101.root.sock", "so101.wire.sock"} <= {path.name for path in sockets}
        endpoints = [portal().entrance.endpoint, *(unix_endpoint(str(path)) for path in sockets)]
        self._session = zenoh.open(config(connect=endpoints))
        self.received: list[bytes] = []
        self._cids = itertools.count(1 << 40)
        self._kept: list[Any] = []
        self.subscribe("strands/**", lambda sample: self.received.append(sample.payload.to_bytes()))

    def subscribe(self, key: str, callback: Any) -> None:
        self._kept.append(self._session.declare_subscriber(key, zenoh.handlers.Callback(callback, indirect=False)))

    def joined(self) -> None:
        """Wait until root and wire have accepted the connection. Then wait a little longer, for
        connections that take more time.
        """
        until(lambda: len(self._session.info.peers_zid()) >= 2, "root and wire let the visitor in")
        time.sleep(0.5)

    def claim(self, address: str) -> None:
        """Claim to host an actor at ``address``, and answer each ask there that the robot is safe."""

        def answer(sample: zenoh.Sample) -> None:
            head = decode_frame(sample.payload.to_bytes())
            if head.kind == ASK:
                forged = StopReport(Reason.STOP, "limp", 99, True, ())
                self._session.put(head.reply_to, frame(head.reply_to, REPLY, head.cid, "", address, forged))

        self._kept.append(self._session.liveliness().declare_token(f"{address}/alive"))
        self.subscribe(address, answer)

    def send(self, to: str, message: Message, sender: str) -> None:
        for kind in (TELL, ASK):
            self._session.put(to, frame(to, kind, next(self._cids), sender, "strands/node/visitor.1", message))

    def send_answers(self, to: str) -> None:
        """Send answers without an ask: one for each number that an ask of the caller may have."""
        forged = StopReport(Reason.STOP, "limp", 99, True, ())
        for cid in range(1, 400):
            self._session.put(to, frame(to, REPLY, cid, "", AT.gate, forged))

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open


@contextlib.contextmanager
def visitor(run_dir: Path) -> Iterator[Visitor]:
    visiting = Visitor(run_dir)
    try:
        visiting.joined()
        yield visiting
    finally:
        visiting.close()


def lease_of(arm: RealRobot) -> Lease:
    assert arm._tree is not None and arm._tree._writer.lease is not None
    return arm._tree._writer.lease


def caller_of(arm: RealRobot) -> str:
    assert arm._tree is not None
    return arm._tree._processes.node.address


def farthest(twin: Twin, since_ns: int) -> float:
    """Return the goal of the base joint on the wire that is farthest from the middle, in degrees."""
    seen = [goals(entry).get(IDS["shoulder_pan"]) for entry in twin.log.host("setpoint", since_ns)]
    return max((abs(goal - 2048) / COUNTS_PER_DEGREE for goal in seen if goal is not None), default=0.0)


def test_saf_017_a_visitor_sees_sender_receiver_and_type_of_messages_but_no_lease(
    arm: RealRobot, run_dir: Path
) -> None:
    with visitor(run_dir) as it:
        for degrees in (0.0, 3.0, 6.0):
            json_of(arm.send_action({"shoulder_pan": degrees}))
        assert arm._tree is not None
        until(lambda: any(b"Setpoint" in data for data in it.received), "the visitor sees that setpoints are sent")
        lease = msgspec.msgpack.encode(lease_of(arm).id)
        assert len(lease) == 9, "the encoded lease is long enough to be unmistakable"
        assert not [data for data in it.received if lease in data]
        # the others are messages of the mesh's topics
        frames = [data for data in it.received if not data.startswith(b"{")]
        assert frames
        assert not [data for data in frames if b"shoulder_pan" in data]


def test_saf_017_a_visitor_takes_no_lease_and_moves_nothing(arm: RealRobot, twin: Twin, run_dir: Path) -> None:
    """Neither with the holder's name nor with the number of its lease, with any sender address."""
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    lease, holder, caller = lease_of(arm), str(status(arm)["lease"]), caller_of(arm)
    began_ns = time.monotonic_ns()
    with visitor(run_dir) as it:
        for sender in ("strands/node/visitor.1", caller, f"{caller}/so101", AT.policy, AT.gate, AT.root):
            deadline_ns = time.monotonic_ns() + 10**9
            it.send(AT.gate, Acquire(holder), sender)
            it.send(AT.gate, Acquire(holder, again=lease.id), sender)
            it.send(AT.gate, Acquire("policy of so101", over=lease.id), sender)
            it.send(AT.gate, Setpoint(lease.id, lease.epoch, deadline_ns, {"shoulder_pan": FAR}), sender)
            it.send(AT.gate, Beat(lease.id), sender)
            it.send(AT.gate, Perform(lease.id, lease.epoch, "x", {}), sender)
            it.send(AT.gate, Release(lease.id), sender)
            it.send(AT.transport, Write(lease.epoch, deadline_ns, (FAR,) * len(IDS)), sender)
            it.send(AT.guardian, StateIs("disarmed", 99, "", "forged"), sender)
            it.send(AT.root, Shutdown(Reason.CLEANUP, "a visitor"), sender)
            it.send(AT.tasks, StopTask(), sender)
            rollout = Rollout("so101", tuple(IDS), "wave", 0.02, 0.1, 5.0, over=lease.id)
            it.send(AT.tasks, StartTask("sine", {"amplitude": FAR}, rollout), sender)
        time.sleep(0.5)
        assert farthest(twin, began_ns) < FAR / 2
        assert state(arm) == "armed"
        assert lease_of(arm).id == lease.id
        json_of(arm.send_action({"shoulder_pan": 5.0}))
        assert lease_of(arm).id == lease.id, "the caller keeps its lease"
        assert not json_of(arm.get_task_status())["running"]


def test_saf_017_a_visitor_that_claims_the_gates_address_answers_no_ask(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    with visitor(run_dir) as it:
        for address in (AT.gate, AT.guardian, AT.root):
            it.claim(address)
        time.sleep(0.3)
        began_ns = time.monotonic_ns()
        it.send_answers(caller_of(arm))
        answer = json_of(arm.stop())
        assert len(answer["motors"]) == len(IDS), "the forged report names no motor"
        twin.log.safe_within(began_ns, BOUND_S)
        assert limps(twin.log, began_ns)


def test_saf_017_a_visitor_answers_no_ask_when_the_gate_is_frozen(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    """The caller then stops the robot through the root, as without a visitor."""
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    wire = pids(arm)["wire"]
    with visitor(run_dir) as it:
        it.claim(AT.gate)
        time.sleep(0.3)
        began_ns = time.monotonic_ns()
        os.kill(wire, signal.SIGSTOP)
        answer = arm.stop()
        assert answer["status"] == "success", answer
        assert len(json_of(answer)["motors"]) == len(IDS)
        assert limps(twin.log, began_ns)


def test_saf_017_a_visitor_that_claimed_the_gates_address_and_leaves_ends_no_ask(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    """An ask fails at once when the connection of the asked actor ends. The end of another connection
    does not count.
    """
    json_of(arm.stop())
    answers: list[dict[str, Any]] = []
    with visitor(run_dir) as it:
        it.claim(AT.gate)
        time.sleep(0.3)
        twin.fault("delayed:6")  # so that arming takes long
        until(lambda: "gripper" in status(arm)["faults"], "the faults include the gripper")
        resuming = threading.Thread(target=lambda: answers.append(arm.resume()))
        resuming.start()
        until(lambda: state(arm) == "arming", "the robot is arming")
    time.sleep(0.3)  # the visitor has left
    twin.fault("ok")
    resuming.join()
    json_of(answers[0])
    assert state(arm) == "armed"


def test_saf_017_a_visitor_cannot_command_in_the_name_of_a_running_policy(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    """A policy has its own socket. Its lease is sent over that socket only."""
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    began_ns = time.monotonic_ns()
    with visitor(run_dir) as it:
        begin_moving(
            arm,
            lambda: arm.start_task("wave", policy_provider="sine", duration=30.0, amplitude=5.0),
            lambda told, _: told["steps"] > 5,
        )
        lease = lease_of(arm)
        for number in range(lease.id >> 32, (lease.id >> 32) + 3):
            for epoch in range(lease.epoch, lease.epoch + 2):
                deadline_ns = time.monotonic_ns() + 10**9
                setpoint = Setpoint(number << 32, epoch, deadline_ns, {"shoulder_pan": FAR})
                it.send(AT.gate, setpoint, AT.policy)
                it.send(AT.gate, Acquire("policy of so101", over=lease.id), AT.policy)
                it.send(AT.gate, Release(number << 32), AT.policy)
        time.sleep(0.5)
        assert json_of(arm.get_task_status())["running"]
        assert farthest(twin, began_ns) < FAR / 2
