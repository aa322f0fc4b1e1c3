"""Test robots with legs and their tree: real processes on RTPS. The twin's log decides."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.common.rtps import CDR, Participant, discovery, messages, wire_types
from strands_actors.drivers.common.rtps.discovery import ParticipantData
from strands_actors.drivers.common.rtps.peer_address import parse_peer_address
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.driver import G1Driver
from strands_actors.drivers.unitree.protocol import CommandCodec
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import safe_state_of
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import WireLog
from strands_actors.testing.wirelog import Entry
from tests.answers import PATIENCE_S, json_of, until
from tests.drivers.common.twin_process import TwinProcess


class Legs:
    """A connected and armed robot, its twin, and the twin's log."""

    def __init__(self, robot: RealRobot, twin: TwinProcess) -> None:
        self.robot = robot
        self.twin = twin
        self.log = WireLog(twin.log_path)

    def status(self) -> dict[str, Any]:
        json: dict[str, Any] = self.robot.get_status()["content"][0]["json"]  # type: ignore[index]
        return json

    def sensor(self, name: str) -> float | None:
        row = self.status()["sensors"].get(name)
        return None if row is None else row[0]

    def refused(self, action: Mapping[str, Any]) -> tuple[str, str]:
        """Return the code and the text of a refusal."""
        answer = self.robot.send_action(action)
        assert answer["status"] == "error", answer
        text, json = answer["content"]
        return json["json"]["refused"]["code"], text["text"]

    def task(self) -> dict[str, Any]:
        json: dict[str, Any] = self.robot.get_task_status()["content"][0]["json"]
        return json

    def run(self, make_policy: Callable[[], object], setpoints: int = 100, **keywords: Any) -> int:
        """Start a rollout and wait until the robot moves. Return when it began.

        If a busy machine ends the rollout, start it again from the robot's present position.
        """
        began_ns = 0

        def moves() -> bool:
            nonlocal began_ns
            if not self.task()["running"]:
                self.robot.resume()
                began_ns = time.monotonic_ns()
                self.robot.run_policy(make_policy(), **keywords)
                return False
            return len(self.log.host("setpoint", began_ns)) > setpoints

        until(moves, "it runs", 3 * PATIENCE_S)
        return began_ns

    def wait_for_the_end(self) -> dict[str, Any]:
        until(lambda: not self.task()["running"], "the rollout ends")
        return self.task()

    def order(self, line: str, condition: Callable[[], bool]) -> None:
        self.twin.command(line)
        until(condition, line)

    def events(self, kind: str) -> list[Entry]:
        return [entry for entry in self.log.entries() if entry.sender == "robot" and entry.kind == kind]


@contextmanager
def legs(
    directory: Path, kind: str = "unitree_g1", twin: Mapping[str, Any] | None = None, **keywords: Any
) -> Iterator[Legs]:
    with TwinProcess(directory, kind, "unitree", options=dict(twin or {})) as served:
        robot = Robot(kind, mode="real", port=served.port, **keywords)
        with robot:
            yield Legs(robot, served)


class Stand:
    """A policy that keeps every joint at its first position. It returns half a second of actions at a time, for
    a busy machine."""

    def __init__(self, kp: float = 200.0, kd: float = 6.0) -> None:
        self._gains = {"kp": kp, "kd": kd}
        self._home: dict[str, Any] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, Any]]:
        if not self._home:
            self._home = {joint: {"q": rad, **self._gains} for joint, rad in observation.items()}
        return [self._home] * 250


# -- gates


def test_saf_014_a_refused_command_is_not_written(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        here = g1.robot.get_observation()
        knee, elbow = here["left_knee"], here["left_elbow"]
        fine = {"left_elbow": elbow + 0.01}

        g1.order("fsm 1", lambda: g1.sensor("fsm") == 1)
        code, words = g1.refused(fine)
        assert code == "fsm" and "FSM 1 (damp) does not accept low-level commands" in words
        g1.order("fsm 801", lambda: g1.sensor("fsm") == 801)

        g1.order("battery 12", lambda: g1.sensor("battery_pct") == 12)
        code, words = g1.refused(fine)
        assert code == "battery_low" and "battery 12.0 % is below the minimum of 15.0 %" in words
        g1.order("battery 80", lambda: g1.sensor("battery_pct") == 80)

        for action, expected in (
            ({"left_knee": 3.1}, "past_travel"),
            ({"left_knee": {"q": knee, "tau": 200}}, "too_strong"),
            ({"left_knee": {"q": knee, "dq": 50}}, "too_fast"),
            ({"left_knee": {"q": knee, "kp": 500}}, "gain"),
            ({"left_knee": {"q": knee, "kd": 50}}, "gain"),
            ({"left_knee": float("nan")}, "not_finite"),
            ({"left_knee": {"tau": 1.0}}, "no_q"),
            ({"left_knee": {"q": knee, "i": 1}}, "unknown_key"),
            ({"7": 0.1}, "unknown_joint"),
            ({"left_elbow": elbow + 0.5}, "too_fast"),
        ):
            assert g1.refused(action)[0] == expected

        answer = g1.robot.send_action(fine)["content"][0]["json"]
        assert (answer["fsm_id"], answer["joints"]) == (801, ["left_elbow"])
        assert answer["mode_machine"] == g1.status()["mode_machine"] == json_of(g1.robot.state())["mode_machine"]
        assert (g1.status()["battery_pct"], g1.status()["fsm_id"]) == (80.0, 801)
        assert len(json_of(g1.robot.state())["imu"]["rpy"]) == 3
        until(lambda: bool(g1.log.host("setpoint")), "the accepted command")
        codec = CommandCodec(model_of("g1"))
        first = codec.decode(g1.log.host("setpoint")[0].data)
        assert first.q[codec_index("left_elbow")] == pytest.approx(elbow + 0.01, abs=1e-6)
        assert not g1.log.host("garbled")


def codec_index(joint: str) -> int:
    return model_of("g1").axes.index(joint)


@pytest.mark.parametrize("kind", ["unitree_g1", "unitree_go2"])
def test_saf_014_an_unknown_battery_refuses(tmp_path: Path, kind: str) -> None:
    with legs(tmp_path, kind, twin={"battery": "unknown"}) as robot:
        if kind != "unitree_g1":
            until(lambda: robot.robot.release_sport_mode()["status"] == "success", "it is released")
            until(lambda: robot.sensor("sport_mode_released") == 1, "the tree knows")
        joint, rad = next(iter(robot.robot.get_observation().items()))
        code, words = robot.refused({joint: rad})
        assert code == "battery_unknown" and "the battery's charge is not known" in words
        assert not robot.log.host("setpoint")


def test_saf_014_a_stale_fsm_id_is_no_id(tmp_path: Path) -> None:
    """The mode that serves the id is gone, so the last answer grows old."""
    with legs(tmp_path) as g1:
        elbow = g1.robot.get_observation()["left_elbow"]
        g1.order("mode -", lambda: g1.refused({"left_elbow": {"q": elbow, "kp": -1}})[0] == "fsm_stale")
        assert not g1.log.host("setpoint")


def test_start_task_is_refused_by_name(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        answer = g1.robot.start_task("walk")
        assert answer["status"] == "error"
        assert answer["content"][0]["text"].startswith(
            "start_task: unitree_g1: a policy for legs is not started by name"
        )
        assert not g1.log.host("setpoint")


# -- rollouts


def test_saf_014_a_rollout_of_a_robot_that_may_not_move_is_refused_at_the_call(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        for order, sensor, value, code in (
            ("fsm 1", "fsm", 1, "fsm"),
            ("fsm 801", "fsm", 801, ""),
            ("battery 12", "battery_pct", 12, "battery_low"),
            ("battery 80", "battery_pct", 80, ""),
        ):
            g1.order(order, lambda sensor=sensor, value=value: g1.sensor(sensor) == value)  # type: ignore[misc]
            if code:
                answer = g1.robot.run_policy(Stand(), duration=1.0)
                assert answer["status"] == "error", answer
                assert answer["content"][0]["text"].startswith("run_policy: ")
                assert answer["content"][1]["json"]["refused"]["code"] == code
                assert g1.status()["state"] == "armed"  # the refusal does not end the arming
        assert not g1.log.host("setpoint") and not g1.task()["running"]
        assert g1.robot.run_policy(Stand(), duration=0.5)["status"] == "success"
        assert g1.wait_for_the_end()["exit_reason"] == "duration"


def test_a_policy_keeps_the_g1_on_its_feet_and_its_end_is_zero_torque(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        assert g1.robot.run_policy(Stand(), duration=3.0)["status"] == "success"
        done = g1.wait_for_the_end()
        assert done["exit_reason"] == "duration", done
        assert not [entry for entry in g1.events("fell") if entry.t_ns < g1.log.host("safe")[0].t_ns]
        until(lambda: bool(g1.events("fell")), "what nothing holds falls")
    assert g1.log.setpoints_after_safe(0) == 0
    last = [entry for entry in g1.log.entries() if entry.sender == "host" and entry.kind in ("setpoint", "safe")][
        -1
    ]
    assert safe_state_of(CommandCodec(model_of("g1")).decode(last.data)) == "zero_torque"
    assert len(g1.log.host("safe")) >= 20  # repeated


def test_saf_003_leaving_the_handshake_ends_a_rollout_at_once(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        g1.run(Stand, duration=30.0)
        g1.twin.command("fsm 1")
        done = g1.wait_for_the_end()
        assert "FSM 1" in done["exit_detail"]
    told_ns = next(
        entry.t_ns
        for entry in g1.events("answer")
        if (response := rpc.decode_response(entry.data)).api == rpc.GET_FSM_ID and rpc.fsm_id(response) == 1
    )
    asked_ns = g1.events("fsm")[-1].t_ns
    # The policy was informed within a tenth of a second. After that at most two control periods of setpoints
    # follow.
    assert len(g1.log.host("setpoint", told_ns)) <= 3
    assert (told_ns - asked_ns) / 1e9 < 0.1 + 0.4
    assert g1.log.setpoints_after_safe(told_ns) == 0


def test_saf_012_a_robot_that_falls_silent_is_lost_and_comes_back_disarmed(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        g1.run(Stand, duration=30.0)
        g1.twin.command("fault off")  # the twin receives and sends nothing
        g1.wait_for_the_end()
        until(lambda: "no usable LowState for" in (g1.status()["connect_error"] or ""), "its link is lost")
        g1.twin.command("fault ok")
        until(lambda: g1.status()["connected"] and g1.status()["state"] == "disarmed", "it is back, disarmed")
        assert g1.log.host("safe")  # motors that may still be energised are released first


@pytest.mark.long
def test_saf_020_a_robot_with_invalid_states_is_released_and_gets_every_stop(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        g1.run(Stand, duration=30.0)
        broken_ns = time.monotonic_ns()
        g1.twin.command("fault garbage")
        g1.wait_for_the_end()
        until(lambda: not g1.status()["connected"], "its link is lost")
        until(lambda: g1.log.host("safe", broken_ns), "it is let go")
        time.sleep(1.0)  # the tree searches for it in this time
        for pause_s in (0.0, 0.8):
            time.sleep(pause_s)
            stopped_ns = time.monotonic_ns()
            g1.robot.stop()
            g1.log.safe_within(stopped_ns, 1.0)
            assert g1.log.setpoints_after_safe(stopped_ns) == 0
        g1.twin.command("fault ok")
        until(lambda: g1.status()["connected"] and g1.status()["state"] == "disarmed", "it is back, disarmed")


def test_saf_020_a_wire_without_a_link_finds_the_robot_and_lets_it_go(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "unitree_g1", "unitree") as served:
        wire = G1Driver("unitree_g1", served.port, {}).open_wire(MonotonicClock())
        motors = trio.run(wire.reach, "zero_torque")
        assert all(motor.written and motor.safe for motor in motors), motors
        frames = [entry for entry in WireLog(served.log_path).entries() if entry.sender == "host"]
        states = [entry.safe_state for entry in frames if entry.kind in ("safe", "setpoint")]
        assert len(states) >= 3 and set(states) == {"zero_torque"}
        assert "other" not in {entry.kind for entry in frames}  # each has the robot's mode_machine
        wire.close()


def test_saf_012_garbled_states_do_not_count(tmp_path: Path) -> None:
    with legs(tmp_path) as g1:
        elbow = g1.robot.get_observation()["left_elbow"]
        never = {"left_elbow": {"q": elbow, "kp": -1.0}}
        g1.order("fault garbage", lambda: g1.refused(never)[0] == "stale")
        assert not g1.log.host("setpoint")
        g1.order("fault ok", lambda: g1.refused(never)[0] == "gain")


def commanded(robot: Legs, kind: str) -> list[float]:
    """Return all numbers of all LowCmds."""
    decode = CommandCodec(model_of(kind)).decode
    commands = [decode(entry.data) for entry in robot.log.host("setpoint") + robot.log.host("safe")]
    return [number for command in commands for row in command[2:] for number in row]


def test_saf_014_a_joint_without_a_position_ends_the_live_command(tmp_path: Path) -> None:
    """Its NaN would be sent as the joint's hold position, whichever joint a command names."""
    with legs(tmp_path) as g1:
        g1.run(Stand, duration=30.0)
        g1.twin.command("nan left_elbow")
        g1.wait_for_the_end()
        until(lambda: "unusable ones" in (g1.status()["connect_error"] or ""), "its link is lost")
        assert g1.log.host("safe")
        assert all(map(math.isfinite, commanded(g1, "unitree_g1")))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", ["unitree_g1", "unitree_go2", "unitree_h1", "b2"])
def test_saf_014_a_joint_that_is_nowhere_is_not_held_there(tmp_path: Path, kind: str) -> None:
    with legs(tmp_path, kind) as robot:
        if kind != "unitree_g1":
            until(lambda: robot.robot.release_sport_mode()["status"] == "success", "it is released")
            until(lambda: robot.sensor("sport_mode_released") == 1, "the tree knows")
        named, lost, *_ = model_of(kind).axes
        rad = robot.robot.get_observation()[named]
        never = {named: {"q": rad, "kp": -1.0}}
        robot.order(f"nan {lost}", lambda: robot.refused(never)[0] != "gain")  # there is no valid state any more
        robot.refused({named: rad})
        assert not robot.log.host("setpoint")
        assert all(map(math.isfinite, commanded(robot, kind)))


@pytest.mark.long
def test_a_stop_may_damp_before_it_lets_go(tmp_path: Path) -> None:
    with legs(tmp_path, on_exit="damp") as g1:
        began_ns = g1.run(Stand, duration=30.0)
        answer = g1.robot.stop()
        assert answer["status"] == "success", answer  # type: ignore[index]
        safe_states = [entry.safe_state for entry in g1.log.host("safe", began_ns)]
        damped = safe_states.count("damp")
        assert damped >= 20
        assert safe_states == ["damp"] * damped + ["zero_torque"] * (len(safe_states) - damped)
        assert len(safe_states) >= damped + 20


def test_saf_012_a_state_that_repeats_its_tick_ends_a_rollout_and_confirms_no_stop(tmp_path: Path) -> None:
    """A robot that only repeats its state gives no proof that it has released its motors."""
    with legs(tmp_path) as g1:
        g1.run(Stand, duration=30.0)
        g1.twin.command("fault stuck")
        g1.wait_for_the_end()
        until(
            lambda: "all with a tick that does not advance" in (g1.status()["connect_error"] or ""),
            "it is not found again",
        )

        def says_why() -> bool:
            answer = g1.robot.stop()
            assert answer["status"] == "error"  # type: ignore[index]
            return "no new LowState has arrived" in answer["content"][0]["text"]  # type: ignore[index]

        until(says_why, "it is heard, and says nothing new")
        g1.twin.command("fault ok")
        until(lambda: g1.robot.stop()["status"] == "success", "it shows that it has let go")  # type: ignore[index]


# -- the others


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("kind", ["unitree_go2", "unitree_h1", "unitree_h1_2", "b2"])
def test_saf_014_the_others_are_refused_until_released(tmp_path: Path, kind: str) -> None:
    with legs(tmp_path, kind) as robot:
        joint, rad = next(iter(robot.robot.get_observation().items()))
        code, words = robot.refused({joint: rad})
        assert code == "sport_mode" and "still active" in words and "release_sport_mode()" in words
        assert not robot.log.host("setpoint")

        answer = robot.robot.release_sport_mode()
        assert answer["content"][0]["json"] == {"sport_mode_released": True, "attempts": 1}
        assert [entry.data for entry in robot.events("mode")] == [b""]
        joint, rad = next(iter(robot.robot.get_observation().items()))
        until(lambda: robot.sensor("sport_mode_released") == 1, "the tree knows")
        reported = json_of(robot.robot.send_action({joint: rad}))
        assert (
            reported["sport_mode_released"] is True
            and reported["joints"] == [joint]
            and len(reported["slots"]) == 1
        )
        until(lambda: bool(robot.log.host("setpoint")), "the accepted command")
        assert not robot.log.host("garbled")  # frames of its family


def test_the_verb_is_refused_while_the_robot_is_locked_or_moved(tmp_path: Path) -> None:
    with legs(tmp_path, "unitree_go2") as go2:
        assert go2.robot.service("release_sport_mode", attempts=9)["status"] == "error"
        assert go2.robot.service("dance")["status"] == "error"
        with pytest.raises(AttributeError, match="has no attribute 'dance'"):
            go2.robot.dance()
        assert go2.robot.release_sport_mode(attempts=2)["status"] == "success"
        go2.run(lambda: Stand(60.0, 5.0), 50, duration=30.0)
        answer = go2.robot.release_sport_mode()
        assert answer["status"] == "error" and "a task is running" in answer["content"][0]["text"]
        go2.robot.stop_task()


def test_the_interface_may_be_named(tmp_path: Path) -> None:
    """Like ``network_interface="eth0"`` on a robot's network, but on the loopback."""
    with legs(tmp_path, "unitree_go2", network_interface="lo") as go2:
        assert go2.status()["connected"] is True


def test_the_answer_of_connecting(tmp_path: Path) -> None:
    with legs(tmp_path, "unitree_go2") as go2:
        status = go2.status()
        assert (status["family"], status["onboard_mode"]) == ("unitree_go", "normal")
        assert status["state"] == "armed"
        assert not go2.log.host("setpoint") and not go2.log.host("safe")  # connecting sends no commands


def test_a_stop_of_a_robot_that_stands_by_itself(tmp_path: Path) -> None:
    """The robot ignores our commands. The frames leave all the same, and the report names the mode that has
    control."""
    with legs(tmp_path, "unitree_go2") as go2:
        answer = go2.robot.stop()
        assert answer["status"] == "success", answer  # type: ignore[index]
        motors = answer["content"][0]["json"]["motors"]  # type: ignore[index]
        assert motors["FL_hip_joint"]["detail"] == "held by the robot's own controller, sport mode 'normal'"
        assert go2.log.host("safe") and not go2.events("fell")
        answer = go2.robot.cleanup()  # within the time that an ending tree gives its wire
        assert (answer or {"status": "success"})["status"] == "success", answer
    assert not go2.events("fell")


@pytest.mark.long
def test_no_peer_is_found(tmp_path: Path) -> None:
    robot = Robot("g1", mode="real", port="127.9.8.7")
    began_s = time.monotonic()
    problem = robot.connect_eagerly()
    assert problem is not None and "127.9.8.7: no robot answers" in problem
    assert time.monotonic() - began_s < PATIENCE_S
    robot.cleanup()


# -- foreign participants on the network


@pytest.mark.long
def test_saf_017_a_stranger_with_the_robots_name_ends_and_receives_nothing(tmp_path: Path) -> None:
    """Two faults of an earlier version: one datagram with the robot's GUID and a sequence number far ahead made
    every true state an old one, so the robot was let go. And a participant that listed the robot's address
    among its own became a peer."""
    with legs(tmp_path) as g1, contextlib.ExitStack() as stack:
        knee = g1.robot.get_observation()["left_knee"]
        stranger = Participant(0, "127.0.0.77", (g1.twin.port,), False)
        stack.callback(stranger.close)
        stolen: list[bytes] = []
        stranger.reader(p.COMMAND_TOPIC, p.command_type("hg"), lambda payload, *_: stolen.append(bytes(payload)))
        states = stranger.reader(p.STATE_TOPIC, p.state_type("hg"), lambda *_: None)
        has_traffic = lambda: stranger.poll() or states.matched  # noqa: E731
        until(has_traffic, "the stranger hears the robot, as anybody may")
        (guid,) = states._writers
        far = messages.header(guid[:12]) + messages.data(wire_types.UNKNOWN, guid[12:], 1 << 40, CDR + b"garbage!")
        claim = ParticipantData(
            stranger.guid_prefix,
            (parse_peer_address(g1.twin.port), *stranger._engine.data.discovery),
            stranger._engine.data.user,
            10.0,
        )
        claimed = messages.header(claim.prefix) + messages.data(
            wire_types.SPDP_READER, wire_types.SPDP_WRITER, 1, discovery.encode_participant(claim)
        )
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.bind(("127.0.0.77", 0))
            for _ in range(5):
                for port in range(7410, 7450):
                    out.sendto(far, ("127.0.0.1", port))
                    out.sendto(claimed, ("127.0.0.1", port))
                stranger.poll()
        end = time.monotonic() + 1.5
        while time.monotonic() < end:  # longer than the loss takes
            stranger.poll()
            status = g1.status()
            assert status["state"] == "armed" and 0 <= status["observation_age_s"] < 1.0, status
            time.sleep(0.05)
        assert g1.robot.send_action({"left_knee": knee})["status"] == "success"
        assert not stolen
