"""Run programs against a twin: with a client that is only a module of this machine, and long, with real ones."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from . import main as command
from . import page
from .fetch import Fetched, NotFetched
from .run import run
from .table import Client, Program, clients
from .verdict import Verdict

FAKE = '''"""A client of a vendor, made for this test."""
import serial, time

class Bus:
    def __init__(self, port):
        self._serial = serial.Serial(port, 1_000_000, timeout=2.0)

    def write(self, servo, address, value, size):
        body = [servo, 3 + size, 3, address, *value.to_bytes(size, "little")]
        return self._ask(body, 6)

    def position(self, servo):
        return int.from_bytes(self._ask([servo, 4, 2, 56, 2], 8)[5:7], "little")

    def _ask(self, body, size):
        self._serial.write(bytes([255, 255, *body, ~sum(body) & 255]))
        answer = self._serial.read(size)
        assert len(answer) == size, "no answer"
        return answer
'''
PROGRAMS = {
    "moves.py": """
        bus.write(1, 40, 1, 1)
        start = bus.position(1)
        bus.write(1, 42, start + 200, 2)
        time.sleep(1.0)
        print(bus.position(1) - start)
    """,
    # The robot answers each of these packets without an error, and does nothing.
    "says_done.py": """
        bus.write(1, 40, 1, 1)
        bus.write(1, 42, bus.position(1), 2)
        print("done")
    """,
    "reads.py": "print(bus.position(1))",
    "fails.py": "bus.position(77)",
    "for_ever.py": """
        while True:
            bus.position(1)
    """,
}


@pytest.fixture
def fake(tmp_path: Path) -> Fetched:
    """A client and its examples, which name another port than that of the twin."""
    examples = tmp_path / "examples"
    examples.mkdir()
    (examples / "vendor.py").write_text(FAKE)
    for name, text in PROGRAMS.items():
        lines = "\n".join(line[8:] if line.startswith(" ") else line for line in text.splitlines())
        (examples / name).write_text(f"import time\nimport vendor\nbus = vendor.Bus('/dev/ttyUSB0')\n{lines}\n")
    return Fetched(Path(sys.executable), Path(sys.executable).parent, examples)


def client(*programs: Program) -> Client:
    return Client(
        name="fake",
        version="1",
        license="MIT",
        robot="so101",
        examples="wheel",
        arguments=(),
        replaces={"/dev/ttyUSB0": "{address}"},
        program=programs,
    )


PAN = {"shoulder_pan": 200 / 4096 * 6.2832}


@pytest.mark.parametrize(
    ("program", "verdict", "reason"),
    [
        (Program(file="moves.py", moves=("shoulder_pan",)), Verdict.MOVED, ""),
        (Program(file="moves.py", reaches=PAN), Verdict.REACHED, ""),
        (Program(file="moves.py", reaches={"shoulder_pan": -0.3}), Verdict.ELSEWHERE, "sent to -0.3"),
        (Program(file="says_done.py", moves=("shoulder_pan",)), Verdict.NOTHING, "shoulder_pan did not move"),
        (Program(file="reads.py"), Verdict.RAN, ""),
        (Program(file="fails.py"), Verdict.FAILED, "no answer"),
        (Program(file="for_ever.py", seconds=1.0), Verdict.CUT_OFF, "after 1 s"),
        (Program(file="for_ever.py", seconds=1.0, endless=True), Verdict.RAN, ""),
    ],
)
def test_a_program_is_run_watched_and_judged(
    fake: Fetched, program: Program, verdict: Verdict, reason: str
) -> None:
    outcome = run(client(program), program, fake)
    assert outcome.judged.verdict is verdict, outcome
    assert reason in outcome.judged.reason
    if program.file == "moves.py":
        assert outcome.seen.calls["setpoint"] == 1 and outcome.seen.calls["read"] >= 2
    assert "/dev/ttyUSB0" in (fake.examples or Path()).joinpath(program.file).read_text(), (
        "the cache is not changed"
    )


def test_the_command_prints_records_and_fails_if_a_program_was_told_done_for_nothing(
    fake: Fetched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = [client(Program(file="reads.py"), Program(file="says_done.py", moves=("shoulder_pan",)))]
    absent = Client(name="gone", version="2", license="MIT", robot="so101", program=(Program(file="own:x.py"),))

    def fetch(one: Client, given: Path | None = None) -> Fetched:
        if one is absent:
            raise NotFetched("the index does not have it")
        return fake

    record, shown, keep = tmp_path / "record.json", tmp_path / "testing.md", tmp_path / "kept"
    shown.write_text(page.PAGE.read_text())
    monkeypatch.setattr(command, "fetch", fetch)
    monkeypatch.setattr(page, "PAGE", shown)
    code = command.main(["--page", "--keep", str(keep)], [*table, absent], record)
    assert code == 1
    printed = capsys.readouterr().out
    assert "Of these 0 left the body where the program sends it, 0 moved it" in printed
    assert '1 were told "done" for nothing. 1 more were not run' in printed
    verdicts = [each["verdict"] for each in page.read(record)["programs"]]
    assert verdicts == ["ran", "done for nothing", "not run"]
    assert "| fake 1 | `says_done.py` | so101 |" in shown.read_text()
    assert "not run (the index does not have it)" in shown.read_text()
    assert (keep / "fake-reads.py" / "wire.ndjson").exists()

    # A later run of one program changes only its row.
    assert command.main(["--page", "--only", "reads"], [*table, absent], record) == 0
    assert [each["verdict"] for each in page.read(record)["programs"]] == verdicts


def test_a_folder_of_examples_that_a_person_names_is_run_instead(
    fake: Fetched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    assert fake.examples is not None
    for name in ("vendor.py", "reads.py"):
        (folder / name).write_text((fake.examples / name).read_text())
    monkeypatch.setattr(command, "fetch", lambda one, given=None: fake._replace(examples=given))
    assert command.main(["--only", "fake", "--examples", f"fake={folder}"], [client()], tmp_path / "record") == 0
    assert "| fake 1 | `reads.py` | so101 |" in capsys.readouterr().out


def test_wrong_arguments_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--only", "nothing of this name"], ["--examples", "xarm"]):
        with pytest.raises(SystemExit):
            command.main(arguments)
    assert "has 'nothing of this name' in its name" in capsys.readouterr().err
    assert command.main(["--list"]) == 0
    assert "xarm-python-sdk==" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("one", clients(), ids=lambda one: one.name)
def test_the_programs_of_a_client_get_what_the_robot_would_give(one: Client, tmp_path: Path) -> None:
    """Fetch a client from its index, and run its programs."""
    assert command.main(["--keep", str(tmp_path)], [one]) == 0
