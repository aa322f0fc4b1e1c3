"""lerobot's calibration files: one JSON file per robot id, ``{motor: {id, drive_mode, homing_offset,
range_min, range_max}}``. All values are integers, positions in encoder counts.

The caller reads a file once. Other processes get plain data.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from strands_actors.contract.shown import shown


class MotorCalibration(msgspec.Struct, frozen=True):
    """One motor of the file. ``range_min`` and ``range_max`` bound its real travel."""

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    def __post_init__(self) -> None:
        _within("id", self.id, 0, 253)
        _within("drive_mode", self.drive_mode, 0, 1)
        _within("range_min", self.range_min, 0, 4095)
        _within("range_max", self.range_max, 0, 4095)
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min {self.range_min} must be below range_max {self.range_max}")


LONGEST_ID = 100
MAX_BYTES = 1 << 20
"""A file of forty motors has 6 kB."""
FIELDS = MotorCalibration.__struct_fields__


def _within(field: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ValueError(f"{field} is {value}, must be {low}..{high}")


def folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of lerobot's calibration files, by lerobot's own environment variables."""
    if root := environ.get("HF_LEROBOT_CALIBRATION"):
        return Path(root).expanduser()
    if home := environ.get("HF_LEROBOT_HOME"):
        return Path(home).expanduser() / "calibration"
    cache = environ.get("HF_HOME") or Path(environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface"
    return Path(cache).expanduser() / "lerobot" / "calibration"


ROBOTS = "robots"
LEADERS = "teleoperators"
"""Folders of the files, as lerobot names them."""


def find(robot_types: Iterable[str], robot_id: str, root: Path | None = None, kind: str = ROBOTS) -> Path | None:
    """Return the file of a robot; None if there is no such file.

    Args:
        robot_types: lerobot's types. The first that has a file wins.
        robot_id: The id of the robot.
        root: The folder of all files. The default is ``folder()``.
        kind: ``ROBOTS`` or ``LEADERS``.

    Raises:
        ValueError: The id cannot be the name of a file.
    """
    base = folder() if root is None else root
    require_id(robot_id)
    for robot_type in robot_types:
        path = base / kind / robot_type / f"{robot_id}.json"
        if path.is_file():
            return path
    return None


def require_id(robot_id: str) -> None:
    """Raise ``ValueError`` unless the id can be the name of a file in its folder, and of no file elsewhere."""
    if not 0 < len(robot_id) <= LONGEST_ID or not robot_id.isprintable() or set(robot_id) & set("/\\"):
        raise ValueError(
            f"id is {shown(robot_id)}, and a calibration's file is called so: give 1 to {LONGEST_ID} characters "
            "without a slash"
        )


def ids(robot_types: Iterable[str], root: Path | None = None, kind: str = ROBOTS) -> list[str]:
    """Return the ids that have a file, sorted."""
    base = folder() if root is None else root
    return sorted({path.stem for robot_type in robot_types for path in (base / kind / robot_type).glob("*.json")})


def load(path: Path, motors: Mapping[str, int], max_offset: int) -> dict[str, MotorCalibration]:
    """Read a file and ``check`` its content.

    Raises:
        ValueError: The file cannot be read, or its content is wrong.
    """
    try:
        content = json.loads(_text_of(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"calibration {path}: cannot be read ({error}). Give a lerobot calibration file") from None
    return check(content, motors, max_offset, str(path))


def prepare(path: Path) -> None:
    """Make the folder of a file and write into it once, before work is done that ``save`` would lose.

    Raises:
        OSError: The file could not be saved.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    trial = _beside(path)
    trial.write_bytes(b"")
    trial.unlink()


def _beside(path: Path) -> Path:
    return path.with_suffix(f".{os.getpid()}.new")


def save(path: Path, motors: Mapping[str, MotorCalibration]) -> None:
    """Write a file in lerobot's format, whole or not at all.

    Raises:
        OSError: The file could not be written. An old file is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = _beside(path)
    content = {key: {field: getattr(motor, field) for field in FIELDS} for key, motor in motors.items()}
    with new.open("w") as file:
        json.dump(content, file, indent=4)
        file.flush()
        os.fsync(file.fileno())
    os.replace(new, path)


def _text_of(path: Path) -> str:
    """Return the text of a regular file of at most ``MAX_BYTES``. A device or a pipe might have no end, or
    wait for a writer.

    Raises:
        OSError, ValueError: It cannot be read.
    """
    if not path.is_file():
        raise ValueError("it is no file" if path.exists() else "there is none")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"it is longer than {MAX_BYTES} bytes")
    return data.decode()


def check(content: Any, motors: Mapping[str, int], max_offset: int, source: str) -> dict[str, MotorCalibration]:
    """Check the content of a file, or a dict that was given instead of a file.

    Args:
        content: The decoded content.
        motors: The names and ids that it must have.
        max_offset: The largest value that the servo's homing offset register can hold.
        source: Its name for messages.

    Raises:
        ValueError: The content is wrong. The text says where.
    """
    expected = ", ".join(motors)
    if not isinstance(content, Mapping):
        raise ValueError(f"calibration {source}: must be an object with one entry per motor: {expected}")
    missing = [name for name in motors if name not in content]
    unknown = [str(name) for name in content if name not in motors]
    if missing or unknown:
        wrong = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has unknown {', '.join(unknown)}"] * bool(
            unknown
        )
        raise ValueError(f"calibration {source}: {' and '.join(wrong)}. It must have exactly {expected}")
    checked = {name: _motor(content[name], f"calibration {source}: {name}") for name in motors}
    for name, motor in checked.items():
        if abs(motor.homing_offset) > max_offset:
            raise ValueError(
                f"calibration {source}: {name}: homing_offset is {motor.homing_offset}, "
                f"must be {-max_offset}..{max_offset}"
            )
        if motor.id != motors[name]:
            raise ValueError(
                f"calibration {source}: {name} has id {motor.id}, this robot has {motors[name]} there. "
                "Use the file of this robot"
            )
    return checked


def _motor(entry: Any, where: str) -> MotorCalibration:
    if not isinstance(entry, Mapping):
        raise ValueError(f"{where} must be an object with {', '.join(FIELDS)}")
    for field in FIELDS:
        value = entry.get(field)
        if type(value) is not int:
            shown_value = repr(value) if field in entry else "missing"
            raise ValueError(f"{where}: {field} is {shown_value}, must be an integer")
    if unknown := [str(field) for field in entry if field not in FIELDS]:
        raise ValueError(f"{where}: unknown field {', '.join(unknown)}. It must have exactly {', '.join(FIELDS)}")
    try:
        return MotorCalibration(**{field: entry[field] for field in FIELDS})
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
