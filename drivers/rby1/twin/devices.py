"""The parts of the simulated robot besides its joints: LED, tool flanges, position gains, battery and clock."""

from __future__ import annotations

import datetime
import zoneinfo
from typing import NamedTuple

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.rby1.commands import encode_duration

from .journal import Journal
from .parameters import Invalid, Parameters

NS = 1_000_000_000
BATTERY_V = 56.74
_CONFIG = "battery_config"
VOLTS = {1: 0, 2: 12, 3: 24}
"""Voltage of a tool flange by the number of the order."""


class Gains(NamedTuple):
    """Position gains of a joint, in the motor's own units."""

    p: int
    i: int
    d: int


def _gains() -> dict[str, Gains]:
    """Return the vendor's defaults, from example 11 of rby1-sdk."""
    arm = [Gains(80, 15, 200)] * 3 + [Gains(35, 5, 80)] + [Gains(30, 5, 70)] * 2
    torso = [Gains(100, 20, 900), *[Gains(1000, 38, 900)] * 2]
    torso += [Gains(220, 40, 400), Gains(50, 20, 400), Gains(220, 40, 400)]
    rows = {
        "torso": torso,
        "right_arm": [*arm, Gains(100, 5, 120)],
        "left_arm": [*arm, Gains(100, 5, 150)],
        "head": [Gains(800, 0, 4000)] * 2,
    }
    return {f"{part}_{number}": gains for part, row in rows.items() for number, gains in enumerate(row)}


GAINS = _gains()


class Led(msgspec.Struct, frozen=True):
    """What the LED shows. After its duration the robot's own colour shows again [assumed]."""

    color: tuple[int, int, int] = (0, 0, 0)
    duration_s: float = 0.0
    transition_s: float = 0.0
    blink_hz: float = 0.0


class Flange(msgspec.Struct):
    """A tool flange. It has power only with the motors' supply [assumed]."""

    volts: int = 0
    outputs: list[bool] = msgspec.field(default_factory=lambda: [False, False])

    def encode(self) -> bytes:
        """Encode ``ToolFlangeState``, without the inertial sensor, which is not modelled."""
        return (
            pb.bytes_field(1, encode_duration(0.0))
            + pb.varint_field(5, self.volts)
            + b"".join(pb.varint_field(8 + channel, on) for channel, on in enumerate(self.outputs))
        )


class Battery:
    """The level of the battery, which the robot computes from its voltage, or which a client fixes."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._fixed_pct = 100.0

    @property
    def level_pct(self) -> float:
        """The level by the vendor's formula: a polynomial of the voltage."""
        fixed, _, _, *coefficients = self._parameters.row(_CONFIG)
        if fixed:
            return self._fixed_pct
        level = sum(factor * BATTERY_V**power for power, factor in enumerate(coefficients))
        return min(100.0, max(0.0, level))

    def fix(self, level_pct: float) -> None:
        """Fix the level. Raise ``Invalid`` beyond 0 and 100."""
        if not 0.0 <= level_pct <= 100.0:
            raise Invalid(f"a level of {level_pct}")
        self._fixed_pct = level_pct
        self._parameters.put(_CONFIG, [1.0, *self._parameters.row(_CONFIG)[1:]])

    def configure(self, values: list[float]) -> None:
        """Set the voltages of the empty and of the full battery, and the four factors. Raise ``Invalid``."""
        self._parameters.put(_CONFIG, [0.0, *values])

    def reset(self) -> None:
        self._parameters.restore(_CONFIG)


class WallClock:
    """The robot's time of day. It runs with the computer's, from which clients can shift it."""

    def __init__(self) -> None:
        self.shift_ns = 0
        self.zone = "UTC"  # [assumed]

    def set(self, now_ns: int, time_ns: int, zone: str) -> None:
        """Set the robot's time, and its time zone if one is given. Raise ``Invalid`` for an unknown zone."""
        if zone:
            try:
                zoneinfo.ZoneInfo(zone)
            except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
                raise Invalid(f"no time zone {zone[:64]!r}") from None
            self.zone = zone
        self.shift_ns = time_ns - now_ns

    def local(self, time_ns: int) -> str:
        """Return a time of the robot as text, in its zone."""
        try:
            local = datetime.datetime.fromtimestamp(time_ns / NS, zoneinfo.ZoneInfo(self.zone))
        except (ValueError, OverflowError, OSError):
            raise Invalid(f"{time_ns} ns is no time") from None
        return local.strftime("%Y-%m-%d %H:%M:%S %Z")


class Devices:
    """All of them, with the parameters, the log and the stored models."""

    def __init__(self, urdf: str) -> None:
        self.parameters = Parameters()
        self.journal = Journal()
        self.clock = WallClock()
        self.battery = Battery(self.parameters)
        self.gains = dict(GAINS)
        self.flanges = {"right": Flange(), "left": Flange()}
        self.models = {"": urdf}
        self.wake_up()

    def wake_up(self) -> None:
        """Begin with the stored parameters, and with the stored model that they name."""
        self.parameters.reset()
        self.led = Led()
        self.flanges_off()
        self.urdf = self.models.get(self.parameters.text("model_name"), self.models[""])

    def flanges_off(self) -> None:
        for flange in self.flanges.values():
            flange.volts, flange.outputs = 0, [False, False]

    def encoded_flanges(self) -> tuple[bytes, ...]:
        """Encode the right and the left tool flange."""
        return tuple(flange.encode() for flange in self.flanges.values())

    def set_gains(self, joint: str, gains: tuple[int | None, int | None, int | None]) -> tuple[float, float]:
        """Set gains of a joint, and keep those that are None. Return its stiffness and its damping, as shares of
        those by default."""
        old, default = self.gains[joint], GAINS[joint]
        new = Gains(*(before if gain is None else gain for gain, before in zip(gains, old, strict=True)))
        self.gains[joint] = new
        return new.p / default.p, new.d / default.d
