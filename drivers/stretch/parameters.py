"""Read the robot's own YAML, and return the parameters that the driver uses.

There are two files in the robot's fleet folder: ``stretch_configuration_params.yaml`` (its calibration), and
``stretch_user_params.yaml``, which overrides it. Both override the values that all robots of a model share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.servo.axes import COUNTS

from .protocol import Config, Gains, gains_of, pimu_config
from .robots import HEAD, TABLES, merged, nominal_of, robot_of

FILES = ("stretch_configuration_params.yaml", "stretch_user_params.yaml")
PATH, ID = "HELLO_FLEET_PATH", "HELLO_FLEET_ID"


class Motor(msgspec.Struct, frozen=True):
    """Parameters of one stepper motor. During a guarded motion the motor stops when a contact current is
    exceeded."""

    usb: str
    gains: Gains
    rad_per_m: float
    speed_m_s: float
    acceleration_m_s2: float
    feedforward_a: float
    contact_a: tuple[float, float]  # contact currents in the positive and the negative direction
    low_m: float = 0.0
    high_m: float = 0.0

    @property
    def has_watchdog(self) -> bool:
        return bool(self.gains.config & Config.VELOCITY_WATCHDOG)


class Joint(msgspec.Struct, frozen=True):
    """Parameters of one Dynamixel servo. ``ticks = zero + scale * radians``."""

    key: str
    id: int
    zero: float
    scale: float
    low_t: int
    high_t: int
    speed_rad_s: float
    acceleration_rad_s2: float
    gear: float
    needs_homing: bool


class Chain(msgspec.Struct, frozen=True):
    usb: str
    baud: int
    joints: tuple[Joint, ...]
    others: tuple[int, ...]


class Parameters(msgspec.Struct, frozen=True):
    model_name: str
    tool: str
    lift: Motor
    arm: Motor
    left: Motor
    right: Motor
    separation_m: float
    wheel_m_s: float
    """Largest speed of a wheel."""
    pimu_usb: str
    pimu_config: tuple[float, ...]
    wrist: Chain
    head: Chain


def folder_of(environment: Mapping[str, str]) -> Path:
    """Return the folder of the robot's own YAML files (its fleet folder). Raise ``WireDown`` if the environment
    variables do not name it."""
    path, number = environment.get(PATH), environment.get(ID)
    if not path or not number:
        raise WireDown(
            f"{PATH} and {ID} are not set. Run this on the robot, where they name the folder of its YAML"
        )
    return Path(path) / number


def read_folder(robot: str, folder: Path) -> Parameters:
    """Read the parameters in a folder. Raise ``WireDown`` if a file is unreadable or belongs to another robot."""
    # Import yaml only here, because only a real robot needs it.
    import yaml

    words: dict[str, Any] = {}
    for name in FILES:
        try:
            content = yaml.safe_load((folder / name).read_text("utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise WireDown(f"{folder / name} cannot be read ({_first_line(error)}). Check {PATH}") from None
        if content is not None and not isinstance(content, dict):
            raise WireDown(f"{folder / name} contains no YAML mapping. Restore the robot's own file")
        words = merged(words, content or {})
    try:
        return parameters_of(robot, words)
    except ValueError as error:
        raise WireDown(f"{folder}: {error}") from None


def parameters_of(robot: str, content: Mapping[str, Any] | None = None) -> Parameters:
    """Return the parameters of a robot.

    Args:
        robot: Name of the robot.
        content: Content of the robot's YAML; None for the values that all robots of the model share.

    Raises:
        ValueError: The YAML belongs to another model, names an unknown tool, or lacks a valid value.
    """
    name = TABLES.canonical(robot)
    table, own = robot_of(name), dict(content or {})
    about = own.get("robot") or {}
    model = about.get("model_name", table.model_name)
    if model != table.model_name:
        raise ValueError(f"its YAML is of a {model}, but {name} is a {table.model_name}. Use the robot's own name")
    tool = about.get("tool", table.tool if content is None else _shipped_tool(name))
    if tool not in table.tools:
        raise ValueError(f"its YAML names the tool {tool!r}. {name} may have {', '.join(table.tools)}")
    words = merged(nominal_of(name), own)
    try:
        return _parameters(words, model, tool, table.tools[tool].joints, table.tools[tool].gripper)
    except KeyError as missing:
        raise ValueError(f"{missing} is missing") from None
    except (TypeError, IndexError, ZeroDivisionError) as error:
        raise ValueError(f"a value has a wrong type or range: {error}") from None


def _shipped_tool(robot: str) -> str:
    """Return the tool of a robot if its YAML names no tool: the default of the package hello-robot-stretch-body."""
    return "tool_stretch_gripper" if robot == "stretch" else robot_of(robot).tool


def _parameters(
    words: Mapping[str, Any], model: str, tool: str, joints: tuple[str, ...], gripper: int
) -> Parameters:
    base = words["base"]
    wheel_rad_per_m = base["gr"] * 2 / base["wheel_diameter_m"]
    left, right = (_wheel(words, side, wheel_rad_per_m) for side in ("left", "right"))
    lift, arm = words["lift"], words["arm"]
    pulley_m = lift["pinion_t"] * lift["belt_pitch_m"] / math.tau
    sprocket_m = arm["chain_pitch"] * arm["chain_sprocket_teeth"] / arm["gr_spur"] / math.tau
    whole = Parameters(
        model_name=model,
        tool=tool,
        lift=_prismatic(words, "lift", 1 / pulley_m),
        arm=_prismatic(words, "arm", 1 / sprocket_m),
        left=left,
        right=right,
        separation_m=float(base["wheel_separation_m"]),
        wheel_m_s=float(base["motion"]["max"]["vel_m"]),
        pimu_usb=words["pimu"]["usb_name"],
        pimu_config=pimu_config(words["pimu"]["config"]),
        wrist=_chain(words, "end_of_arm", joints, (gripper,) if gripper else ()),
        head=_chain(words, "head", HEAD, ()),
    )
    if not all(math.isfinite(number) for number in _numbers(msgspec.to_builtins(whole))):
        raise ValueError("a number is not finite")
    return whole


def _prismatic(words: Mapping[str, Any], name: str, rad_per_m: float) -> Motor:
    joint, gains = words[name], words[f"hello-motor-{name}"]["gains"]
    contact = joint["contact_models"]["effort_pct"]
    low, high = contact["contact_thresh_default"]
    lowest, highest = contact["contact_thresh_max"]
    motion = joint["motion"]["default"]
    low_m, high_m = joint["range_m"]
    return Motor(
        usb=joint["usb_name"],
        gains=gains_of(gains),
        rad_per_m=rad_per_m,
        speed_m_s=float(motion["vel_m"]),
        acceleration_m_s2=float(motion["accel_m"]),
        feedforward_a=float(joint["i_feedforward"]),
        contact_a=(
            min(high, highest, 100) / 100 * gains["iMax_pos"],
            max(low, lowest, -100) / 100 * abs(gains["iMax_neg"]),
        ),
        low_m=float(low_m),
        high_m=float(high_m),
    )


def _wheel(words: Mapping[str, Any], side: str, rad_per_m: float) -> Motor:
    base, gains = words["base"], words[f"hello-motor-{side}-wheel"]["gains"]
    motion = base["motion"]["default"]
    share = min(base["contact_models"]["effort_pct"]["contact_thresh_translate_default"], 100) / 100
    return Motor(
        usb=base[f"usb_name_{side}_wheel"],
        gains=gains_of(gains),
        rad_per_m=rad_per_m,
        speed_m_s=float(motion["vel_m"]),
        acceleration_m_s2=float(motion["accel_m"]),
        feedforward_a=0.0,
        contact_a=(share * gains["iMax_pos"], -share * gains["iMax_pos"]),
    )


def _chain(words: Mapping[str, Any], name: str, joints: tuple[str, ...], others: tuple[int, ...]) -> Chain:
    chain = words[name]
    return Chain(chain["usb_name"], int(chain["baud"]), tuple(_joint(words[key], key) for key in joints), others)


def _joint(words: Mapping[str, Any], key: str) -> Joint:
    sign = -1.0 if words["flip_encoder_polarity"] else 1.0
    low_t, high_t = words["range_t"]
    motion = words["motion"]["default"]
    return Joint(
        key=key,
        id=int(words["id"]),
        zero=float(words["zero_t"]),
        scale=sign * words["gr"] * COUNTS / math.tau,
        low_t=int(low_t),
        high_t=int(high_t),
        speed_rad_s=float(motion["vel"]),
        acceleration_rad_s2=float(motion["accel"]),
        gear=float(words["gr"]),
        needs_homing=bool(words["req_calibration"]),
    )


def _numbers(value: Any) -> list[float]:
    if isinstance(value, float):
        return [value]
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return [number for each in inner for number in _numbers(each)]


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
