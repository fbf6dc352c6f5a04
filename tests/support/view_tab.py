"""A browser that looks at `clradar view`."""

import base64
import contextlib
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import chromium
import numpy as np
import pytest
from PIL import Image

in_browser = pytest.mark.skipif(
    chromium.installed() is None,
    reason="no Chromium here: install Debian's chromium package to try the view in a browser",
)

SIZE = (800, 600)
SCENE = slice(200, 560), slice(20, 440)
"""Rows and columns beside the panel and below the browser's own notice about software WebGL."""


class Tab:
    """A tab that looks at a view."""

    def __init__(self, page: chromium.Page, address: str) -> None:
        self.page, self.address = page, address
        page.resize(*SIZE)

    def load(self, words: str) -> None:
        self.page.open(self.address)
        self.says(words)

    def says(self, words: str) -> None:
        """Wait until the page contains these words."""
        self.until(f"document.body.textContent.includes({json.dumps(words)})")

    def until(self, condition: str) -> None:
        """Wait until an expression is true; a value that a script sets is no event of the page."""
        end_s = time.monotonic() + chromium.DEADLINE_S
        while not self.page.js(f"Boolean({condition})"):
            assert time.monotonic() < end_s, f"waited in vain until {condition}"
            time.sleep(0.05)

    def control(self, label: str) -> str:
        """The expression of the input beside a label."""
        return (
            "(() => { let row = [...document.querySelectorAll('*')].find(one =>"
            f" !one.children.length && one.textContent === {json.dumps(label)});"
            " while (row && !row.querySelector('input')) row = row.parentElement;"
            " return row && row.querySelector('input'); })()"
        )

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a dropdown."""
        self.page.js(f"{self.control(label)}.click()")
        found = (
            "[...document.querySelectorAll('[role=option]')].find(one => one.textContent === "
            f"{json.dumps(option)})"
        )
        self.until(found)
        self.page.js(f"{found}.click()")

    def type(self, label: str, text: str) -> None:
        """Replace the text of an input."""
        self.page.js(f"(input => {{ input.focus(); input.select(); }})({self.control(label)})")
        self.page.call("Input.insertText", text=text)
        self.page.key("Tab", "Tab")

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.page.mouse(kind, x, y, button="left", clickCount=1)

    def lit(self, wanted: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray:
        """Wait until the columns of pixels in the measured and the simulated colours are as wanted.

        Returns those of the measured ones.
        """
        while True:
            self.page.settle()  # drawing follows the messages
            shot = base64.b64decode(self.page.call("Page.captureScreenshot")["data"])
            image = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), np.int16)[SCENE]
            coloured = np.ptp(image, axis=2) > 60
            cyan = image.argmin(axis=2) == 0
            measured = np.nonzero(coloured & ~cyan)[1] + SCENE[1].start
            simulated = np.nonzero(coloured & cyan)[1] + SCENE[1].start
            if wanted(measured, simulated):
                return measured


@contextlib.contextmanager
def viewing(
    command: str, source: object, *options: object
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`clradar view` on a free port, and the address that it prints."""
    with _running("-m", "clradar", command, source, "--port", "0", *options) as found:
        yield found


@contextlib.contextmanager
def running_script(script: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A script that shows something, and the address that it prints."""
    with _running(script) as found:
        yield found


@contextlib.contextmanager
def _running(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    program = [sys.executable, *map(str, arguments)]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            lines = (line.split()[0] for line in process.stdout)
            yield process, next(word for word in lines if word.startswith("http:"))
        finally:
            process.kill()
