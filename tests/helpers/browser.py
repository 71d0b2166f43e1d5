"""A headless Chromium, driven by the DevTools protocol over a WebSocket of tornado (which dask installs)."""

import asyncio
import base64
import json
import re
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

import pytest
from tornado.websocket import websocket_connect

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")


class Page:
    """A tab: JavaScript, real pointer and key events, errors of the console, addresses that it asked for."""

    def __init__(self, loop, socket, port):
        self._loop, self._socket, self._number, self._port = loop, socket, 0, port
        self.messages, self.addresses = [], []

    @contextmanager
    def another(self):
        """Yield a further tab in front, with the same cookies; this one draws nothing until it is closed."""
        wanted = urllib.request.Request(f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(wanted) as answer:
            address = json.load(answer)["webSocketDebuggerUrl"]
        socket = self._loop.run_until_complete(_connect(address))
        tab = Page(self._loop, socket, self._port)
        try:
            yield tab
        finally:
            tab.send("Page.close")
            socket.close()
            self.send("Page.bringToFront")

    def send(self, method, **params):
        """Send a command and return its result; events that arrive before are kept."""
        return self._loop.run_until_complete(asyncio.wait_for(self._send(method, params), 60))

    async def _send(self, method, params):
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            message = json.loads(await self._socket.read_message())
            if message.get("id") == self._number:
                assert "error" not in message, (method, message)
                return message["result"]
            self._keep(message)

    def _keep(self, message):
        if message.get("method") in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"):
            self.messages.append(json.dumps(message["params"])[:500])
        if message.get("method") == "Network.requestWillBeSent":
            self.addresses.append(message["params"]["request"]["url"])

    def open(self, place, *, width=1280, height=900):
        """Open a file or an address and wait until it is loaded."""
        address = place if isinstance(place, str) else place.as_uri()
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        self.messages, self.addresses = [], []
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.send("Page.navigate", url=address)
        kind = json.dumps(address.partition(":")[0] + ":")
        self.until(f"document.readyState === 'complete' && location.protocol === {kind}")

    def until(self, expression, *, seconds=60):
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.js(expression):
            assert time.monotonic() < end, f"not within {seconds} s: {expression}; the console: {self.messages}"
            time.sleep(0.02)

    def js(self, expression):
        """Return the value of an expression."""
        done = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def middle(self, selector):
        """Return the middle of an element in the window, scrolled into it."""
        return self.js(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: 'center', behavior: 'instant'}});"
            " const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )

    def move(self, x, y):
        """Move the pointer."""
        self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def click(self, selector):
        """Press and release the button on the middle of an element."""
        x, y = self.middle(selector)
        self.move(x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def type(self, text):
        """Type into the element that has the focus."""
        self.send("Input.insertText", text=text)

    def press(self, key):
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, text=key if len(key) == 1 else "")

    def drag(self, start, end, *, button="left", steps=6):
        """Press a button at a place of the window, move to another one and release."""
        places = [[a + (b - a) * k / steps for a, b in zip(start, end, strict=True)] for k in range(steps + 1)]
        self.move(*start)
        self.send("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], button=button, clickCount=1)
        for x, y in places[1:]:
            self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button=button)
        self.send("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], button=button, clickCount=1)

    def picture(self):
        """Return the window as PNG."""
        return base64.b64decode(self.send("Page.captureScreenshot")["data"])

    def pdf(self):
        """Return the page as printed."""
        return base64.b64decode(self.send("Page.printToPDF", printBackground=True)["data"])


@contextmanager
def browser_page(folder):
    """Start Chromium with its files in a folder and yield a page; skip the test where there is none."""
    program = next((found for name in PROGRAMS if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: install Debian's chromium ({', '.join(PROGRAMS)} were searched)")
    # SwiftShader renders WebGL without a graphics card.
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run"]
    options.append("--remote-debugging-port=0")
    arguments = [program, *options, f"--user-data-dir={folder}", "about:blank"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        loop = asyncio.new_event_loop()
        try:
            port = next(m[1] for line in process.stderr if (m := re.search(r"ws://127\.0\.0\.1:(\d+)/", line)))
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                address = next(tab for tab in json.load(answer) if tab["type"] == "page")["webSocketDebuggerUrl"]
            socket = loop.run_until_complete(_connect(address))
            yield Page(loop, socket, port)
            socket.close()
        finally:
            process.terminate()
            process.stderr.close()
            loop.close()


async def _connect(address):
    return await websocket_connect(address, max_message_size=1 << 28)
