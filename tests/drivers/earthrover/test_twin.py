"""Test the twin's service with ``requests``, and its cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import requests  # type: ignore[import-untyped]
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.earthrover import cameras
from strands_actors.drivers.earthrover import protocol as p
from strands_actors.drivers.earthrover.twin import RoverTwin, twin_of
from strands_actors.testing import Twin
from tests.answers import until


class Clock:
    """A clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class Client:
    """A client with the unmodified ``requests``."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._session = requests.Session()
        self._session.trust_env = False

    def ask(self, method: str, target: str, body: object = None) -> tuple[int, dict[str, Any]]:
        response = self._session.request(method, f"http://{self._address}{target}", json=body, timeout=5.0)
        return response.status_code, response.json()

    def close(self) -> None:
        self._session.close()


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("earthrover", tmp_path) as process:
        yield process


@pytest.fixture
def client(twin: Twin) -> Iterator[Client]:
    one = Client(twin.port)
    yield one
    one.close()


def test_an_independent_client_drives_looks_and_stops(client: Client, twin: Twin) -> None:
    status, answer = client.ask("POST", "/control", {"command": {"linear": 0.5, "angular": 0.0, "lamp": 1}})
    assert (status, answer) == (200, {"message": "Command sent successfully"})
    data = until(lambda: (now := client.ask("GET", "/data")[1])["speed"] == 0.5 and now, "it drives")
    assert data["lamp"] == 1 and data["battery"] == 88
    assert client.ask("POST", "/control", {})[0] == 400
    assert client.ask("POST", "/control", {"command": {}}) == (400, {"detail": "Command not provided"})
    assert client.ask("GET", "/nothing")[0] == 404
    client.ask("POST", "/control", {"command": {"linear": 0, "angular": 0, "lamp": 0}})
    until(lambda: client.ask("GET", "/data")[1]["speed"] == 0, "it stands")
    assert [one.kind for one in twin.log.entries() if one.sender == "host" and one.kind != "read"] == [
        "setpoint", "other", "other", "other", "safe",
    ]  # fmt: skip


def test_calls_take_no_longer_than_the_wire(client: Client) -> None:
    took_s = []
    for _ in range(100):
        began_s = time.monotonic()
        client.ask("GET", "/data")
        took_s.append(time.monotonic() - began_s)
    quarter_s = sorted(took_s)[25]  # the first few are always quick
    assert quarter_s < 0.04, "44 ms for each call would be Nagle's algorithm with delayed acknowledgements"


def test_both_cameras_have_pictures(twin: Twin) -> None:
    for view in p.PICTURES:
        seen = cameras.take_picture(f"http://{twin.port}", view)
        assert seen.jpeg.startswith(b"\xff\xd8") and seen.stamp_s >= 0
    with pytest.raises(ValueError, match=r"no camera 'left'\. Use front or rear"):
        cameras.take_picture(twin.port, "left")


def test_a_picture_that_never_changes_is_not_shown_however_often_it_is_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The SDK process has stopped, and returns its last picture for ever."""
    told_s = 1234.5

    async def ask(client: Any, view: str) -> p.Picture:
        return p.Picture(b"", told_s)

    monkeypatch.setattr(cameras, "_ask", ask)
    monkeypatch.setattr(cameras, "_pixels", lambda jpeg: None)
    monkeypatch.setattr(cameras, "PICTURE_S", 0.1)
    client: Any = None

    async def read() -> None:
        nonlocal told_s
        for _ in range(2):
            opened = cameras.RoverCamera(client, "front")
            with pytest.raises(WireDown, match="repeats its last picture"):
                await opened.read()
        told_s += 0.1
        await opened.read()
        with pytest.raises(WireDown):
            await opened.read()

    trio.run(read)


def test_a_missing_rear_camera_is_reported() -> None:
    twin, _ = rover(rear=False)
    assert twin.answer(Request("GET", "/v2/rear", {}, b"", b"")).status == 404
    assert twin.answer(Request("GET", "/v2/front", {}, b"", b"")).status == 200


# -- the rover itself


def rover(**options: Any) -> tuple[RoverTwin, Clock]:
    clock = Clock()
    return twin_of("earthrover", clock, **options), clock


def control(twin: RoverTwin, body: bytes) -> None:
    assert twin.answer(Request("POST", "/control", {}, body, b"")).status == 200


def run(twin: RoverTwin, clock: Clock, seconds: float) -> p.Data:
    for _ in range(round(seconds / 0.05)):
        clock.now_s += 0.05
        twin.rover.pass_time()
    return p.decode_data(twin.data())


def test_it_runs_its_last_command_until_the_services_own_watchdog() -> None:
    twin, clock = rover()
    control(twin, p.encode_setpoint(0.5, 0, 0))
    assert run(twin, clock, 2.8).speed == 0.5
    assert run(twin, clock, 0.6).speed == 0.0
    never, clock = rover(watchdog_s=0)
    control(never, p.encode_setpoint(0.5, 0, 0))
    assert run(never, clock, 20.0).speed == 0.5


def test_a_turn_is_seen_in_the_heading_and_a_drive_in_the_position() -> None:
    twin, clock = rover()
    control(twin, p.encode_setpoint(0, 0.5, 0))
    assert 270 < run(twin, clock, 1.0).heading_deg < 360, "a left turn lowers the compass heading"
    control(twin, p.encode_setpoint(1, 0, 0))
    before = p.decode_data(twin.data())
    after = run(twin, clock, 1.0)
    assert (after.latitude_deg, after.longitude_deg) != (before.latitude_deg, before.longitude_deg)


def test_without_a_fix_it_reports_no_position() -> None:
    twin, clock = rover(fix=False)
    assert run(twin, clock, 0.1).latitude_deg != run(twin, clock, 0.1).latitude_deg, "the latitude is NaN"


def test_a_stuck_rover_repeats_its_last_report_and_stands() -> None:
    twin, clock = rover()
    control(twin, p.encode_setpoint(0.5, 0, 0))
    before = run(twin, clock, 0.5)
    twin.set_fault(Fault.STUCK)
    assert p.decode_data(twin.data()).stamp_s >= before.stamp_s
    run(twin, clock, 0.5)
    reported = p.decode_data(twin.answer(Request("GET", "/data", {}, b"", b"")).body)
    assert reported.speed == 0.5 and twin.rover.runs == (0.0, 0.0)


@pytest.mark.parametrize("body", [b"{}", b'{"text": ""}', b"hello", b'{"text": 3}'])
def test_without_a_text_nothing_is_spoken(body: bytes) -> None:
    twin, _ = rover()
    answer = twin.answer(Request("POST", "/speak", {}, body, b""))
    assert (answer.status, answer.body, twin.spoken) == (400, b'{"detail":"Text not provided"}', "")
    assert twin.answer(Request("POST", "/speak", {}, b'{"text": "hello"}', b"")).status == 200
    assert twin.spoken == "hello"
