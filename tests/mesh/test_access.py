"""Certificates decide which commands a sender may send. A refused command does not disturb the robot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest
import trio
import zenoh

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes.nodes import open_node
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.channels.zenoh_session import config
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout
from strands_actors.supervisors import addresses
from strands_actors.supervisors.mesh.gateway import Gateway
from strands_actors.supervisors.mesh.gateway_messages import Sync, Synced
from strands_actors.surfaces.mesh import TLS, Access, MeshConfig, control, open_mesh
from strands_actors.surfaces.mesh.keys import make
from strands_actors.surfaces.mesh.outcome import outcome_of
from strands_actors.testing import FakeHardware, Twin
from tests.ports import free_port

from .world import Samples, code, robot_on_mesh, run, tls, until


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a set of keys, and a second set with the same names from another authority."""
    directory = tmp_path_factory.mktemp("keys")
    make(directory / "ours", ("operator", "viewer", "alice", "bob"), robots=("so101", "arm-b"))
    make(directory / "theirs")
    return directory


@pytest.fixture
def port() -> int:
    return free_port()


def served(keys: Path, port: int, access: Access | None = None) -> Callable[[str], MeshConfig]:
    """Return a function that gives a robot a mesh configuration with its own certificate."""

    def config_of(robot: str) -> MeshConfig:
        make(keys / "ours", (), robots=[robot])
        own = tls(keys / "ours", robot)
        return MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=own, access=access or Access())

    return config_of


def away(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Point this process at an empty run directory, so that it finds no robot on its own host."""
    elsewhere = run_dir / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(elsewhere))


def test_a_viewer_reads_an_operator_commands_a_stranger_is_kept_out(
    keys: Path, port: int, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        hardware = FakeHardware()
        here = served(keys, port)
        async with robot_on_mesh(hardware, here) as (robot, tree, _):
            away(run_dir, monkeypatch)
            endpoint = f"tls/localhost:{port}"

            async with open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "ours", "viewer"))) as viewer:
                states = Samples(viewer, f"strands/{robot}/state")
                await states.wait(2)
                assert viewer.robots == [robot]
                with pytest.raises(PermissionError, match="no answer"):
                    async with control(viewer, robot):
                        pass
                assert isinstance(await viewer.resume(robot), Refused)
                outcomes = await viewer.estop()
                assert [outcome.outcome for outcome in outcomes] == ["unreachable"]
                assert (await tree.status()).mode == "armed"

            async with open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "theirs", "operator"))) as stranger:
                states = Samples(stranger, f"strands/{robot}/state")
                await trio.sleep(1.0)
                assert (stranger.robots, states.received) == ([], [])
                (outcome,) = await stranger.estop()
                assert (outcome.robot, outcome.outcome) == (endpoint, "unreachable")
                assert (await tree.status()).mode == "armed"

            assert hardware.of("setpoint") == []
            async with open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "ours", "operator"))) as operator:
                await until(lambda: operator.is_there(robot), "the robot is there")
                async with control(operator, robot) as arm:
                    assert not isinstance(await arm.send_action({"a": 1.0}), Refused)
                    await until(lambda: hardware.of("setpoint"), "a setpoint")
                (outcome,) = await operator.estop(within_s=5.0)
                assert (outcome.robot, outcome.outcome) == (robot, "safe")

    run(test)


def test_a_robot_with_an_address_in_use_does_not_start(keys: Path, port: int) -> None:
    async def test() -> None:
        taken = MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=tls(keys / "ours", "so101"))
        async with robot_on_mesh(config=served(keys, port)):
            second = Robot("so101", mode="real", transport="twin", mesh=taken)
            problem = await trio.to_thread.run_sync(second.connect_eagerly)
            await trio.to_thread.run_sync(second.cleanup)
        assert problem is not None
        assert str(port) in problem and "in use" in problem

    run(test)


# -- a client that pretends to be a robot


class Impostor:
    """A server that claims to be each of ``robots`` and answers every stop with "safe"."""

    def __init__(self, port: int, tls_of: TLS, robots: Sequence[str]) -> None:
        settings = MeshConfig(tls=tls_of).settings()
        self.robots = robots
        self.heard: list[str] = []
        self._session = zenoh.open(config([f"tls/127.0.0.1:{port}"], [], settings))
        self._tokens = [self._session.liveliness().declare_token(f"strands/{robot}/alive") for robot in robots]
        self._inbox = self._session.declare_subscriber(
            "strands/**", zenoh.handlers.Callback(self._on, indirect=False)
        )

    def _on(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if not key.endswith(("/estop", "broadcast", "/cmd")):
            return
        self.heard.append(key)
        request = json.loads(sample.payload.to_bytes())
        motors = [{"axis": "shoulder_pan", "id": 1, "safe": True, "detail": ""}]
        for robot in self.robots:
            result = {"outcome": "safe", "safe_state": "limp", "path": "wire", "motors": motors, "locked": True}
            answer = {"type": "response", "responder_id": robot, "turn_id": request["turn_id"], "timestamp": 0.0}
            self._session.put(
                f"strands/{request['sender_id']}/response/{robot}/{request['turn_id']}",
                json.dumps({**answer, "result": result}),
            )

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def test_saf_017_a_viewer_or_operator_cannot_be_a_server(keys: Path, port: int) -> None:
    async def test() -> None:
        impostor = Impostor(port, tls(keys / "ours", "viewer"), ["so101"])
        endpoint = f"tls/localhost:{port}"
        try:
            async with open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "ours", "operator"))) as operator:
                await operator.settle(1.0)
                outcomes = await operator.estop(within_s=2.0)
        finally:
            impostor.close()
        assert [(each.robot, each.outcome) for each in outcomes] == [(endpoint, "unreachable")]
        assert not impostor.heard

    run(test)


@pytest.mark.long
def test_saf_017_a_robots_certificate_is_not_valid_for_another_robot(
    keys: Path, port: int, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The forged robot has the name of a running robot, or of a robot that does not exist."""

    async def test() -> None:
        here = served(keys, port)
        second = free_port()
        async with robot_on_mesh(config=here) as (robot, tree, _):
            away(run_dir, monkeypatch)
            impostor = Impostor(second, tls(keys / "ours", "arm-b"), [robot, "ghost"])
            true, false = f"tls/localhost:{port}", f"tls/localhost:{second}"
            there = MeshConfig(connect=[false, true], tls=tls(keys / "ours", "operator"))
            try:
                async with open_mesh(there) as operator:
                    states = Samples(operator, "strands/*/state")
                    await until(lambda: operator.is_there(robot), "the true one is there")
                    await states.wait()
                    assert operator.robots == [robot]
                    outcomes = {each.robot: each for each in await operator.estop(within_s=5.0)}
                    assert set(outcomes) == {robot, false}
                    assert len(outcomes[robot].motors) == len(tree.driver.axes), "the forged answer names one motor"
                    assert outcomes[false].outcome == "unreachable" and "arm-b" in outcomes[false].detail
                    answer = await operator.stop(robot)
                    assert (answer.outcome, len(answer.motors)) == ("safe", len(tree.driver.axes))
            finally:
                impostor.close()

    run(test)


@pytest.mark.long
def test_saf_017_a_handle_connects_only_to_its_own_robot(keys: Path, port: int) -> None:
    """The handle sends nothing to a server that has another robot's certificate."""
    impostor = Impostor(port, tls(keys / "ours", "arm-b"), ["so101"])
    mesh = MeshConfig(tls=tls(keys / "ours", "operator"))
    arm = Robot("so101", mode="real", at=f"tls/localhost:{port}", mesh=mesh)
    try:
        assert "does not answer" in (arm.connect_eagerly() or "")
    finally:
        arm.cleanup()
        impostor.close()


def test_a_robot_with_another_ones_certificate_does_not_start(keys: Path, port: int) -> None:
    others = MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=tls(keys / "ours", "arm-b"))
    arm = Robot("so101", mode="real", transport="twin", mesh=others)
    try:
        problem = arm.connect_eagerly() or ""
        assert "certificate of 'arm-b'" in problem and "mesh keys DIR --robot so101" in problem
    finally:
        arm.cleanup()


def test_safe_without_a_motor_is_not_safe() -> None:
    assert outcome_of("so101", {"outcome": "safe"}).outcome == "unconfirmed"
    assert (
        outcome_of("so101", {"outcome": "safe", "motors": [{"axis": "a", "safe": False}]}).outcome == "unconfirmed"
    )
    assert outcome_of("so101", {"outcome": "safe", "motors": [{"axis": "a", "safe": True}]}).outcome == "safe"


# -- a client that pretends to be another operator


def test_saf_017_an_operator_cannot_send_for_another_or_read_its_answers(
    keys: Path, port: int, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the client that asks receives the names of the robot's clock and of its lease. A command without
    them is refused."""

    async def test() -> None:
        hardware = FakeHardware()
        access = Access(operators=["alice", "bob"])
        here = served(keys, port, access)
        async with robot_on_mesh(hardware, here) as (robot, tree, _):
            away(run_dir, monkeypatch)
            endpoint = f"tls/localhost:{port}"
            async with (
                open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "ours", "alice"))) as alice,
                open_mesh(MeshConfig(connect=endpoint, tls=tls(keys / "ours", "bob"))) as bob,
            ):
                assert alice.sender.startswith("alice.")
                overheard: list[str] = []
                for session in bob.sessions.all:
                    for key in ("strands/**", f"strands/{alice.sender}/response/**", "strands/*/response/**"):
                        session.subscribe(key, lambda received: overheard.append(received.key))
                await until(lambda: alice.is_there(robot) and bob.is_there(robot), "the robot is there")
                async with control(alice, robot) as arm:
                    assert not isinstance(await arm.send_action({"a": 1.0}), Refused)
                    await until(lambda: hardware.of("setpoint"), "a setpoint")
                    epoch = (await tree.status()).epoch
                    bob.sender = alice.sender
                    for clock in ("", "0" * 32):
                        move = {"action": "move", "targets": {"a": 3.0}, "lease": arm._lease, "epoch": epoch}
                        await bob.post(robot, {**move, "clock": clock or "x", "deadline_ns": 1 << 60})  # type: ignore[arg-type]
                    for action in ("ping", "sync", "status"):  # ignored, although these requests need no lease
                        assert code(await bob.request(robot, {"action": action}, 0.3)) == "no_answer"
                    resumed = bob.request(robot, {"action": "resume", "clock": "x", "deadline_ns": 1 << 60}, 0.3)
                    assert isinstance(await resumed, Refused)
                    assert {written.values for written in hardware.of("setpoint")} == {(1.0, 0.0)}
                assert not [key for key in overheard if "/response/" in key]

    run(test)


def test_saf_017_the_gateway_accepts_only_names_of_the_senders_certificate(
    keys: Path, port: int, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node's name must begin with the name in its certificate. The gateway ignores all other requests."""

    async def test() -> None:
        here = served(keys, port, Access(operators=["alice", "bob"]))
        async with robot_on_mesh(config=here) as (robot, _, _):
            away(run_dir, monkeypatch)
            gateway, at = addresses.of(robot).gateway, [f"tls/localhost:{port}"]
            for certificate, name, heard in (
                ("alice", "alice.caller.1", True),
                ("bob", "alice.caller.1", False),
                ("bob", "bob.caller.1", True),
                ("bob", "bob", False),
            ):
                settings = MeshConfig(tls=tls(keys / "ours", certificate)).settings()
                tokens = f"{gateway}/**/alive"
                async with open_node(name, [], at, settings, tokens, private=[gateway]) as (node, _):
                    mesh = node.mesh
                    assert isinstance(mesh, ZenohMesh)
                    await until(partial(mesh._alive.__contains__, gateway), "the gateway is there")
                    try:
                        answer = await node.ref(gateway, Gateway).ask(Sync(), 2.0 if heard else 0.3)
                    except AskTimeout:
                        answer = None
                    assert isinstance(answer, Synced) is heard, (certificate, name)

    run(test)


# -- a flood

FLOOD = """
import json, sys, time, zenoh
endpoint, settings, seconds, rate = sys.argv[1], json.loads(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
config = zenoh.Config()
for key, value in {"scouting/multicast/enabled": False, "connect/endpoints": [endpoint], **settings}.items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
time.sleep(0.5)
move = {"action": "move", "targets": {"shoulder_pan": 60.0}, "lease": 1, "epoch": 2, "clock": "c", "deadline_ns": 1}
payload = json.dumps({"sender_id": "forger", "turn_id": "1", "command": move}).encode()
nobody = zenoh.handlers.Callback(lambda reply: None, indirect=False)
print("begins", flush=True)
began, sent = time.monotonic(), 0
while (passed := time.monotonic() - began) < seconds:
    while sent < passed * rate:
        if sys.argv[5] == "put":
            session.put("strands/so101/cmd", payload)
        else:
            session.get("strands/so101/cmd/operator.x", nobody, payload=payload, timeout=5.0)
        sent += 1
    time.sleep(0.001)
print(sent, flush=True)
session.close()
"""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as process:
        yield process


def stop_s(robot: RealRobot, twin: Twin) -> float:
    """Return the time from the call to the safe frame on the wire."""
    began_ns = time.monotonic_ns()
    assert robot.stop()["status"] == "success"  # the answer is final, not pending
    return twin.log.safe_within(began_ns, 10.0)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(("role", "verb"), [("viewer", "put"), ("operator", "put"), ("operator", "get")])
def test_saf_006_a_flood_of_forged_commands_moves_nothing_and_delays_no_stop(
    role: str, verb: str, keys: Path, port: int, twin: Twin
) -> None:
    """A viewer may send no commands. An operator may, but these commands name a lease that it does not hold."""
    seconds = float(os.environ.get("STRANDS_ACTORS_FLOOD_S", "2"))
    here = MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=tls(keys / "ours", "so101"))
    robot = Robot("so101", mode="real", port=twin.port, mesh=here)
    settings = MeshConfig(tls=tls(keys / "ours", role)).settings()
    try:
        assert robot.connect_eagerly() is None
        before = robot.get_observation()
        calm_s = stop_s(robot, twin)
        assert robot.resume()["status"] == "success"
        began_ns = time.monotonic_ns()
        flood = subprocess.Popen(
            [
                sys.executable,
                "-c",
                FLOOD,
                f"tls/localhost:{port}",
                json.dumps(settings),
                str(seconds),
                "20000",
                verb,
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        with flood:
            assert flood.stdout is not None
            assert flood.stdout.readline() == "begins\n"
            took: list[float] = []
            while flood.poll() is None and len(took) < 40:
                time.sleep(0.2)
                took.append(stop_s(robot, twin))
                assert robot.resume()["status"] == "success"
            sent = int(flood.stdout.readline())
        took.sort()
        figures = ", ".join(f"{1e3 * each:.1f}" for each in (calm_s, took[len(took) // 2], took[-1]))
        print(
            f"{role}, {verb}: {sent / seconds:.0f} commands/s for {seconds:g} s; ms to the safe frame: "
            f"calm, median, worst of {len(took)}: {figures}"
        )
        assert twin.log.host("setpoint", began_ns) == []
        tree = robot.tree()
        assert tree is not None
        assert {each["role"]: each["restarts"] for each in tree["processes"]}["wire"] == 0, "the wire restarted"
        after = robot.get_observation()
        assert abs(after["shoulder_pan"] - before["shoulder_pan"]) < 3.0
        assert took[-1] < 0.5  # for a busy machine; 20 ms on a free one
        assert sent > 1000
    finally:
        robot.cleanup()
