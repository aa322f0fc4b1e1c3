"""The systemd unit and the udev rules are printed, and written only on request."""

from __future__ import annotations

import getpass
import pwd
import re
import subprocess
from pathlib import Path

import pytest

from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.host.install import RULES, UNIT, rules, unit

FLEET = '[robot.left]\ntype = "so101"\ntransport = "twin"\n'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    return path


def an_ordinary_user() -> str:
    return next(each.pw_name for each in pwd.getpwall() if each.pw_uid)


def test_nothing_is_written_without_yes(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["install", "--systemd", "--udev", "--file", str(file), "--user", an_ordinary_user()]
    below = tmp_path / "image"
    assert run([*words, "--below", str(below)]) == 0
    printed = capsys.readouterr()
    assert f"# {UNIT}" in printed.out
    assert "nothing was written" in printed.err
    assert not below.exists()
    assert run([*words, "--below", str(below), "--yes"]) == 0
    for path in (UNIT, RULES):
        assert (below / path.relative_to("/")).read_text() in printed.out


def test_the_unit_leaves_the_processes_alone_that_make_robots_safe() -> None:
    text = unit(["/opt/a b/strands-actors"], Path("/etc/fleet.toml"), "robots").text
    settings = dict(re.findall(r"^(\w+)=(.*)$", text, re.MULTILINE))
    assert settings["ExecStart"] == "'/opt/a b/strands-actors' up /etc/fleet.toml"
    assert settings["KillMode"] == "process"
    assert settings["WatchdogSignal"] == "SIGKILL", "another signal waits while a process is suspended"
    assert (settings["Type"], settings["User"]) == ("notify", "robots")


@pytest.mark.needs("systemd")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    path = tmp_path / UNIT.name
    path.write_text(unit(["/bin/true"], Path("/etc/fleet.toml"), getpass.getuser()).text)
    done = subprocess.run(["systemd-analyze", "verify", str(path)], capture_output=True, text=True, check=False)
    assert str(path) not in done.stderr and UNIT.name not in done.stderr, done.stderr


def test_each_adapter_gets_a_name_by_serial_number_and_no_modem_manager() -> None:
    lines = rules((*Feetech.USB_IDS, *Dynamixel.USB_IDS)).text.splitlines()
    of_one = [line for line in lines if '"1a86"' in line and '"7523"' in line]
    assert any('SYMLINK+="strands/$env{ID_SERIAL_SHORT}"' in line for line in of_one)
    assert any('GROUP="dialout"' in line for line in of_one)
    assert any('SUBSYSTEM=="usb"' in line and 'ENV{ID_MM_DEVICE_IGNORE}="1"' in line for line in of_one)
    assert any('DRIVER=="ftdi_sio"' in line and 'ATTR{latency_timer}="1"' in line for line in lines)
    assert len(lines) == len(set(lines))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "give --systemd, --udev or both"),
        (["--systemd"], "needs the host's file"),
        (["--systemd", "--file", "missing.toml"], "missing.toml: it cannot be read"),
        (["--udev", "--below", "/proc/1", "--yes"], "cannot be written"),
    ],
)
def test_what_is_missing_is_named(words: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["install", *words]) == 2
    assert text in capsys.readouterr().err


def test_root_and_unknown_users_are_refused(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for user, text in (("root", "Give an ordinary user"), ("nobody-here", "there is no user nobody-here")):
        assert run(["install", "--systemd", "--file", str(file), "--user", user]) == 2
        assert text in capsys.readouterr().err
