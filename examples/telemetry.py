"""Watch this user's robots with plain zenoh, no import of strands-actors: python
examples/telemetry.py [SECONDS]

A robot leaves a note of where it can be reached in the directory where robots meet; its topics are
JSON.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path

import zenoh


def endpoints() -> list[str]:
    """Of the robots that have left a note."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    default = (
        Path(base) / "strands-actors" if base else Path(tempfile.gettempdir()) / f"strands-actors-{os.getuid()}"
    )
    directory = Path(os.environ.get("STRANDS_ACTORS_RUN", default))
    return [endpoint for note in directory.glob("*.json") for endpoint in json.loads(note.read_text())["mesh"]]


def show(sample: zenoh.Sample) -> None:
    told = json.loads(sample.payload.to_string())
    stamp = json.loads(sample.attachment.to_bytes()) if sample.attachment else {}
    joints = " ".join(
        f"{joint}={value:.1f}" for joint, value in told["joints"].items() if not joint.endswith(".pos")
    )
    print(f"{sample.key_expr} #{stamp.get('seq')} {told['state']}: {joints}", flush=True)


def main(seconds: float) -> None:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps(endpoints()))
    with zenoh.open(config) as session:
        subscriber = session.declare_subscriber("strands/*/state", show)
        time.sleep(seconds)
        subscriber.undeclare()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0)
