"""Run the scripts of the operator's page in Node.js, without a browser."""

from __future__ import annotations

import shutil
import subprocess
from importlib import resources

LOAD = """
const read = () => require("fs").readFileSync(process.argv[1], "utf-8")
const load = () => import("data:text/javascript," + encodeURIComponent(read()))
"""
"""``read()`` returns a file of the page, and ``load()`` imports it."""


def run_on_page(file: str, script: str) -> str:
    """Run a script for a file of the page, and return its output."""
    node = shutil.which("node")
    assert node is not None, 'mark the test with needs("Node.js")'
    path = resources.files("strands_actors.surfaces.web").joinpath("page", file)
    command = [node, "-e", LOAD + script, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=True)
    return done.stdout
