"""The robots that LeRobot has a class for, by our names: ``types.toml``."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import msgspec


class Type(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of ``types.toml``, which says what each field is."""

    type: str
    module: str
    needs: str
    extra: str
    port: str = "port"
    buses: tuple[str, ...] = ()
    stop: tuple[str, ...] = ()
    goals: str = ""
    wire: str = ""
    serial: bool = True

    @property
    def stops(self) -> tuple[str, ...]:
        """Return the calls that stop it."""
        return self.stop or tuple(f"{bus}.disable_torque" for bus in self.buses)

    @property
    def holds(self) -> bool:
        """Return whether it can be told to stay where it is."""
        return bool(self.buses)


def missing(kind: Type) -> str:
    """Return the line that installs what this robot needs and this machine lacks; empty: it is all
    here."""
    if importlib.util.find_spec("lerobot") is not None and importlib.util.find_spec(kind.needs) is not None:
        return ""
    return f"pip install 'lerobot[{kind.extra}]'" if kind.extra else "pip install lerobot"


TYPES = msgspec.toml.decode((Path(__file__).parent / "types.toml").read_bytes(), type=dict[str, Type])
