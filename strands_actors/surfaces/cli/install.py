"""``install``: print the systemd unit and the udev rules for a host, and write them only on request."""

from __future__ import annotations

import getpass
import json
import os
import pwd
import sys
from pathlib import Path

from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.kernel.processes.interpreter import PYTHON
from strands_actors.surfaces.host.fleet import BadFleet
from strands_actors.surfaces.host.fleet_file import read_fleet
from strands_actors.surfaces.host.install import RUN_DIRECTORY, File, next_steps, rules, unit

from .errors import Problem


def install(
    systemd: bool, udev: bool, file: Path | None, user: str | None, below: Path, yes: bool, as_json: bool
) -> int:
    """Print the files, and with ``yes`` write them.

    Args:
        systemd: The unit of the host.
        udev: The rules for serial adapters.
        file: The host's file. Needed for the unit.
        user: The user of the host; None for the present one, or the one that called sudo.
        below: The root directory to write to.
        yes: Write the files.
        as_json: Print one JSON object.

    Returns:
        The exit code.

    Raises:
        Problem: An option is missing or wrong.
    """
    files = _files(systemd, udev, file, user)
    if yes:
        for each in files:
            target = below / each.path.relative_to("/")
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(each.text)
            except OSError as error:
                raise Problem(
                    f"install: {target} cannot be written ({error.strerror}). Run it with sudo"
                ) from error
    steps = next_steps(files)
    if as_json:
        texts = {str(each.path): each.text for each in files}
        print(json.dumps({"files": texts, "written": yes, "next": steps}))
        return 0
    for each in files:
        print(f"# {each.path}{' (written)' if yes else ''}\n{each.text}")
    if not yes:
        print("# nothing was written. Add --yes to write it, with sudo", file=sys.stderr)
    about = f"scripts of this user find the robots with STRANDS_ACTORS_RUN={RUN_DIRECTORY}" if systemd else ""
    print("\n".join(f"# then: sudo {step}" for step in steps) + (f"\n# {about}" if about else ""))
    return 0


def _files(systemd: bool, udev: bool, file: Path | None, user: str | None) -> list[File]:
    if not (systemd or udev):
        raise Problem("install: give --systemd, --udev or both")
    files = []
    if systemd:
        if file is None:
            raise Problem("install: the unit needs the host's file: --systemd --file fleet.toml")
        try:
            path = read_fleet(file.absolute()).path
        except BadFleet as bad:
            raise Problem(f"install: {bad}") from bad
        program = [*PYTHON, "-c", "from strands_actors.surfaces.cli import main; main()"]
        script = Path(sys.argv[0]).absolute()
        if script.name == "strands-actors" and os.access(script, os.X_OK):
            program = [str(script)]
        files.append(unit(program, path, _user(user)))
    if udev:
        adapters = {pair for place in WIRES.values() for pair in load(place).USB_IDS}
        files.append(rules(adapters))
    return files


def _user(user: str | None) -> str:
    """Return the name of an ordinary user."""
    name = user or os.environ.get("SUDO_USER") or getpass.getuser()
    try:
        number = pwd.getpwnam(name).pw_uid
    except KeyError:
        raise Problem(f"install: there is no user {name}. Give one of this computer with --user") from None
    if number == 0:
        raise Problem("install: the host needs no root. Give an ordinary user with --user")
    return name
