"""A headless Chromium, steered over its DevTools protocol; for tests and benchmarks."""

import base64
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any


def found() -> str | None:
    """Where Chromium is, if anywhere."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Browser:
    """One page; a context that closes it."""

    def __init__(self, size: tuple[int, int] = (1400, 1000)):
        from websockets.sync.client import connect

        # Chromium's children may still write there as it ends.
        self._folder = tempfile.TemporaryDirectory(
            prefix="tomojax-browser-", ignore_cleanup_errors=True
        )
        profile = Path(self._folder.name)
        words = [
            str(found()),
            "--headless=new",
            "--remote-debugging-port=0",
            "--no-first-run",
        ]
        words += [f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        words += ["--disable-gpu", "--disable-dev-shm-usage"]
        if hasattr(os, "getuid") and os.getuid() == 0:
            words.append("--no-sandbox")  # Chromium's needs another user
        null = subprocess.DEVNULL
        self.process = subprocess.Popen(
            [*words, "about:blank"], stdout=null, stderr=null, start_new_session=True
        )
        told, end = profile / "DevToolsActivePort", time.monotonic() + 60
        while not told.exists() or len(told.read_text().splitlines()) < 2:
            assert time.monotonic() < end, "Chromium does not start"
            time.sleep(0.05)
        port, path = told.read_text().splitlines()[:2]
        connected = connect(f"ws://127.0.0.1:{port}{path}", max_size=None)
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(connected)
        self._number, self._session, self.said = 0, None, []
        targets = self.ask("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        given = {"targetId": page, "flatten": True}
        self._session = self.ask("Target.attachToTarget", **given)["sessionId"]
        for name in ("Page", "Runtime", "Log"):
            self.ask(f"{name}.enable")
        self.resize(*size)

    def ask(self, method: str, **given: Any) -> dict[str, Any]:
        self._number += 1
        asked: dict[str, Any] = {"id": self._number, "method": method, "params": given}
        if self._session:
            asked["sessionId"] = self._session
        self._socket.send(json.dumps(asked))
        while True:
            told = json.loads(self._socket.recv(timeout=60))
            if told.get("id") == self._number:
                assert "error" not in told, told
                return told["result"]
            # What the page complains of.
            if told.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                self.said.append(told["params"])

    def resize(self, width: int, height: int) -> None:
        metrics = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": False,
        }
        self.ask("Emulation.setDeviceMetricsOverride", **metrics)

    def go(self, url: str) -> None:
        self.ask("Page.navigate", url=url)

    def value(self, script: str) -> Any:
        """What a script says, which may be a promise."""
        given = {"expression": script, "returnByValue": True, "awaitPromise": True}
        told = self.ask("Runtime.evaluate", **given)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def wait(self, script: str, seconds: float = 60.0) -> Any:
        """Until a script says something that is true."""
        end = time.monotonic() + seconds
        while not (said := self.value(script)):
            assert time.monotonic() < end, f"{script}: {self.said[-3:]}"
            time.sleep(0.05)
        return said

    def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, text=key)

    def picture(self, path: Path) -> None:
        told = self.ask("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(told["data"]))

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: Any) -> None:
        self._stack.close()
        self.process.terminate()
        self.process.wait(20)
        self._folder.cleanup()


def address(lines: Any) -> str:
    """The page's address out of a command's lines."""
    said = []
    for line in lines:
        said.append(line)
        if match := re.search(r"page: (http://\S+)", line):
            return match[1]
    raise AssertionError(f"no address of a page: {said[-5:]}")
