"""A recording's file opens with mcap's own reader and shows the events. A damaged file is refused in one line."""

from __future__ import annotations

import json
import math
import random
import tracemalloc
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Acquire, Lease, LinkLost, Observed, Resume, Stop
from strands_actors.supervisors.instrument import Attached, Batch, Entry, Kind, encode
from strands_actors.supervisors.root.messages import Happened, StateIs
from strands_actors.surfaces.recording import RecordingError, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.surfaces.recording.file import METADATA, RecordingFile, new_info, read
from strands_actors.surfaces.recording.rows import CHANNELS, Command, Gap, Lifecycle, schema
from strands_actors.surfaces.recording.views import View
from strands_actors.testing import run_virtual

from .tape import Tape, open_tape
from .test_replay import again, lively

WALL_NS = 1_700_000_000_000_000_000
PYTHON_TYPES: dict[str, tuple[type, ...]] = {
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "object": (dict,),
    "array": (list,),
    "null": (type(None),),
}


def batch_of(*lines: tuple[Kind, str, int, int, str, object]) -> Batch:
    return Batch(1, 1, tuple(msgspec.Raw(encode(line)) for line in lines))


@pytest.mark.parametrize("path", [None, 5, b"x.mcap", ["x"], {}, "", "a\0b"])
def test_an_invalid_path_is_refused_by_name_and_nothing_is_written(
    path: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordingError, match=r"record: path is .*\. Give a path"), record("so101", path):
        pass
    with pytest.raises(RecordingError, match=r"read: path is .*\. Give a path"):
        read(path)
    with pytest.raises(RecordingError, match=r"replay: recording is .*\. Give a path"):
        replay(path)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("robot", [None, 5, b"so101", ["so101"], Path("so101"), ""])
def test_an_invalid_robot_is_refused_by_name(robot: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with pytest.raises(RecordingError, match=r"record: robot is .*\. Give a connected robot"), record(robot, path):
        pass


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lively run of a robot in memory, as a file."""
    path = tmp_path_factory.mktemp("file") / "run.mcap"

    async def make() -> None:
        async with open_tape() as tape:
            await tape.attach()
            await lively(tape)
            tape.tree.hardware.silent.add("b")
            await tape.tree.gate.ask(Stop(Reason.STOP, "op"), 1.0)
            tape.tree.hardware.silent.clear()
            await tape.tree.gate.ask(Resume("op"), 1.0)
            await tape.detach()
            write(tape, path)

    run_virtual(make)
    return path


def write(tape: Tape, path: Path) -> None:
    attached = Attached(tape.attached.driver, ("a", "b"), "units")
    file = RecordingFile(path, msgspec.structs.replace(new_info("fake", "c0de", attached), wall_ns=WALL_NS))
    for batch in tape.taker.batches:
        file.add("wire", batch)
    file.close()


def rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in CHANNELS}
    with path.open("rb") as stream:
        for described, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert described is not None
            assert (channel.message_encoding, described.encoding) == ("json", "jsonschema")
            robot, name = channel.topic.strip("/").split("/")
            assert robot == "fake"
            assert 0 <= message.log_time - WALL_NS < 10**18
            row = json.loads(message.data)
            check(row, json.loads(described.data))
            found[name].append(row)
    return found


def check(value: Any, shape: dict[str, Any]) -> None:
    """Validate a row as a JSON schema validator does, for the keywords that our schemas use."""
    kinds = [choice for choice in shape.get("anyOf", [shape]) if matches(value, choice)]
    assert kinds, (value, shape)
    for name, part in kinds[0].get("properties", {}).items():
        if name in value:
            check(value[name], part)
    for name in kinds[0].get("required", ()):
        assert name in value
    if "properties" in kinds[0]:
        assert set(value) <= set(kinds[0]["properties"])
    for item in value if isinstance(value, list) else ():
        check(item, kinds[0].get("items", {}))


def matches(value: Any, shape: dict[str, Any]) -> bool:
    kinds = shape.get("type")
    if kinds is None:
        return True
    return isinstance(value, PYTHON_TYPES[kinds])


def test_a_recording_opens_with_its_schemas_and_shows_the_events(run: Path) -> None:
    seen = rows(run)
    setpoints = [row for row in seen["command"] if row["what"] == "setpoint"]
    accepted = [row for row in setpoints if row["outcome"] == "accepted"]
    assert [row["target"]["a"] for row in accepted] == [1.0, 2.0, 2.0]
    assert {row["code"] for row in setpoints if row["outcome"] == "refused"} == {"range", "locked_out"}
    assert {row["what"] for row in seen["command"]} == {"setpoint", "acquire", "stop", "e-stop", "resume"}
    (too_far, locked) = seen["refusal"]
    assert (too_far["code"], too_far["offered"], locked["code"]) == ("range", "1000.0", "locked_out")
    assert "resume" in locked["remedy"]
    ordered = [(row["safe_state"], row["reason"]) for row in seen["safe"] if row["what"] == "ordered"]
    assert ordered == [("hold", "expired"), ("hold", "lease"), ("limp", "estop"), ("limp", "stop")]
    done = [row for row in seen["safe"] if row["what"] == "done"]
    assert [row["confirmed"] for row in done] == [True, True, True, False]
    assert [motor["axis"] for motor in done[3]["motors"] if not motor["safe"]] == ["b"]
    states = [row["mode"] for row in seen["lifecycle"] if row["what"] == "state"]
    assert states == [
        "arming", "armed", "holding", "armed", "holding", "stopping", "disarmed", "arming", "armed", "stopping",
        "unconfirmed", "arming", "armed",
    ]  # fmt: skip
    assert {row["locked_by"] for row in seen["lifecycle"] if row["what"] == "state"} == {"", "op"}
    assert [row["detail"] for row in seen["lifecycle"] if row["what"] == "lease granted"] == ["writer", "writer"]
    assert len(seen["observation"]) > 50 and seen["observation"][-1]["position"].keys() == {"a", "b"}
    assert seen["gap"] == []


def test_the_log_is_foxgloves(run: Path) -> None:
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    names = {
        summary.channels[at].topic: summary.schemas[summary.channels[at].schema_id].name for at in summary.channels
    }
    assert names["/fake/log"] == "foxglove.Log"
    lines = rows(run)["log"]
    assert {line["level"] for line in lines} == {2, 3, 4}
    (unconfirmed,) = [line["message"] for line in lines if line["level"] == 4]
    assert unconfirmed == "limp NOT CONFIRMED by b"
    assert all(line["timestamp"]["sec"] * 10**9 + line["timestamp"]["nsec"] >= WALL_NS for line in lines)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_schema_is_an_object_without_references(name: str) -> None:
    plain = schema(CHANNELS[name])
    assert plain["type"] == "object"
    assert "$ref" not in json.dumps(plain)


def test_a_recording_that_is_read_back_is_replayed(run: Path) -> None:
    recording = read(run)
    assert recording.info.code == "c0de" and recording.info.attached.axes == ("a", "b")
    outcome = again(recording)
    # The robot has another name in the file than in memory, and its driver is built anew.
    assert outcome.equal, outcome.difference
    assert outcome.steps > 300


def test_a_recording_is_readable_by_its_owner_alone(run: Path) -> None:
    assert run.stat().st_mode & 0o777 == 0o600


def test_a_small_file_is_not_read_for_long(tmp_path: Path) -> None:
    """Its chunks have the largest allowed size, and hold hundreds of thousands of tiny messages."""
    size = bomb(tmp_path / "many.mcap", 4 << 20, 2)
    assert size < 32_000
    with pytest.raises(RecordingError, match="would decompress to too many bytes"):
        read(tmp_path / "many.mcap")


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "mine.txt"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        RecordingFile(path, new_info("fake", "", Attached({}, (), "")))
    assert path.read_text() == "mine"


# -- damage


@pytest.mark.parametrize("part", [0.0, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_file_is_reported(run: Path, tmp_path: Path, part: float) -> None:
    data = run.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(RecordingError, match=r"truncated|is not an MCAP file") as refused:
        read(path)
    assert "\n" not in str(refused.value) and str(path) in str(refused.value)


def test_no_damage_is_taken_for_a_recording(run: Path, tmp_path: Path) -> None:
    data, order, path = run.read_bytes(), random.Random(4), tmp_path / "bad.mcap"
    whole, refused = read(run), 0
    for _ in range(200):
        at = order.randrange(8, len(data) - 8)
        damaged = bytearray(data)
        damaged[at : at + 8] = order.randbytes(8)
        path.write_bytes(damaged)
        try:
            found = read(path)
        except RecordingError as error:
            assert "\n" not in str(error)
            refused += 1
        else:  # in a part that no replay needs, such as an index or a library's name
            assert found.parts == whole.parts
    assert refused > 100


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "a.txt"
    text.write_text("hello")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        read(text)
    foreign = tmp_path / "foreign.mcap"
    writer = Writer(str(foreign))
    writer.start()
    writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match="is not a recording of strands-actors"):
        read(foreign)
    newer = tmp_path / "newer.mcap"
    writer = Writer(str(newer))
    writer.start()
    writer.add_metadata(METADATA, {"info": json.dumps({"format": 99, "version": "9.0"})})
    writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match=r"format 99, written by strands-actors 9\.0"):
        read(newer)


# -- rows


def test_messages_of_the_root_are_shown() -> None:
    view = View("root", ("a",), WALL_NS)
    batch = batch_of(
        (Kind.NOTED, "guardian", 5, 0, "", Happened("the wire has ended", "signal 9")),
        (Kind.NOTED, "guardian", 6, 0, "", StateIs("down", 4, "", "signal 9")),
        (Kind.REFUSED, "gate", 0, 0, "Junk", Refused("wrong_type", "Gate does not take Junk")),
    )
    shown = list(view.rows(msgspec.msgpack.decode(encode(batch.entries), type=list[Entry])))
    assert [(channel, at_ns) for channel, at_ns, _ in shown] == [
        ("lifecycle", 5), ("log", 5), ("lifecycle", 6), ("log", 6), ("refusal", 6), ("log", 6),
    ]  # fmt: skip
    assert getattr(shown[4][2], "request", "") == "Junk to gate"


def test_a_lease_that_is_given_after_a_hold_is_an_accepted_acquire() -> None:
    view = View("wire", ("a",), WALL_NS)
    batch = batch_of(
        (Kind.TOOK, "gate", 5, 1, "", Acquire("writer")),
        (Kind.DEFERRED, "gate", 0, 3, "", None),
        (Kind.TOOK, "gate", 6, 1, "", Resume("op")),
        (Kind.DEFERRED, "gate", 0, 4, "", None),
        (Kind.TOOK, "gate", 9, 0, "", LinkLost("of what follows")),
        (Kind.SETTLED, "gate", 0, 4, "", Refused("late", "too late", verb="resume")),
        (Kind.SETTLED, "transport", 0, 3, "", Lease(1, 1)),
        (Kind.SETTLED, "gate", 0, 3, "", Lease(7, 2)),
    )
    shown = list(view.rows(msgspec.msgpack.decode(encode(batch.entries), type=list[Entry])))
    acquired = [row for _, _, row in shown if isinstance(row, Command) and row.type == "acquire"]
    assert [(row.outcome, row.by, row.lease, row.epoch) for row in acquired] == [
        ("later", "writer", 0, 0), ("accepted", "", 1, 1), ("accepted", "writer", 7, 2),
    ]  # fmt: skip
    granted = [row.detail for _, _, row in shown if isinstance(row, Lifecycle) and row.event == "lease granted"]
    assert granted == ["", "writer"]


def test_a_missing_reading_is_null(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    attached = Attached({}, ("a", "b"), "")
    file = RecordingFile(path, msgspec.structs.replace(new_info("fake", "", attached), wall_ns=WALL_NS))
    observation = Observation(
        3, (math.nan, 1.5), (0, 3), sensors={"voltage_v": (math.inf, 7.4)}, faults={"a": "silent"}
    )
    file.add("wire", batch_of((Kind.TOOK, "gate", 3, 0, "", Observed(observation, 0, 1))))
    file.add("wire", batch_of((Kind.TOOK, "gate", 9, 0, "", LinkLost("the cable is out"))))
    file.lost("root", "the root process ended")
    file.close()
    seen = rows(path)
    assert seen["observation"] == [
        {
            "t_ns": 3,
            "oldest_ns": 3,
            "position": {"a": None, "b": 1.5},
            "velocity": {},
            "sensors": {"voltage_v": [None, 7.4]},
            "faults": {"a": "silent"},
        }
    ]
    assert seen["lifecycle"][0]["detail"] == "the cable is out"
    assert seen["gap"] == [{"source": "root", "missing": -1, "why": "the root process ended"}]
    assert not any(isinstance(part, Gap) for part in read(path).parts), "the wire's journal has no gap"


# -- a small file that expands to a large one


def bomb(path: Path, chunk_bytes: int, chunks: int) -> int:
    """Write an MCAP file with rows of zeros, which compress very well. Return its size."""
    with path.open("xb") as stream:
        writer = Writer(stream, chunk_size=chunk_bytes)
        writer.start(profile="", library="strands-actors")
        channel = writer.register_channel("/so101/other", "json", 0)
        for number in range(chunks):
            writer.add_message(channel, number, bytes(chunk_bytes), number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path.stat().st_size


@pytest.mark.parametrize(("chunk_bytes", "chunks"), [(64 << 20, 1), (8 << 20, 12)])
def test_a_small_file_does_not_become_a_large_one(tmp_path: Path, chunk_bytes: int, chunks: int) -> None:
    """A file of 131 kB once took 4.2 GB of memory."""
    size = bomb(tmp_path / "bomb.mcap", chunk_bytes, chunks)
    assert size < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match="would decompress to too many"):
            read(tmp_path / "bomb.mcap")
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 64 << 20


def test_a_file_with_an_invalid_driver_is_refused(run: Path) -> None:
    info = read(run).info
    for driver in ({"robot": "so101"}, {}, {**info.attached.driver, "options": 7}):
        attached = msgspec.structs.replace(info.attached, driver=driver)
        with pytest.raises((RecordingError, KeyError)) as refused:
            build_driver(msgspec.structs.replace(info, attached=attached))
        assert isinstance(refused.value, RecordingError), refused.value
