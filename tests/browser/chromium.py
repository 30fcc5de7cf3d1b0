"""A headless Chromium, driven over its own debugging protocol: no driver program, no further package."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from websockets.sync.client import connect

CANDIDATES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE_S = 60.0
OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # root has none
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--no-proxy-server",
    "--mute-audio",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)


def program() -> str | None:
    """Path of Chromium; None where there is none."""
    return next((path for name in CANDIDATES if (path := shutil.which(name))), None)


class Page:
    """One tab, or the browser itself. Every call waits for its answer."""

    def __init__(self, address: str, domains=("Page", "Runtime", "Network", "Log")) -> None:
        self._open = contextlib.ExitStack()
        self._line = self._open.enter_context(connect(address, max_size=None, open_timeout=PATIENCE_S))
        self._numbers = itertools.count(1)
        self.requests: list[str] = []
        self.complaints: list[str] = []
        for domain in domains:
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters):
        number = next(self._numbers)
        self._line.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            said = json.loads(self._line.recv(PATIENCE_S))
            if said.get("id") == number:
                if "error" in said:
                    raise RuntimeError(f"{method}: {said['error']}")
                return said["result"]
            self._note(said)

    def _note(self, said) -> None:
        what, more = said.get("method"), said.get("params", {})
        if what == "Network.requestWillBeSent":
            self.requests.append(more["request"]["url"])
        elif what == "Network.webSocketCreated":
            self.requests.append(more["url"])
        elif what == "Runtime.exceptionThrown":
            details = more["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif what == "Log.entryAdded" and more["entry"]["level"] == "error":
            self.complaints.append(more["entry"]["text"])

    def size(self, width: int, height: int) -> None:
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def go(self, url: str) -> None:
        self.ask("Page.navigate", url=url)

    def run(self, script: str):
        """The value of an expression, or of a promise."""
        done = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in done:
            raise RuntimeError(done["exceptionDetails"].get("exception", {}).get("description", "?"))
        return done["result"].get("value")

    def wait(self, script: str, timeout_s: float = PATIENCE_S) -> None:
        """Wait until an expression is true."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            with contextlib.suppress(RuntimeError):
                if self.run(f"Boolean({script})"):
                    return
            time.sleep(0.05)
        raise TimeoutError(f"never true: {script}; the page says {self.text('body')[:600]!r}")

    def text(self, selector: str) -> str:
        return self.run(f"document.querySelector({selector!r})?.innerText ?? ''")

    def key(self, key: str, shift: bool = False) -> None:
        more = (
            {"text": key}
            if len(key) == 1
            else {"code": key, "windowsVirtualKeyCode": {"Enter": 13, "Escape": 27}.get(key, 0)}
        )
        if key == "Enter":
            more["text"] = "\r"
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, modifiers=8 * shift, **more)

    def type(self, text: str) -> None:
        self.ask("Input.insertText", text=text)

    def mouse(self, kind: str, x: float, y: float) -> None:
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def click(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.mouse(kind, x, y)

    def middle(self, selector: str) -> tuple[float, float]:
        middle = "(b => [b.x + b.width / 2, b.y + b.height / 2])"
        return tuple(self.run(f"{middle}(document.querySelector({selector!r}).getBoundingClientRect())"))

    def click_on(self, selector: str) -> None:
        self.click(*self.middle(selector))

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        self._open.close()


class Chromium:
    """A browser with a profile of its own, which is gone with it."""

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._pages = []
        command = [program(), *OPTIONS, f"--user-data-dir={self._folder.name}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port_file = Path(self._folder.name) / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and (not port_file.exists() or port_file.read_text().count("\n") < 1):
            time.sleep(0.05)
        port, path = port_file.read_text().split("\n")[:2]
        self._port = port
        self._browser = Page(f"ws://127.0.0.1:{port}{path}", domains=())
        return self

    def page(self, url: str, width: int = 1280, height: int = 720) -> Page:
        """Open a tab."""
        target = self._browser.ask("Target.createTarget", url="about:blank")["targetId"]
        page = Page(f"ws://127.0.0.1:{self._port}/devtools/page/{target}")
        page.size(width, height)
        page.go(url)
        self._pages.append(page)
        return page

    def __exit__(self, *_):
        for page in self._pages:
            page.close()
        self._browser.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()
