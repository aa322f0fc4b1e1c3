"""The texts of the systemd unit and the udev rules for a host. Pure: nothing is written here.

The unit. ``KillMode=process`` is not an oversight: with any other value systemd would kill the processes that make
the robots safe, together with a host that has failed. They end by themselves when each robot is safe.
``WatchdogSignal=SIGKILL``: any other signal waits until a suspended process goes on.

The rules. A serial adapter gets a name by its serial number, the group ``dialout``, and is kept away from
ModemManager, which would send commands of a modem to the servos. FTDI adapters collect bytes for 16 ms by default,
which is longer than a whole exchange with a servo.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

UNIT = Path("/etc/systemd/system/strands-actors.service")
RULES = Path("/etc/udev/rules.d/61-strands-actors.rules")
"""Its number is behind 60-serial.rules, which reads the serial number."""
RUN_DIRECTORY, STATE_DIRECTORY = Path("/run/strands-actors"), Path("/var/lib/strands-actors")
WATCHDOG_S, STOP_S = 10, 90
"""The host is killed if it is silent for the first time, or has not ended after the second one. A robot may need a
minute until it is safe, and a recorder some seconds until its file is finished."""


class File(NamedTuple):
    """A file to write."""

    path: Path
    text: str


def unit(program: Iterable[str], fleet: Path, user: str) -> File:
    """Return the systemd unit.

    Args:
        program: The command ``strands-actors``, as a list of words.
        fleet: The file of the host.
        user: The ordinary user that the host runs as. Scripts attach as the same user.
    """
    command = shlex.join([*program, "up", str(fleet)])
    return File(
        UNIT,
        f"""\
[Unit]
Description=Robots of this computer (strands-actors)
After=network.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={command}
ExecReload=kill -HUP $MAINPID
Restart=always
RestartSec=1
WatchdogSec={WATCHDOG_S}
WatchdogSignal=SIGKILL
TimeoutStartSec=180
TimeoutStopSec={STOP_S}
# Any other mode would kill the processes that make the robots safe when the host has failed.
KillMode=process
User={user}
SupplementaryGroups=dialout
Environment=STRANDS_ACTORS_RUN={RUN_DIRECTORY} STRANDS_ACTORS_DATA={STATE_DIRECTORY}
RuntimeDirectory={RUN_DIRECTORY.name}
RuntimeDirectoryMode=0700
RuntimeDirectoryPreserve=yes
StateDirectory={STATE_DIRECTORY.name}
StateDirectoryMode=0700
LimitRTPRIO=20
LimitMEMLOCK=infinity
LimitNOFILE=65536
AmbientCapabilities=CAP_SYS_NICE
OOMScoreAdjust=-900
OOMPolicy=continue

[Install]
WantedBy=multi-user.target
""",
    )


def rules(adapters: Iterable[tuple[int, int]]) -> File:
    """Return the udev rules for serial adapters, which are given by vendor and product."""
    lines = [
        "# Serial adapters of robots: a name by serial number, the group dialout, no ModemManager.",
        "# FTDI adapters pass bytes on after 1 ms instead of 16 ms.",
    ]
    for vendor, product in sorted(set(adapters)):
        of_tty = f'ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}"'
        of_usb = f'ATTR{{idVendor}}=="{vendor:04x}", ATTR{{idProduct}}=="{product:04x}"'
        lines += [
            f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", {of_usb}, ENV{{ID_MM_DEVICE_IGNORE}}="1"',
            f'SUBSYSTEM=="tty", {of_tty}, GROUP="dialout", MODE="0660", ENV{{ID_MM_DEVICE_IGNORE}}="1"',
            f'SUBSYSTEM=="tty", {of_tty}, ENV{{ID_SERIAL_SHORT}}=="?*", SYMLINK+="strands/$env{{ID_SERIAL_SHORT}}"',
        ]
    lines.append('ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"')
    return File(RULES, "\n".join(lines) + "\n")


def next_steps(files: Iterable[File]) -> list[str]:
    """Return the commands that put written files into effect, as root."""
    steps = []
    for file in files:
        if file.path == UNIT:
            steps += ["systemctl daemon-reload", f"systemctl enable --now {UNIT.stem}"]
        if file.path == RULES:
            steps += ["udevadm control --reload", "udevadm trigger --subsystem-match=tty --action=add"]
    return steps
