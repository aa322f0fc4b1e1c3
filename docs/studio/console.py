"""Make the pictures of the console: each of its views in Chromium, in the order in which a new user sees them.

A host (``strands-actors up``) keeps two simulated arms. One is armed, waves, and is recorded, from the page alone.
No display is needed. Chromium is looked for as by ``python -m tests console``.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from strands_actors.testing import Twin
from tests.answers import until
from tests.cli.command import Command
from tests.web.chromium.cdp import VARIABLE, Tab, chromium, find_chromium
from tests.web.serving import console_of

FLEET = """
[host]
metrics = false
web = 0
[robot.so101]
type = "so101"
transport = "twin"
[robot.koch]
type = "koch"
transport = "twin"
"""
BESIDE = tuple(
    f"console-{view}.png" for view in ("agent", "devices", "estop", "fleet", "phone", "recordings", "setup")
)
"""The pictures of all views but that of a robot."""
LAPTOP, PHONE = (1440, 900), (390, 844)
COLOURS = 128
SETTLE_S = 1.5
WAVES_S, POLICY_S = 1.5, 10
BESIDE_THE_ROBOTS = ("--agent", "tests.web.scripted_agent:helpful", "--lan", "--name", "127.0.0.1")
"""Options of a console that has an agent and lets other devices in."""
WORDS = "What runs here? Let the SO-101 wave."
LOOKS_AT = 0.6
"""The moment of the episode that its picture shows, as a share of its length."""


class Screen:
    """A page of the console in Chromium. Its pictures are written to a folder.

    Args:
        tab: The page.
        folder: The folder.
    """

    def __init__(self, tab: Tab, folder: Path) -> None:
        self.tab = tab
        self._folder = folder

    def set_size(self, size: tuple[int, int], theme: str) -> None:
        """Set the size in pixels, and the theme of the system: dark or light."""
        width, height = size
        self.tab.command(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=size == PHONE,
        )
        self.tab.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])

    def go(self, place: str, shows: str) -> None:
        """Go to a view, and wait until an expression is true there."""
        self.tab.run(f"location.hash = {json.dumps(place)}")
        self.until(shows)

    def until(self, shows: str) -> None:
        """Wait until an expression is true in the page. An element counts as true."""
        self.tab.until(f"!!({shows})")

    def fill(self, selector: str, text: str) -> None:
        self.tab.run(f"document.querySelector({json.dumps(selector)}).value = {json.dumps(text)}")

    def draw(self, file: str) -> None:
        """Write a picture of the screen."""
        time.sleep(SETTLE_S)
        data = base64.b64decode(self.tab.command("Page.captureScreenshot")["data"])
        with Image.open(io.BytesIO(data)) as picture:
            few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            few.save(self._folder / file, optimize=True)


def make(path: Path) -> None:
    """Write the picture of a robot's view to ``path``, and ``BESIDE`` to the same folder.

    Raises:
        RuntimeError: There is no Chromium.
    """
    program = find_chromium()
    if not program:
        raise RuntimeError(f"these pictures need Chromium. Install it, or let {VARIABLE} name its program")
    with tempfile.TemporaryDirectory() as folder, chromium(program) as browser:
        command = Command(Path(folder) / "run")
        command.environment["STRANDS_ACTORS_ALLOW"] = "start"
        with _host(command, Path(folder)) as url:
            screen = Screen(browser.open(url), path.parent)
            screen.set_size(LAPTOP, "dark")
            _first_steps(screen, path.name)
            _set_up(screen, Path(folder))
            screen.tab.close()
            with console_of(command, *BESIDE_THE_ROBOTS) as facts:
                screen = Screen(browser.open(facts["url"]), path.parent)
                screen.set_size(LAPTOP, "dark")
                screen.until("document.querySelectorAll('.card').length === 2")
                _agent(screen)
                _devices(screen)
                estop = Screen(browser.open_in(screen.tab.context, facts["estop"]), path.parent)
                _estop(estop)


@contextlib.contextmanager
def _host(command: Command, folder: Path) -> Iterator[str]:
    """Run a host with the two arms. Yield the address of its console."""
    file = folder / "fleet.toml"
    file.write_text(FLEET)
    with command.start("up", str(file), "--json") as process:
        try:
            assert process.stdout is not None
            assert json.loads(process.stdout.readline())

            def address() -> str:
                return str(command.json("status")["services"]["web"]["address"])

            until(lambda: bool(address()), "the console is served")
            yield address()
        finally:
            process.terminate()
            process.wait()
            command.wait_until_gone()


def _first_steps(screen: Screen, robot_file: str) -> None:
    """Look at the fleet, arm a robot, let it wave, record it, and play the recording."""
    tab = screen.tab
    screen.until("document.querySelectorAll('.card').length === 2")
    screen.draw("console-fleet.png")
    screen.go("#/robots/so101", "document.querySelectorAll('.jog').length === 12")
    tab.click(".orders .go")
    tab.click("dialog button[value=yes]")
    screen.until("document.querySelector('.side .pill').textContent === 'armed'")
    screen.fill(".recorder [name=dataset]", "first-try")
    screen.fill(".recorder [name=task]", "wave")
    tab.click(".recorder form .go")
    screen.until("!document.querySelector('.recorder .orders').hidden")
    tab.run("document.querySelector('.recorder .orders .go').click()")
    screen.until("document.querySelector('.recorder').classList.contains('recording')")
    screen.fill("[name=seconds]", f"{POLICY_S}")
    tab.run("document.querySelector('[name=provider]').form.requestSubmit()")
    time.sleep(WAVES_S)
    tab.run("scrollTo(0, 0)")
    screen.draw(robot_file)
    screen.set_size(PHONE, "light")
    screen.draw("console-phone.png")
    screen.set_size(LAPTOP, "dark")
    screen.until("document.querySelector('.facts').textContent.includes('tasknone')")
    tab.run("document.querySelector('[title^=\"ends the episode\"]').click()")
    screen.until("document.querySelectorAll('.recorder .episodes li').length === 1")
    screen.go("#/recordings/first-try", "document.querySelector('.timeline .value')?.textContent.includes('of')")
    screen.until("document.querySelector('.no-model').hidden")
    tab.run(
        f"(slider => {{ slider.value = slider.max * {LOOKS_AT}; slider.dispatchEvent(new Event('input')) }})"
        "(document.querySelector('.timeline input'))"
    )
    screen.draw("console-recordings.png")


def _set_up(screen: Screen, folder: Path) -> None:
    """Begin to calibrate an arm, and move its first joint by hand."""
    tab = screen.tab
    with Twin("so101", folder, by_hand=True) as twin:
        screen.go("#/setup", "document.querySelector('[name=robot] option')")
        screen.fill("[name=port]", twin.port)
        tab.run("document.querySelector('[name=port]').form.requestSubmit()")
        screen.until("document.querySelector('.sweeps li')")
        for rad in (-0.9, 0.7):
            twin.move_by_hand(shoulder_pan=rad)
            time.sleep(SETTLE_S)
        screen.draw("console-setup.png")
        tab.click(".run .quiet")


def _agent(screen: Screen) -> None:
    """Talk to an agent, which asks an operator before it moves a robot."""
    screen.go("#/agent", "document.querySelector('textarea')")
    screen.fill("textarea", WORDS)
    screen.tab.click(".say .go")
    screen.until("document.querySelector('.consent')")
    screen.draw("console-agent.png")
    screen.tab.click(".consent .row button:not(.go)")


def _devices(screen: Screen) -> None:
    screen.go("#/devices", "document.querySelector('.devices li')")
    screen.tab.click("main .row .go")
    screen.until("document.querySelector('.offer img')?.complete")
    screen.draw("console-devices.png")


def _estop(screen: Screen) -> None:
    screen.set_size(PHONE, "dark")
    screen.tab.click("button")
    screen.until("document.body.textContent.includes('koch')")
    screen.draw("console-estop.png")
