"""Draw a report page as a browser shows it, on a desktop or on a phone.

    python docs/tools/page_picture.py demo/report.html page.png 1280x900
    python docs/tools/page_picture.py demo/report.html phone.png 390x844

A width below 600 is that of a phone, with a touch screen. The program chromium is needed.
"""

from __future__ import annotations

import asyncio
import base64
import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.slam.browser import browser

PHONE = 600
"""Width below which a window is that of a phone, pixels."""


async def take_picture(page: Path, picture: Path, size: str) -> list[str]:
    """Draw `page` in a window of a `size` such as 1280x900 pixels into `picture`; return its console's messages."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise FileNotFoundError("chromium is not installed")
    width, height = map(int, size.split("x"))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        async with browser(program, Path(profile)) as tab:
            await tab.open(page.resolve().as_uri(), width, height, mobile=width < PHONE)
            await tab.wait("document.readyState === 'complete'")
            drawn = await tab.call("Page.captureScreenshot", format="png")
            console = tab.console
    picture.write_bytes(base64.b64decode(drawn["data"]))
    return console


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    for message in asyncio.run(take_picture(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])):
        print(message, file=sys.stderr)
