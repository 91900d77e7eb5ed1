"""Headless Chromium for tests of pages, and what is to be seen on them."""

from __future__ import annotations

import io
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
SECONDS = 240.0
"""Patience: WebGL without a graphics card is slow, and slower still beside other work."""


def chromium() -> Iterator[Any]:
    """Yield a browser, for a fixture; skip where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="make test-all installs it")
    system = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_api.sync_playwright() as playwright:
        if system is None and not Path(playwright.chromium.executable_path).exists():
            pytest.skip("no Chromium; `make test-all` installs one where it can")
        browser = playwright.chromium.launch(executable_path=system, args=_FLAGS)
        yield browser
        browser.close()


def picture(page: Any, name: str) -> np.ndarray:
    """What is to be seen, (h, w, 3); kept where `ROBOASSEMBLY_SCREENSHOTS` says."""
    content = page.screenshot(timeout=1e3 * SECONDS)
    folder = os.environ.get("ROBOASSEMBLY_SCREENSHOTS")
    if folder:
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.png").write_bytes(content)
    return np.asarray(iio.imread(io.BytesIO(content), extension=".png"))[..., :3].astype(int)


def press(page: Any, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def turn_to(page: Any, tab: str) -> None:
    page.get_by_role("tab", name=tab, exact=True).click()


def until(true: Callable[[], Any], seconds: float = SECONDS) -> Any:
    end = time.monotonic() + seconds
    while not (value := true()):
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.05)
    return value
