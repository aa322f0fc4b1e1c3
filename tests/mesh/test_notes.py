"""An unreadable note does not disable an e-stop. Looking for robots does not take a robot's name."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import trio

from strands_actors.caller.processes.run_directory import Name, Note, is_running, notes
from strands_actors.kernel.channels.zenoh_session import unix_endpoint
from strands_actors.surfaces.mesh import estop_button
from strands_actors.surfaces.mesh.sessions import EVERYBODY, LOOK_S

from .world import mesh, robot_on_mesh, run, until

BAD = {
    "empty": b"",
    "no fields": b"{}",
    "another version": b'{"name": "other", "schema": 7, "endpoints": []}',
    "no text": b"\xff\xfe\x00",
    "no endpoint": b'{"robot": "other", "kind": "", "pid": 1, "endpoints": ["tcp/x"], "mesh": ["bogus"]}',
    "another's": b'{"robot": "third", "kind": "", "pid": 1, "endpoints": [], "mesh": []}',
    "deep": b"[" * 9000,
}


@pytest.fixture
def other(run_dir: Path) -> Iterator[Name]:
    """A robot name that is in use."""
    name = Name("other")
    yield name
    name.release()


@pytest.mark.parametrize("content", BAD.values(), ids=BAD.keys())
def test_saf_007_a_bad_note_is_one_robot_that_cannot_be_reached(run_dir: Path, other: Name, content: bytes) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            (run_dir / "other.json").write_bytes(content)
            async with mesh() as client:
                outcomes = {outcome.robot: outcome for outcome in await client.estop("the button")}
            assert outcomes[robot].outcome == "safe"
            assert outcomes["other"].outcome == "unreachable"
            assert "other.json cannot be read" in outcomes["other"].detail
            assert (await tree.status()).locked_by == "the button"

    run(test)


def test_saf_007_a_robot_with_a_bad_note_is_reached_by_its_name(run_dir: Path) -> None:
    """Its sockets are in their usual place."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            (run_dir / f"{robot}.json").write_bytes(b"{}")
            async with mesh() as client:
                (outcome,) = await client.estop("the button", within_s=5.0)
            assert (outcome.robot, outcome.outcome) == (robot, "safe")
            assert (await tree.status()).locked_by == "the button"

    run(test)


@pytest.mark.parametrize("name", ["other.json", "{robot}.json"])
def test_saf_007_a_note_that_goes_bad_while_the_button_is_held_ends_no_button(
    run_dir: Path, other: Name, name: str
) -> None:
    async def pressed() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            button = estop_button(by="the button")
            press = await trio.to_thread.run_sync(button.__enter__)
            try:
                (run_dir / name.format(robot=robot)).write_bytes(b"{}")
                await trio.sleep(3 * LOOK_S)
                outcomes = {each.robot: each.outcome for each in await trio.to_thread.run_sync(press)}
                assert outcomes[robot] == "safe"
            finally:
                await trio.to_thread.run_sync(button.__exit__, None, None, None)
            assert (await tree.status()).locked_by == "the button"

    run(pressed)


def test_saf_007_a_run_directory_that_is_deleted_ends_no_button(run_dir: Path) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            for name in os.listdir(run_dir):
                os.unlink(run_dir / name)
            await trio.sleep(3 * LOOK_S)
            (outcome,) = await client.estop("the button", within_s=5.0)
            assert (outcome.robot, outcome.outcome) == (robot, "safe")
            assert (await tree.status()).locked_by == "the button"

    run(test)


def test_saf_005_an_unusable_directory_is_reported(run_dir: Path) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            os.chmod(run_dir, 0o755)
            try:
                outcomes = {each.robot: each for each in await client.estop("the button", within_s=5.0)}
            finally:
                os.chmod(run_dir, 0o700)
            assert outcomes[robot].outcome == "safe"
            assert outcomes[EVERYBODY].outcome == "unreachable"
            assert "is open to others" in outcomes[EVERYBODY].detail

    run(test)


# -- looking for robots


TAKE = """
import os
from strands_actors.caller.processes.run_directory import Name
taken = {}
for _ in range(300):
    name = Name("zz")
    taken[name.name] = taken.get(name.name, 0) + 1
    name.release()
print(taken)
"""


def test_looking_takes_no_name_from_a_starting_robot(run_dir: Path) -> None:
    """Two processes look all the time, while a third takes the name 300 times."""
    done = threading.Event()
    failures: list[BaseException] = []

    def look() -> None:
        try:
            while not done.is_set():
                list(notes())
                is_running("zz")
                (run_dir / "zz.json").write_bytes(b"{}")
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        taken = subprocess.run(
            [sys.executable, "-c", TAKE],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert taken.stdout.strip() == "{'zz': 300}"
    assert not failures, failures


def test_the_note_of_an_ended_robot_is_removed_and_that_of_a_living_one_stays(run_dir: Path) -> None:
    name = Name("zz")
    note = Note("zz", "fake", 1, [], [unix_endpoint(name.socket("mesh"))])
    name.publish(note)
    assert list(notes()) == [note]
    assert is_running("zz")
    name.release()
    assert not is_running("zz")
    assert list(notes()) == []
    assert not (run_dir / "zz.json").exists()


def test_a_starting_robot_removes_the_note_of_the_last_one(run_dir: Path) -> None:
    first = Name("zz")
    first.publish(Note("zz", "fake", 1, [], []))
    first.release()
    second = Name("zz")
    assert list(notes()) == []
    second.release()


def test_a_second_robot_of_one_name_gets_a_number(run_dir: Path) -> None:
    first, second = Name("zz"), Name("zz")
    assert (first.name, second.name) == ("zz", "zz-2")
    first.release()
    second.release()
