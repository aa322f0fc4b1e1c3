"""SAF-017: who opens the sockets in the run directory is a visitor, whatever it calls itself: it
hears no lease, takes none, moves nothing, and answers for nobody. Read from the wire."""

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
"""Degrees, where nobody else sends the arm."""
BOUND_S = 1.0
"""Far above what is published, for a busy machine."""


class Visitor:
    """A program of this user with a session of its own, on every socket that it finds. It knows
    what it read in our source, and the secret of nobody."""

    def __init__(self, run_dir: Path) -> None:
        found = sorted(run_dir.glob("*.sock"))
        assert {"so101.root.sock", "so101.wire.sock"} <= {path.name for path in found}
        endpoints = [portal().entrance.endpoint, *(unix_endpoint(str(path)) for path in found)]
        self._session = zenoh.open(config(connect=endpoints))
        self.heard: list[bytes] = []
        self._cids = itertools.count(1 << 40)
        self._kept: list[Any] = []
        self.listens("strands/**", lambda sample: self.heard.append(sample.payload.to_bytes()))

    def listens(self, key: str, callback: Any) -> None:
        self._kept.append(self._session.declare_subscriber(key, zenoh.handlers.Callback(callback, indirect=False)))

    def joined(self) -> None:
        """Wait until those that let it in have, and whoever would a little later had the time."""
        until(lambda: len(self._session.info.peers_zid()) >= 2, "root and wire let it in")
        time.sleep(0.5)

    def claims(self, address: str) -> None:
        """To host an actor, and answers whoever asks it that the robot is safe."""

        def answer(sample: zenoh.Sample) -> None:
            head = decode_frame(sample.payload.to_bytes())
            if head.kind == ASK:
                forged = StopReport(Reason.STOP, "limp", 99, True, ())
                self._session.put(head.reply_to, frame(head.reply_to, REPLY, head.cid, "", address, forged))

        self._kept.append(self._session.liveliness().declare_token(f"{address}/alive"))
        self.listens(address, answer)

    def says(self, to: str, message: Message, sender: str) -> None:
        for kind in (TELL, ASK):
            self._session.put(to, frame(to, kind, next(self._cids), sender, "strands/node/visitor.1", message))

    def answers(self, to: str) -> None:
        """What nobody has asked it: to each of the numbers that a question of the caller may
        have."""
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
    """Degrees from the middle: the farthest goal of the base joint on the wire."""
    seen = [goals(entry).get(IDS["shoulder_pan"]) for entry in twin.log.host("setpoint", since_ns)]
    return max((abs(goal - 2048) / COUNTS_PER_DEGREE for goal in seen if goal is not None), default=0.0)


def test_saf_017_a_visitor_hears_who_tells_whom_what_and_no_lease(arm: RealRobot, run_dir: Path) -> None:
    with visitor(run_dir) as it:
        for degrees in (0.0, 3.0, 6.0):
            json_of(arm.send_action({"shoulder_pan": degrees}))
        assert arm._tree is not None
        until(lambda: any(b"Setpoint" in data for data in it.heard), "it is shown that there are setpoints")
        lease = msgspec.msgpack.encode(lease_of(arm).id)
        assert len(lease) == 9, "a number that no other one looks like"
        assert not [data for data in it.heard if lease in data]
        frames = [data for data in it.heard if not data.startswith(b"{")]  # those are of the mesh's topics
        assert frames
        assert not [data for data in frames if b"shoulder_pan" in data]


def test_saf_017_a_visitor_takes_no_lease_and_moves_nothing(arm: RealRobot, twin: Twin, run_dir: Path) -> None:
    """Neither by the holder's name nor with the number of its lease, whoever it says that it is."""
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    lease, holder, caller = lease_of(arm), str(status(arm)["lease"]), caller_of(arm)
    began_ns = time.monotonic_ns()
    with visitor(run_dir) as it:
        for sender in ("strands/node/visitor.1", caller, f"{caller}/so101", AT.policy, AT.gate, AT.root):
            deadline_ns = time.monotonic_ns() + 10**9
            it.says(AT.gate, Acquire(holder), sender)
            it.says(AT.gate, Acquire(holder, again=lease.id), sender)
            it.says(AT.gate, Acquire("policy of so101", over=lease.id), sender)
            it.says(AT.gate, Setpoint(lease.id, lease.epoch, deadline_ns, {"shoulder_pan": FAR}), sender)
            it.says(AT.gate, Beat(lease.id), sender)
            it.says(AT.gate, Perform(lease.id, lease.epoch, "x", {}), sender)
            it.says(AT.gate, Release(lease.id), sender)
            it.says(AT.transport, Write(lease.epoch, deadline_ns, (FAR,) * len(IDS)), sender)
            it.says(AT.guardian, StateIs("disarmed", 99, "", "forged"), sender)
            it.says(AT.root, Shutdown(Reason.CLEANUP, "a visitor"), sender)
            it.says(AT.tasks, StopTask(), sender)
            rollout = Rollout("so101", tuple(IDS), "wave", 0.02, 0.1, 5.0, over=lease.id)
            it.says(AT.tasks, StartTask("sine", {"amplitude": FAR}, rollout), sender)
        time.sleep(0.5)
        assert farthest(twin, began_ns) < FAR / 2
        assert state(arm) == "armed"
        assert lease_of(arm).id == lease.id
        json_of(arm.send_action({"shoulder_pan": 5.0}))
        assert lease_of(arm).id == lease.id, "it was not given up, and nobody else has it"
        assert not json_of(arm.get_task_status())["running"]


def test_saf_017_a_visitor_that_calls_itself_the_gate_answers_nobody(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    with visitor(run_dir) as it:
        for address in (AT.gate, AT.guardian, AT.root):
            it.claims(address)
        time.sleep(0.3)
        began_ns = time.monotonic_ns()
        it.answers(caller_of(arm))
        answer = json_of(arm.stop())
        assert len(answer["motors"]) == len(IDS), "the forged report names no motor"
        twin.log.safe_within(began_ns, BOUND_S)
        assert limps(twin.log, began_ns)


def test_saf_017_nor_when_the_gate_is_frozen(arm: RealRobot, twin: Twin, run_dir: Path) -> None:
    """The caller's stop then goes by the root, as if there were no visitor."""
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    wire = pids(arm)["wire"]
    with visitor(run_dir) as it:
        it.claims(AT.gate)
        time.sleep(0.3)
        began_ns = time.monotonic_ns()
        os.kill(wire, signal.SIGSTOP)
        answer = arm.stop()
        assert answer["status"] == "success", answer
        assert len(json_of(answer)["motors"]) == len(IDS)
        assert limps(twin.log, began_ns)


def test_saf_017_a_visitor_that_was_the_gate_and_leaves_ends_no_question(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    """Who has asked a gate is told when that goes; nobody else's going is it."""
    json_of(arm.stop())
    answers: list[dict[str, Any]] = []
    with visitor(run_dir) as it:
        it.claims(AT.gate)
        time.sleep(0.3)
        twin.fault("delayed:6")  # so that arming takes its time
        until(lambda: "gripper" in status(arm)["faults"], "the fault is there")
        resuming = threading.Thread(target=lambda: answers.append(arm.resume()))
        resuming.start()
        until(lambda: state(arm) == "arming", "it arms")
    time.sleep(0.3)  # it has left
    twin.fault("ok")
    resuming.join()
    json_of(answers[0])
    assert state(arm) == "armed"


def test_saf_017_a_visitor_does_not_write_as_the_policy_that_runs(
    arm: RealRobot, twin: Twin, run_dir: Path
) -> None:
    """A policy has a socket of its own, and its lease is told to it alone."""
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
                it.says(AT.gate, setpoint, AT.policy)
                it.says(AT.gate, Acquire("policy of so101", over=lease.id), AT.policy)
                it.says(AT.gate, Release(number << 32), AT.policy)
        time.sleep(0.5)
        assert json_of(arm.get_task_status())["running"]
        assert farthest(twin, began_ns) < FAR / 2
