"""``teleop`` without a connected leader."""

from __future__ import annotations

from .command import Command


def test_a_missing_leader_fails_with_its_full_reason(cli: Command) -> None:
    done = cli.run("teleop", "so101", "--twin", "--from", "so101_leader:/dev/null/arm", "--seconds", "1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout == "0 setpoints, 0 frames refused; ended: duration (1 s are over)\n"
    lines = done.stderr.splitlines()
    assert lines[-1].startswith("the leader is not connected: /dev/null/arm: cannot open")
    assert lines[-1].endswith("Check port=, and which program uses it")
    assert len([line for line in lines if line.startswith("idle ")]) <= 3, "one line for each change"
