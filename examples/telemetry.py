"""Print the state of this user's robots with plain zenoh, without importing strands-actors.

python examples/telemetry.py [SECONDS]

Each running robot writes a file with its zenoh endpoints into the run directory. Its topics carry JSON.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path

import zenoh


def endpoints() -> list[str]:
    """Return the zenoh endpoints of all robots that have a file in the run directory."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    default = (
        Path(base) / "strands-actors" if base else Path(tempfile.gettempdir()) / f"strands-actors-{os.getuid()}"
    )
    directory = Path(os.environ.get("STRANDS_ACTORS_RUN", default))
    return [endpoint for note in directory.glob("*.json") for endpoint in json.loads(note.read_text())["mesh"]]


def show(sample: zenoh.Sample) -> None:
    """Print one sample of a topic ``strands/<robot>/state``. The sample's sequence number is in its
    attachment."""
    state = json.loads(sample.payload.to_string())
    stamp = json.loads(sample.attachment.to_bytes()) if sample.attachment else {}
    # Each position is listed twice: as ``shoulder_pan`` and as ``shoulder_pan.pos``. Print it once.
    joints = " ".join(
        f"{joint}={value:.1f}" for joint, value in state["joints"].items() if not joint.endswith(".pos")
    )
    print(f"{sample.key_expr} #{stamp.get('seq')} {state['state']}: {joints}", flush=True)


def main(seconds: float) -> None:
    # Connect to the endpoints directly. Robots do not answer multicast scouting.
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps(endpoints()))
    with zenoh.open(config) as session:
        subscriber = session.declare_subscriber("strands/*/state", show)
        time.sleep(seconds)
        subscriber.undeclare()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0)
