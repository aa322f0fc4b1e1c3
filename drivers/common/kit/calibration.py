"""Read, check and write lerobot's calibration files.

There is one JSON file per robot id: ``{motor: {id, drive_mode, homing_offset, range_min, range_max}}``. All values
are integers; positions are encoder counts. Only the process of the user's script reads a file. Other processes
receive its content.
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
    """The calibration of one motor. ``range_min`` and ``range_max`` are the ends of the joint's travel, in
    counts."""

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
    """Return the folder of lerobot's calibration files. lerobot's environment variables can move it."""
    if root := environ.get("HF_LEROBOT_CALIBRATION"):
        return Path(root).expanduser()
    if home := environ.get("HF_LEROBOT_HOME"):
        return Path(home).expanduser() / "calibration"
    cache = environ.get("HF_HOME") or Path(environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface"
    return Path(cache).expanduser() / "lerobot" / "calibration"


ROBOTS = "robots"
LEADERS = "teleoperators"
"""Folders of the files, as lerobot names them."""


def find(
    robot_types: Iterable[str], robot_id: str, root: Path | None = None, category: str = ROBOTS
) -> Path | None:
    """Return the path of a robot's calibration file; None if there is no such file.

    Args:
        robot_types: The names that lerobot may use for this type of robot. The first with a file is used.
        robot_id: The id of the robot.
        root: The folder of all files. The default is ``folder()``.
        category: ``ROBOTS`` or ``LEADERS``.

    Raises:
        ValueError: The id cannot be the name of a file.
    """
    base = folder() if root is None else root
    require_id(robot_id)
    for robot_type in robot_types:
        path = base / category / robot_type / f"{robot_id}.json"
        if path.is_file():
            return path
    return None


def require_id(robot_id: str) -> None:
    """Raise ``ValueError`` unless the id can be a file name. It must not lead to a file outside the folder."""
    if not 0 < len(robot_id) <= LONGEST_ID or not robot_id.isprintable() or set(robot_id) & set("/\\"):
        raise ValueError(
            f"id is {shown(robot_id)}, which cannot name a calibration file. Give 1 to {LONGEST_ID} characters "
            "without a slash"
        )


def ids(robot_types: Iterable[str], root: Path | None = None, category: str = ROBOTS) -> list[str]:
    """Return the sorted robot ids for which a calibration file exists."""
    base = folder() if root is None else root
    return sorted(
        {path.stem for robot_type in robot_types for path in (base / category / robot_type).glob("*.json")}
    )


def load(path: Path, motors: Mapping[str, int], max_offset: int) -> dict[str, MotorCalibration]:
    """Read a file and ``check`` its content.

    Raises:
        ValueError: The file cannot be read, or its content is wrong.
    """
    try:
        content = json.loads(text_of(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"calibration {path}: cannot be read ({error}). Give a lerobot calibration file") from None
    return check(content, motors, max_offset, str(path))


def prepare(path: Path) -> None:
    """Make the folder of a file, and check that it can be written. Call it before a calibration, so that no
    calibration is done that ``save`` could not write.

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
    """Write a file in lerobot's format. If writing fails, an existing file is unchanged.

    Raises:
        OSError: The file could not be written.
    """
    save_json(path, {key: {field: getattr(motor, field) for field in FIELDS} for key, motor in motors.items()})


def save_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file. If writing fails, an existing file is unchanged.

    Raises:
        OSError: The file could not be written.
    """
    save_text(path, json.dumps(content, indent=4))


def save_text(path: Path, text: str) -> None:
    """Write a text file. If writing fails, an existing file is unchanged.

    Raises:
        OSError: The file could not be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = _beside(path)
    with new.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(new, path)


def text_of(path: Path) -> str:
    """Return the text of a regular file of at most ``MAX_BYTES``. A device or a pipe is refused, because reading it
    might never end.

    Raises:
        OSError, ValueError: The file cannot be read.
    """
    if not path.is_file():
        raise ValueError("it is not a regular file" if path.exists() else "it does not exist")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"the file is longer than {MAX_BYTES} bytes")
    return data.decode()


def check(content: Any, motors: Mapping[str, int], max_offset: int, source: str) -> dict[str, MotorCalibration]:
    """Check the content of a calibration file, or a dict that was given instead of a file.

    Args:
        content: The decoded content.
        motors: The motors that it must have, each with the id of its servo.
        max_offset: The largest value that the servo's homing offset register can hold.
        source: The name of the file or dict, for messages.

    Raises:
        ValueError: The content is wrong. The exception's text names the motor and the field.
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
                f"calibration {source}: the file has id {motor.id} for {name}, this robot has id {motors[name]}. "
                "Use the calibration file of this robot"
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
