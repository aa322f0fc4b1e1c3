"""Test the twin's FRI session cycle by cycle, and an independent client on its wire."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kuka.io import Io, IoDirection, IoType, decode_ios
from strands_actors.drivers.kuka.protocol import ClientMode, Command, Monitoring, Quality, State, encode_monitoring
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.twin import read_ios
from strands_actors.drivers.kuka.twin.controller import Controller
from strands_actors.testing import WireLog
from tests.answers import until
from tests.drivers.common.twin_process import TwinProcess

from .fri_client import Client

ARM = arm_of("kuka_iiwa")


class Peer:
    """A client in virtual time that answers each cycle correctly unless a test changes that."""

    def __init__(self, sample_ms: int = 5, multiplier: int = 1, ios: tuple[Io, ...] = ()) -> None:
        self.now_s = 0.0
        self.notes: list[str] = []
        self.controller = Controller(
            ARM,
            sample_ms=sample_ms,
            multiplier=multiplier,
            now_s=lambda: self.now_s,
            note=self.notes.append,
            ios=ios,
        )
        self.said = self.listen()
        self.sequence = 0

    def listen(self) -> Monitoring:
        self.now_s += self.controller.sample_ms / 1e3
        self.said = self.controller.cycle()
        return self.said

    def answer(
        self,
        position: tuple[float, ...] | None = None,
        reflected: int | None = None,
        ios: tuple[Io, ...] = (),
    ) -> Monitoring:
        if position is None:
            position = self.said.commanded if self.said.state >= State.COMMANDING_WAIT else ()
        self.sequence += 1
        self.controller.take_answer(
            Command(self.sequence, self.said.sequence if reflected is None else reflected, position, ios)
        )
        return self.listen()

    def until(self, reached: Callable[[Monitoring], bool], at_most: int = 400) -> int:
        """Answer until the condition holds. Return the number of answers."""
        for count in range(at_most):
            if reached(self.said):
                return count
            self.answer()
        raise AssertionError(f"{self.notes}, {self.said}")

    def active(self) -> Peer:
        self.until(lambda said: said.state == State.COMMANDING_ACTIVE)
        return self

    def stepped(self, joint: int, rad: float) -> tuple[float, ...]:
        position = list(self.said.commanded)
        position[joint] += rad
        return tuple(position)


def test_a_session_gets_ready_then_waits_to_be_mirrored_then_is_active() -> None:
    peer = Peer()
    assert (peer.said.state, peer.said.quality) == (State.MONITORING_WAIT, Quality.POOR)
    ready = peer.until(lambda said: said.state == State.MONITORING_READY)
    waits = ready + peer.until(lambda said: said.state == State.COMMANDING_WAIT)
    assert (ready, waits) == (20, 100)
    assert peer.said.client_mode == ClientMode.POSITION
    assert peer.said.interpolated == pytest.approx(peer.said.position, abs=1e-6)
    assert peer.until(lambda said: said.state == State.COMMANDING_ACTIVE) == 20


def test_a_client_that_does_not_mirror_does_not_command() -> None:
    peer = Peer()
    peer.until(lambda said: said.state == State.COMMANDING_WAIT)
    for _ in range(60):
        peer.answer(peer.stepped(0, 1e-3))
    assert peer.said.state == State.COMMANDING_WAIT


def test_an_answer_to_another_message_is_ignored() -> None:
    peer = Peer()
    for _ in range(300):
        peer.answer(reflected=peer.said.sequence - 1)
    assert (peer.said.state, peer.said.quality) == (State.MONITORING_WAIT, Quality.POOR)


def test_an_answer_that_comes_a_cycle_late_is_not_taken_and_not_reflected() -> None:
    peer = Peer().active()
    reported, reflected = peer.said.commanded, peer.said.reflected
    late = peer.said.sequence
    peer.listen()
    said = peer.answer(peer.stepped(0, 0.005), reflected=late)
    assert (said.commanded, said.reflected) == (reported, reflected)


def test_a_receive_multiplier_asks_for_every_third_message() -> None:
    peer = Peer(multiplier=3)
    for _ in range(600):
        peer.answer()
        peer.listen()
        peer.listen()
    assert peer.said.state == State.COMMANDING_ACTIVE
    for _ in range(40):
        peer.listen()
    assert peer.said.state == State.MONITORING_WAIT


@pytest.mark.parametrize(
    ("sample_ms", "state"),
    [(10, State.COMMANDING_ACTIVE), (5, State.COMMANDING_ACTIVE), (2, State.MONITORING_WAIT)],
)
def test_a_stall_of_31_ms_costs_the_quality_and_at_2_ms_the_session(sample_ms: int, state: State) -> None:
    peer = Peer(sample_ms).active()
    for _ in range(31 // sample_ms):
        peer.listen()
    assert peer.said.state == state
    assert peer.said.quality == (Quality.EXCELLENT if sample_ms == 10 else Quality.POOR)
    peer.active()  # the session recovers


def test_the_arm_follows_its_targets_and_stands_at_a_repeated_one() -> None:
    peer = Peer().active()
    began = peer.said.position[0]
    for _ in range(60):
        peer.answer(peer.stepped(0, 0.005))
    for _ in range(60):
        peer.answer()
    assert peer.said.position[0] - began == pytest.approx(0.3, abs=1e-3)
    assert peer.said.state == State.COMMANDING_ACTIVE


@pytest.mark.parametrize(
    ("position", "why"),
    [
        (lambda peer: peer.stepped(3, 0.0066), "joint4 steps 0.00660 rad, limit 0.00655"),
        (lambda peer: (), "an answer without positions"),
    ],
)
def test_an_impossible_target_ends_the_motion_until_the_pendant_starts_it(
    position: Callable[[Peer], tuple[float, ...]], why: str
) -> None:
    peer = Peer().active()
    peer.answer(position(peer))
    assert peer.said.state == State.MONITORING_READY
    assert why in peer.notes[-1]
    for _ in range(300):
        peer.answer()
    assert peer.said.state == State.MONITORING_READY
    peer.controller.start_program()
    peer.active()


def test_offsets_from_the_interpolated_position_do_not_add_up() -> None:
    """The vendor's examples add an offset to the interpolated position in every cycle."""
    peer = Peer().active()
    interpolated = peer.said.interpolated
    for cycle in range(400):
        offset = 0.05 * math.sin(cycle * 2 * math.pi / 200)
        said = peer.answer((interpolated[0] + offset, *interpolated[1:]))
        assert said.interpolated == interpolated, "the program's motion holds its position"
        assert said.commanded[0] == pytest.approx(interpolated[0] + offset)
        interpolated = said.interpolated
    assert (peer.said.state, peer.said.tracking) == (State.COMMANDING_ACTIVE, 1.0)
    assert peer.said.position[0] == pytest.approx(interpolated[0], abs=0.05)


def test_a_new_motion_is_interpolated_where_the_arm_stands() -> None:
    peer = Peer().active()
    for _ in range(60):
        peer.answer(peer.stepped(0, 0.005))
    for _ in range(60):
        peer.answer()
    began = peer.said.interpolated[0]
    peer.controller.motion = False
    peer.answer()
    peer.controller.start_program()
    peer.active()
    assert peer.said.interpolated[0] - began == pytest.approx(0.3, abs=1e-3)


def test_an_arm_at_its_end_goes_no_further() -> None:
    peer = Peer().active()
    for _ in range(2000):
        if peer.said.state != State.COMMANDING_ACTIVE:
            break
        peer.answer(peer.stepped(5, 0.01))
    assert "joint6 is past its end" in peer.notes[-1]
    assert abs(peer.said.position[5]) < ARM.joints[5].reach_rad * 1.01


def test_silence_drops_the_session_and_holds_the_arm() -> None:
    peer = Peer().active()
    for _ in range(20):
        peer.answer(peer.stepped(0, 0.005))
    dropped = peer.said
    for _ in range(12):
        dropped = peer.listen()
    assert dropped.state == State.MONITORING_WAIT
    stood = peer.listen().position[0]
    for _ in range(50):
        peer.listen()
    assert peer.said.position[0] == pytest.approx(stood, abs=0.01)


@pytest.mark.parametrize("drive", [False, True], ids=["safety stop", "drive off"])
def test_after_a_stop_of_the_controller_a_person_starts_the_program_again(drive: bool) -> None:
    peer = Peer().active()
    controller = peer.controller
    if drive:
        controller.drives[2] = 0
    else:
        controller.safety = 1
    peer.answer()
    with pytest.raises(
        ValueError, match=r"the program cannot start: (safety stop|a drive is off)\. End that first"
    ):
        controller.start_program()
    controller.safety, controller.drives[2] = 0, 2
    for _ in range(400):
        assert peer.answer().state == State.MONITORING_READY, "the program has ended"
    controller.start_program()
    peer.active()


@pytest.mark.parametrize(("knob", "number"), [("client_mode", ClientMode.TORQUE), ("overlay", 0)])
def test_positions_that_the_program_does_not_ask_for_move_nothing(knob: str, number: int) -> None:
    peer = Peer().active()
    commanded = peer.said.commanded
    setattr(peer.controller, knob, number)
    for _ in range(20):
        peer.answer(peer.stepped(0, 0.005))
    assert peer.said.commanded == commanded
    assert peer.said.state == State.COMMANDING_ACTIVE


# -- inputs and outputs

IOS = read_ios("Io.In:digital:input, Io.Lamp:boolean:output, Io.Level:analog:output, Io.Word:digital:output")


def monitor_data(data: bytes) -> dict[int, list[pb.Value]]:
    return pb.message(pb.last_bytes(pb.message(data), 3))


def values(said: Monitoring) -> dict[str, float]:
    return {io.name: io.value for io in said.ios}


def test_inputs_and_outputs_are_in_each_message_and_outputs_can_be_set_in_monitoring() -> None:
    peer = Peer(ios=IOS)
    assert values(peer.said) == {"Io.In": 0, "Io.Lamp": 0, "Io.Level": 0, "Io.Word": 0}
    biggest = 2**64 - 1
    peer.answer(
        ios=(
            Io("Io.Lamp", IoType.BOOLEAN, IoDirection.OUTPUT, 1),
            Io("Io.Level", IoType.ANALOG, IoDirection.OUTPUT, 2.5),
            Io("Io.Word", IoType.DIGITAL, IoDirection.OUTPUT, biggest),
        )
    )
    assert values(peer.said) == {"Io.In": 0, "Io.Lamp": 1, "Io.Level": 2.5, "Io.Word": biggest}
    assert decode_ios(monitor_data(encode_monitoring(peer.said)), 8) == peer.said.ios, "as they are on the wire"
    peer.controller.set_io("Io.In", 7)
    assert values(peer.listen())["Io.In"] == 7
    peer.controller.wake_up()
    assert values(peer.listen())["Io.Lamp"] == 0


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (Io("Io.Other", IoType.BOOLEAN, IoDirection.OUTPUT, 1), "no output Io.Other of type boolean is registered"),
        (Io("Io.In", IoType.DIGITAL, IoDirection.OUTPUT, 1), "no output Io.In of type digital is registered"),
        (Io("Io.Lamp", IoType.ANALOG, IoDirection.OUTPUT, 1.0), "no output Io.Lamp of type analog is registered"),
        (Io("Io.Lamp", IoType.BOOLEAN, IoDirection.OUTPUT, 2), "Io.Lamp is boolean, and 2 is not 0 or 1"),
    ],
)
def test_a_request_that_the_vendors_client_would_not_send_sets_nothing(request_: Io, why: str) -> None:
    peer = Peer(ios=IOS)
    before = values(peer.said)
    peer.answer(ios=(request_,))
    assert values(peer.said) == before
    assert why in peer.notes


@pytest.mark.parametrize(
    "text", ["Io.Lamp", "Io.Lamp:bool:output", "a:digital:input,a:digital:input", "x" * 64 + ":digital:input"]
)
def test_the_option_ios_names_what_it_does_not_understand(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not NAME:TYPE:DIRECTION|is none of|each name once"):
        read_ios(text)


@pytest.mark.parametrize("knob", ["safety", "drive", "motion"])
def test_stops_of_the_controller_end_the_commanding(knob: str) -> None:
    peer = Peer().active()
    if knob == "safety":
        peer.controller.safety = 1
    elif knob == "drive":
        peer.controller.drives[2] = 0
    else:
        peer.controller.motion = False
    said = peer.answer()
    assert said.state == State.MONITORING_READY
    assert (said.safety, said.drives[2]) == (knob == "safety", 0 if knob == "drive" else 2)


# -- on its wire


@pytest.mark.parametrize(
    ("sample_ms", "packed", "checksum"), [(10, False, True), (5, True, True), (2, False, False)]
)
def test_an_independent_client_becomes_active_and_moves(
    tmp_path: Path, sample_ms: int, packed: bool, checksum: bool
) -> None:
    options = {"sample_ms": sample_ms, "packed": packed, "checksum": checksum}
    with TwinProcess(tmp_path, "kuka_iiwa", "kuka", options=options) as twin:
        with Client(int(twin.port.rpartition(":")[2])) as client:
            client.until(State.COMMANDING_ACTIVE)
            assert client.sample_ms == sample_ms
            goal = [*client.commanded]
            goal[0] += 0.3
            deadline_s = time.monotonic() + 20.0
            while abs(client.measured[0] - goal[0]) > 0.005:
                assert time.monotonic() < deadline_s, client.states
                if client.cycle(goal, 0.001 * sample_ms) != State.COMMANDING_ACTIVE:
                    # The machine paused. Either the session was lost, or two answers in one cycle made too
                    # large a step. After the latter only the pendant can resume.
                    twin.command("motion start")
                    client.until(State.COMMANDING_ACTIVE)
        log = WireLog(tmp_path / "wire.ndjson")
        until(lambda: any(b"no answers" in entry.data for entry in log.entries()), "it misses its client")
    kinds = [entry.kind for entry in log.entries() if entry.sender == "host"]
    first = kinds.index("setpoint")
    assert set(kinds[:first]) == {"safe"}, "answers from before the motion command nothing"
    assert kinds[first:].count("setpoint") >= 20


def test_the_pendant_by_control_lines(tmp_path: Path) -> None:
    with (
        TwinProcess(tmp_path, "kuka_iiwa", "kuka", options={"sample_ms": 2}) as twin,
        Client(int(twin.port.rpartition(":")[2])) as client,
    ):
        client.until(State.COMMANDING_ACTIVE)
        for order in ("motion stop", "safety 1", "drive 3 0"):
            twin.command(order)
            client.until(State.MONITORING_READY)
            for line in ("safety 0", "drive 3 2", "motion start"):
                twin.command(line)
            client.until(State.COMMANDING_ACTIVE)
        twin.command("unplug")
        client.sock.settimeout(0.2)
        with pytest.raises(TimeoutError):
            while True:
                client.cycle()
        twin.command("plug")
        client.sock.settimeout(10.0)
        client.until(State.COMMANDING_ACTIVE)


def test_a_client_reads_and_sets_inputs_and_outputs_by_name(tmp_path: Path) -> None:
    ios = "Io.In:boolean:input,Io.Level:analog:output"
    with (
        TwinProcess(tmp_path, "kuka_iiwa", "kuka", options={"sample_ms": 5, "ios": ios}) as twin,
        Client(int(twin.port.rpartition(":")[2])) as client,
    ):
        client.until(State.MONITORING_READY)
        assert client.ios == {"Io.In": 0, "Io.Level": 0.0}
        client.outputs = {"Io.Level": 2.5}
        twin.command("io Io.In 1")
        until(lambda: client.cycle() and client.ios == {"Io.In": 1, "Io.Level": 2.5}, "both have changed")


def test_two_twins_do_not_meet_at_the_clients_end(tmp_path: Path) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    with (
        TwinProcess(tmp_path / "one", "kuka_iiwa", "kuka", options={"sample_ms": 2}) as one,
        TwinProcess(tmp_path / "other", "kuka_iiwa", "kuka", options={"sample_ms": 5}) as other,
    ):
        reported = []
        for twin in (one, other):
            with Client(int(twin.port.rpartition(":")[2])) as client:
                client.until(State.MONITORING_READY)
                reported.append(client.sample_ms)
    assert reported == [2, 5]
