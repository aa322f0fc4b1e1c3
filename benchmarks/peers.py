"""``python -m benchmarks.peers [NAME ...]``: make the Python environments of peers (products that are
compared with this package) that cannot be installed in ours.

Each is a virtual environment in ``benchmarks/.peers/<name>/``, with the Python that the peer needs. If a
benchmark needs an environment that is missing, it fails with a message. A benchmark never makes one itself.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.drivers.stretch import vendor

PLACE = Path(__file__).resolve().parent / ".peers"


@dataclass(frozen=True)
class Peer:
    """The environment of one peer.

    Attributes:
        python: The version of Python.
        packages: Packages that are installed with their requirements.
        alone: Packages that are installed without the packages that they require, since no benchmark uses those.
        proof: Modules that must be importable after the installation.
        empty: Modules that the peer imports, but that no benchmark uses. Empty files replace them.
    """

    python: str
    packages: tuple[str, ...]
    alone: tuple[str, ...] = ()
    proof: str = ""
    empty: tuple[str, ...] = ()


PEERS = {
    "strands": Peer(
        "3.12",
        (
            "strands-agents",
            "numpy",
            "pillow",
            "opencv-python-headless",
            "mujoco",
            "eclipse-zenoh",
            "json5",
            "cryptography",
            "psutil",
            "pyserial",
            "feetech-servo-sdk==1.0.0",
            "ur-rtde>=1.6.5,<2",
        ),
        ("strands-robots==0.5.3",),
        "strands_robots, rtde_control",
    ),
    # torch is left out. It has 800 MB, and lerobot's servo buses do not use it.
    "lerobot": Peer(
        "3.11",
        ("numpy", "pyserial", "deepdiff", "tqdm", "feetech-servo-sdk==1.0.0"),
        ("lerobot==0.4.4",),
        "scservo_sdk, deepdiff",
    ),
    # Inverse kinematics. mink needs a solver of quadratic programs, and daqp is the one that it recommends.
    "poses": Peer("3.11", ("pin==4.1.0", "ikpy==4.2.1", "mink==1.3.0", "daqp"), (), "pinocchio, ikpy, mink, daqp"),
    # Unitree's SDK requires this release. 3.10 is the newest Python for which there are wheels of it.
    "cyclonedds": Peer("3.10", ("cyclonedds==0.10.2",), (), "cyclonedds.idl"),
    # cflib is under the GPL, so it is only installed in this environment.
    "cflib": Peer("3.11", ("cflib==0.1.34",), (), "cflib.crazyflie"),
    "microduck": Peer("3.12", ("microduck-cli==0.9.7",), (), "microduck_cli.ipc.client"),
    # The daemon of Reachy Mini, which ``python -m tests peers`` uses. PyGObject is left out, because pip would
    # compile it against the system's GStreamer.
    "reachy": Peer(
        "3.12",
        (
            "aiohttp",
            "asgiref",
            "fastapi",
            "huggingface-hub>=1.20.1,<2",
            "jinja2",
            "libusb_package",
            "log-throttling==0.0.3",
            "mujoco==3.3.0",
            "numpy>=2.2.5",
            "onnxruntime==1.27.0",
            "platformdirs",
            "psutil",
            "pulsectl>=24.1.0",
            "pydantic>=2.12.5,<3",
            "pyserial",
            "python-multipart",
            "pyusb",
            "pyyaml",
            "questionary",
            "reachy-mini-rust-kinematics>=1.0.3",
            "reachy_mini_motor_controller>=1.5.5",
            "requests",
            "rich",
            "rustypot>=1.4.2",
            "starlette>=1.3.1,<2",
            "toml",
            "uvicorn[standard]",
            "websockets>=12,<16",
            "zeroconf<1",
        ),
        ("reachy-mini==1.13.0",),
        "mujoco, uvicorn, reachy_mini_motor_controller",
    ),
    # stretch_body also requires packages for audio, point clouds and a camera. They are left out.
    "stretch_body": Peer("3.11", vendor.NEEDS, (vendor.CLIENT,), "stretch_body, aioserial", vendor.NOT_THERE),
}


class Missing(RuntimeError):
    """A peer, or the Python version that it needs, is not installed. The text of the exception has the remedy."""


def python(name: str) -> str:
    """Return the path of a peer's interpreter. Raise ``Missing`` if its environment was not made."""
    place = PLACE / name / "bin" / "python"
    if not (PLACE / name / "ready").exists():
        raise Missing(f"{name} is not installed here: run python -m benchmarks.peers {name}")
    return str(place)


def make(name: str) -> None:
    """Make the environment of a peer, and replace an existing one. Raise ``Missing`` if its Python is not
    found."""
    peer = PEERS[name]
    place = PLACE / name
    shutil.rmtree(place, ignore_errors=True)
    subprocess.run([find(peer.python), "-m", "venv", str(place)], check=True)
    interpreter = str(place / "bin" / "python")
    install = [interpreter, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, *peer.packages], check=True)
    if peer.alone:
        subprocess.run([*install, "--no-deps", *peer.alone], check=True)
    for name in peer.empty:
        (site,) = place.glob("lib/python*/site-packages")
        (site / f"{name}.py").touch()
    subprocess.run([interpreter, "-c", f"import {peer.proof}"], check=True)
    (place / "ready").touch()


def find(version: str) -> str:
    """Return an interpreter of this version, from PATH or from pyenv. Raise ``Missing`` if there is no such
    interpreter."""
    for candidate in _candidates(version):
        command = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0 and done.stdout.strip() == version:
            return candidate
    raise Missing(f"no Python {version} on PATH or in ~/.pyenv/versions: install one (pyenv install {version})")


def _candidates(version: str) -> Iterator[str]:
    yield sys.executable
    if interpreter := shutil.which(f"python{version}"):
        yield interpreter
    yield from (str(path) for path in sorted(Path.home().glob(f".pyenv/versions/{version}*/bin/python")))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("name", nargs="*", help=f"of: {', '.join(PEERS)} (default: all)")
    names = parser.parse_args().name or list(PEERS)
    if unknown := [name for name in names if name not in PEERS]:
        parser.error(f"no peer is called {', '.join(unknown)}; there are: {', '.join(PEERS)}")
    for name in names:
        print(f"making {PLACE / name}", file=sys.stderr, flush=True)
        try:
            make(name)
        except (Missing, subprocess.CalledProcessError) as failure:
            print(f"{name}: {failure}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
