"""Poses that a person has stored, by robot. They are kept in a file of this user."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import msgspec

from strands_actors.caller.processes.run_directory import data_dir

from .answers import Bad

MOST_POSES = 50
MAX_NAME = 40

_Pose = dict[str, float]


def poses_file() -> Path:
    """Return the file of this user's poses."""
    return data_dir() / "console" / "poses.json"


class BadPoses(Bad):
    """A pose cannot be stored, or the file cannot be used. The text has the reason and the remedy."""

    def __init__(self, text: str) -> None:
        super().__init__(409, text)


class Poses:
    """The stored poses.

    Args:
        file: A JSON file. It is made with the first pose.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def of(self, robot: str) -> Mapping[str, _Pose]:
        """Return the poses of a robot, by name: the target of each joint, in the robot's units.

        Raises:
            BadPoses: The file cannot be read.
        """
        return self._read().get(robot, {})

    def store(self, robot: str, name: str, joints: Mapping[str, float]) -> None:
        """Store a pose. A pose of the same name is replaced.

        Raises:
            BadPoses: The name is not one, there are too many poses, or the file cannot be written.
        """
        name = name.strip()
        if not 0 < len(name) <= MAX_NAME or not name.isprintable():
            raise BadPoses(f"A name of a pose has 1 to {MAX_NAME} characters.")
        every = self._read()
        poses = every.setdefault(robot, {})
        if name not in poses and len(poses) >= MOST_POSES:
            raise BadPoses(f"{robot} has {MOST_POSES} poses. Remove one first.")
        poses[name] = dict(joints)
        self._write(every)

    def remove(self, robot: str, name: str) -> None:
        """Remove a pose.

        Raises:
            BadPoses: There is none of this name, or the file cannot be written.
        """
        every = self._read()
        if every.get(robot, {}).pop(name, None) is None:
            raise BadPoses(f"{robot} has no pose {name}.")
        self._write(every)

    def _read(self) -> dict[str, dict[str, _Pose]]:
        try:
            return msgspec.json.decode(self._file.read_bytes(), type=dict[str, dict[str, _Pose]])
        except FileNotFoundError:
            return {}
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise BadPoses(f"{self._file} cannot be read ({error}). Mend it, or move it away.") from error

    def _write(self, every: Mapping[str, Mapping[str, _Pose]]) -> None:
        new = self._file.with_suffix(f".{os.getpid()}.new")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            new.write_bytes(msgspec.json.format(msgspec.json.encode(every)))
            os.replace(new, self._file)
        except OSError as error:
            raise BadPoses(f"{self._file} cannot be written: {error.strerror or error}.") from error
