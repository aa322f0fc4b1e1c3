"""Run Chromium without a window, and control it by its DevTools protocol (CDP)."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

VARIABLE = "CHROMIUM"
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "chrome-headless-shell")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--remote-debugging-port=0",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--site-per-process",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1440,900",
)
LISTENING = "DevTools listening on "
PATIENCE_S = 60.0
LOOK_S = 0.05
MESSAGE_BYTES = 64 * 1024 * 1024


def find_chromium() -> str:
    """Return the path of a Chromium or Chrome; empty if there is none."""
    named = os.environ.get(VARIABLE, "")
    return named or next(filter(None, map(shutil.which, NAMES)), "")


class CommandFailed(Exception):
    """Chromium has refused a command, or a script has failed."""


class Browser:
    """A connection to Chromium.

    Args:
        connection: The WebSocket of its DevTools.
    """

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._numbers = itertools.count(1)
        self._answers: dict[int, dict[str, Any]] = {}
        self._lock = threading.Condition()
        self.events: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def command(self, method: str, session: str = "", wait: bool = True, **parameters: Any) -> dict[str, Any]:
        """Send a command, and return its result.

        Args:
            method: Its name.
            session: The page that it is for; empty for the browser.
            wait: False returns at once, for a page that is busy.
            parameters: Its parameters.

        Raises:
            CommandFailed: Chromium refuses it.
        """
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        self._connection.send(json.dumps({**message, "sessionId": session} if session else message))
        if not wait:
            return {}
        with self._lock:
            assert self._lock.wait_for(lambda: number in self._answers, PATIENCE_S), f"no answer to {method}"
            answer = self._answers.pop(number)
        if "error" in answer:
            raise CommandFailed(f"{method}: {answer['error']['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, url: str) -> Tab:
        """Open a page in a profile that shares nothing with others, as a second device."""
        context = self.command("Target.createBrowserContext")["browserContextId"]
        return self.open_in(context, url)

    def open_in(self, context: str, url: str) -> Tab:
        """Open a page in a profile, beside its other pages."""
        target = self.command("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        session = self.command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = Tab(self, context, target, session)
        for domain in ("Page", "Runtime", "Network"):
            tab.command(f"{domain}.enable")
        tab.command("Security.setIgnoreCertificateErrors", ignore=True)
        tab.go(url)
        return tab

    def _receive(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for text in self._connection:
                message = json.loads(text)
                with self._lock:
                    if "id" in message:
                        self._answers[message["id"]] = message
                    else:
                        self.events.append(message)
                    self._lock.notify_all()


class Tab:
    """A page.

    Args:
        browser: The browser.
        context: Its profile.
        target: Its number in the browser.
        session: The session of its commands.
    """

    def __init__(self, browser: Browser, context: str, target: str, session: str) -> None:
        self._browser = browser
        self.context = context
        self._target = target
        self.session = session

    def command(self, method: str, wait: bool = True, **parameters: Any) -> dict[str, Any]:
        return self._browser.command(method, self.session, wait, **parameters)

    def go(self, url: str) -> None:
        self.command("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """Return the value of an expression in the page. A promise is awaited.

        Raises:
            CommandFailed: The expression has raised an error.
        """
        answer = self.command("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise CommandFailed(str(answer["exceptionDetails"].get("exception", {}).get("description")))
        return answer["result"].get("value")

    def start(self, script: str) -> None:
        """Run an expression, and do not wait for it."""
        self.command("Runtime.evaluate", wait=False, expression=script)

    def until(self, script: str, is_right: Callable[[Any], bool] = bool, within_s: float = PATIENCE_S) -> Any:
        """Return the value of an expression as soon as it is right.

        Raises:
            TimeoutError: It is not right within the time.
        """
        until_s = time.monotonic() + within_s
        value = None
        while time.monotonic() < until_s:
            with contextlib.suppress(CommandFailed):  # The page may be loading, and have no body yet.
                value = self.run(script)
                if is_right(value):
                    return value
            time.sleep(LOOK_S)
        raise TimeoutError(f"{script} is {value!r}")

    def middle_of(self, selector: str) -> tuple[float, float]:
        """Return where an element is, and bring it into view first."""
        box = self.until(
            f"(one => {{ if (!one) return null; one.scrollIntoView({{block: 'center'}});"
            " const box = one.getBoundingClientRect();"
            f" return [box.x + box.width / 2, box.y + box.height / 2] }})(document.querySelector({selector!r}))"
        )
        return box[0], box[1]

    def mouse(self, kind: str, at: tuple[float, float], wait: bool = True) -> None:
        self.command(
            "Input.dispatchMouseEvent", wait, type=kind, x=at[0], y=at[1], button="left", buttons=1, clickCount=1
        )

    def press(self, selector: str) -> tuple[float, float]:
        """Press the mouse on an element, and keep it pressed. Return where."""
        at = self.middle_of(selector)
        self.mouse("mousePressed", at)
        return at

    def click(self, selector: str) -> None:
        self.mouse("mouseReleased", self.press(selector))

    def type(self, text: str) -> None:
        self.command("Input.insertText", text=text)

    def picture(self, selector: str) -> str:
        """Return what the screen shows of an element, as an address with its data."""
        x, y, width, height = self.run(
            f"(box => [box.x, box.y, box.width, box.height])"
            f"(document.querySelector({selector!r}).getBoundingClientRect())"
        )
        clip = {"x": x, "y": y, "width": width, "height": height, "scale": 0.25}
        return "data:image/png;base64," + str(self.command("Page.captureScreenshot", clip=clip)["data"])

    def requests(self) -> list[str]:
        """Return the addresses of all requests of the page so far."""
        return [
            event["params"].get("request", {}).get("url") or event["params"]["url"]
            for event in list(self._browser.events)
            if event.get("sessionId") == self.session
            and event["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated")
        ]

    def close(self) -> None:
        self._browser.command("Target.closeTarget", targetId=self._target)


@contextlib.contextmanager
def chromium(path: str) -> Iterator[Browser]:
    """Run Chromium while the block runs.

    Args:
        path: Its program.
    """
    with tempfile.TemporaryDirectory(prefix="sa-chromium-", ignore_cleanup_errors=True) as profile:
        words = [path, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        # With this locale Chromium gives pages a language tag that its own NumberFormat refuses (``locale.js``).
        environment = {**os.environ, "LANG": "C", "LC_ALL": "C"}
        with subprocess.Popen(
            words, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        ) as process:
            try:
                assert process.stderr is not None
                lines = []
                for line in process.stderr:
                    lines.append(line)
                    if line.startswith(LISTENING):
                        break
                else:
                    raise AssertionError(f"{path} has not started: {''.join(lines)}")
                # Chromium blocks if nothing reads what it prints.
                threading.Thread(target=process.stderr.read, daemon=True).start()
                url = line.removeprefix(LISTENING).strip()
                with connect(url, max_size=MESSAGE_BYTES) as connection:
                    yield Browser(connection)
            finally:
                process.kill()
                process.wait()
