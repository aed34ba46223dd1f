"""A headless Chromium that a test controls over its debugging protocol."""

from __future__ import annotations

import asyncio
import json
import time
import urllib.request
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-port=0", "about:blank")
STARTUP_TIMEOUT = 60.0


class Browser:
    """An open tab; `console` are the messages and errors of its pages."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self.console: list[str] = []
        self._connection, self._number = connection, 0

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        await self._connection.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            received = await self._connection.read_message()
            assert received is not None
            message: dict[str, Any] = json.loads(received)
            if message.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                self.console.append(str(received))
            if message.get("id") == self._number:
                result: dict[str, Any] = message["result"]
                return result

    async def open(self, url: str, width: int, height: int, *, mobile: bool) -> None:
        """Open a page in a window of this size."""
        for domain in ("Runtime", "Log", "Page"):
            await self.call(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 2 if mobile else 1}
        await self.call("Emulation.setDeviceMetricsOverride", **size, mobile=mobile)
        await self.call("Emulation.setTouchEmulationEnabled", enabled=mobile)
        await self.call("Page.navigate", url=url)

    async def evaluate(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = await self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return result["result"].get("value")

    async def wait(self, script: str, timeout: float = 30.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + timeout
        while not await self.evaluate(script):
            assert time.monotonic() < end, script
            await asyncio.sleep(0.05)


@asynccontextmanager
async def browser(program: str, profile: Path) -> AsyncIterator[Browser]:
    """Start the program with an empty profile directory."""
    null = asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(
        program, *FLAGS, f"--user-data-dir={profile}", stdout=null, stderr=null
    )
    try:
        connection = await websocket_connect(await _tab(profile), max_message_size=1 << 24)
        try:
            yield Browser(connection)
        finally:
            connection.close()
            while await connection.read_message() is not None:
                pass
    finally:
        process.terminate()
        await process.wait()


async def _tab(profile: Path) -> str:
    """Return the address of the first tab, once the browser has written its port."""
    end, file = time.monotonic() + STARTUP_TIMEOUT, profile / "DevToolsActivePort"
    while time.monotonic() < end:
        if file.exists() and (lines := file.read_text().splitlines()):
            with urllib.request.urlopen(f"http://127.0.0.1:{lines[0]}/json", timeout=20.0) as response:
                tabs = json.load(response)
            if tabs:
                return str(tabs[0]["webSocketDebuggerUrl"])
        await asyncio.sleep(0.05)
    raise AssertionError("the browser does not start")
