"""A headless Chromium, driven over the WebDriver protocol (w3.org/TR/webdriver2) with the standard library."""

from __future__ import annotations

import base64
import http.client
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.patience import scaled

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
DRIVER = shutil.which("chromedriver")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
    *("--disable-default-apps", "--disable-extensions", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"),
)


class Browser:
    """One window. Selectors are CSS; a button is found by its text."""

    def __init__(self, port: int, profile: Path) -> None:
        self._port = port
        options = {"binary": CHROMIUM, "args": [*FLAGS, f"--user-data-dir={profile}"]}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        self._session = ""
        made = self._ask("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self._session = f"/session/{made['sessionId']}"

    def _ask(self, method: str, path: str, body: Any = None) -> Any:
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=scaled(60))
        try:
            payload = None if body is None else json.dumps(body)
            connection.request(method, self._session + path, payload, {"Content-Type": "application/json"})
            response = connection.getresponse()
            value = json.loads(response.read())["value"]
        finally:
            connection.close()
        assert response.status == 200, value
        return value

    def open(self, url: str) -> None:
        self._ask("POST", "/url", {"url": url})

    def run(self, script: str, *arguments: Any) -> Any:
        """What the body of a function returns in the page."""
        return self._ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def text(self, selector: str = "body") -> str:
        return str(self.run("return document.querySelector(arguments[0])?.innerText ?? ''", selector))

    def until(self, selector: str, text: str, seconds: float = 30.0) -> str:
        """Wait until the text of the element has `text`."""
        end = time.monotonic() + scaled(seconds)
        while text not in (found := self.text(selector)):
            assert time.monotonic() < end, f"no {text!r} in {selector} but {found!r}"
            time.sleep(0.1)
        return found

    def until_other(self, selector: str, seconds: float = 30.0) -> str:
        """Wait until the text of the element is another one."""
        end, first = time.monotonic() + scaled(seconds), self.text(selector)
        while (found := self.text(selector)) == first:
            assert time.monotonic() < end, f"{selector} stays {first!r}"
            time.sleep(0.1)
        return found

    def click(self, text: str, inside: str = "body") -> None:
        """Press the button of that text as a pointer does: where it is, when it can be seen and pressed."""
        find = "[...document.querySelectorAll(arguments[0] + ' button')].find(b => b.innerText === arguments[1])"
        element = self.run(f"const b = {find}; b?.scrollIntoView({{block: 'center'}}); return b", inside, text)
        assert element, f"no button {text!r} in {self.text(inside)!r}"
        (reference,) = element.values()
        self._ask("POST", f"/element/{reference}/click", {})

    def type(self, selector: str, text: str) -> None:
        (reference,) = self._ask("POST", "/element", {"using": "css selector", "value": selector}).values()
        self._ask("POST", f"/element/{reference}/value", {"text": text})

    def resize(self, width: int, height: int) -> None:
        """The size of the page itself, as on a phone."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._ask("POST", "/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": metrics})

    def screenshot(self, path: Path) -> None:
        shot = self._ask("POST", "/goog/cdp/execute", {"cmd": "Page.captureScreenshot", "params": _WHOLE})
        path.write_bytes(base64.b64decode(shot["data"]))

    def complaints(self) -> list[str]:
        """What the console has got since the last call: errors of scripts, refused and failed requests."""
        found = self._ask("POST", "/se/log", {"type": "browser"})
        return [entry["message"] for entry in found if entry["level"] in {"SEVERE", "WARNING"}]

    def close(self) -> None:
        self._ask("DELETE", "")


_WHOLE = {"format": "png", "captureBeyondViewport": True}


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with a fresh profile, until the end of the block."""
    assert DRIVER is not None
    with tempfile.TemporaryDirectory(prefix="mavcal-ui-", ignore_cleanup_errors=True) as folder:
        log = (Path(folder) / "driver.log").open("w+")
        process = subprocess.Popen([DRIVER, "--port=0"], stdout=log, stderr=subprocess.STDOUT)
        try:
            window = Browser(_port(process, Path(log.name)), Path(folder) / "profile")
            try:
                yield window
            finally:
                window.close()
        finally:
            process.terminate()
            process.wait(scaled(10))
            log.close()


def _port(process: subprocess.Popen[bytes], log: Path) -> int:
    end = time.monotonic() + scaled(20)
    while time.monotonic() < end and process.poll() is None:
        for line in log.read_text().splitlines():
            if "started successfully on port" in line:
                return int(line.rstrip(".").split()[-1])
        time.sleep(0.05)
    raise AssertionError(f"chromedriver did not start: {log.read_text()}")
