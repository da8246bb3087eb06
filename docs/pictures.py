"""Pictures of what a newcomer sees, step by step, for inspection: `make pictures` writes them to out/pictures.

They show the report of the first cut, its playback, and the pages that follow. Needs a Chromium for the pages and a
Vulkan driver for the viewer, but no screen.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from edmsim.errors import InputError
from edmsim.recording.rerun.playback import find_recording
from edmsim.recording.rerun.viewer import take_screenshots

ROOT = Path(__file__).parents[1]
CUT, SITE, INTO = ROOT / "out" / "punch", ROOT / "out" / "docs", ROOT / "out" / "pictures"
STEPS = ("guide/quick-start", "playback", "notebooks/03-wire-lag-and-corners", "how-to/controller")
"""Pages of the site from a first cut to one's own controller, in order."""
WIDE, PHONE = (1280, 2400), (420, 2400)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def browser() -> str:
    """Return the command of a Chromium.

    Raises
    ------
    InputError
        If no Chromium is installed.
    """
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise InputError(f"pictures of pages need one of {', '.join(BROWSERS)} on the path")
    return found


def photograph(page: Path, picture: Path, size: tuple[int, int]) -> None:
    """Take a picture of a local page.

    Raises
    ------
    InputError
        If there is no such page, or the browser made no picture.
    """
    if not page.is_file():
        raise InputError("no such page: run make cut and make docs first", page)
    with tempfile.TemporaryDirectory() as profile:
        done = subprocess.run(
            [browser(), "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", f"--screenshot={picture}",
             page.resolve().as_uri()],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
    if not picture.is_file():
        raise InputError(f"the browser made no picture: {done.stderr.strip()[-200:]}", page)


def main() -> None:
    """Take all pictures."""
    INTO.mkdir(parents=True, exist_ok=True)
    for old in INTO.glob("*.png"):
        old.unlink()
    photograph(CUT / "report.html", INTO / "1-report.png", WIDE)
    photograph(CUT / "report.html", INTO / "1-report-phone.png", PHONE)
    take_screenshots(find_recording(CUT), INTO, (0.5,))
    photograph(SITE / "index.html", INTO / "0-site.png", WIDE)
    photograph(SITE / "guide" / "set-up.html", INTO / "0-site-phone.png", PHONE)
    for number, step in enumerate(STEPS, 2):
        photograph(SITE / f"{step}.html", INTO / f"{number}-{Path(step).name}.png", WIDE)
    print(*sorted(file.name for file in INTO.glob("*.png")), sep="\n")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"pictures: {error}")
