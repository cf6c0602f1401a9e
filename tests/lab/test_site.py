"""The documentation in Chromium: nothing is cut on a desk or a phone, and every family has a recording."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from chromium import NAME, PATIENCE, Chromium

import myowarp

ROOT = Path(__file__).parents[2]
WIDTHS = (1280, 390)  # px
CUT = """JSON.stringify([...document.querySelectorAll('.table-wrapper, pre, img, iframe, h1, p')].filter(e =>
    e.offsetParent && (e.getBoundingClientRect().right > innerWidth + 1 ||
    (e.matches('.table-wrapper, pre') && e.scrollWidth > e.clientWidth + 1))
).map(e => e.outerHTML.slice(0, 90)))"""

pytestmark = [pytest.mark.view, pytest.mark.skipif(NAME is None, reason="needs chromium")]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "-d", folder / "doctrees", "docs", folder / "html"]
    subprocess.run(build, cwd=ROOT, check=True)
    return folder / "html"


def visited(browser, address):
    browser.open(address)
    until = time.monotonic() + PATIENCE
    while browser.run("location.href") != address or browser.run("document.readyState") != "complete":
        assert time.monotonic() < until, address
        time.sleep(0.05)


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut(site, width):
    """Folded tables are opened; a page of each kind of task stands for all."""
    pages = [
        page
        for folder in (".", "start", "howto", "results", "experiments/exo1")
        for page in (site / folder).glob("*.html")
    ]
    tasks = ("index", "pose", "reach", "myoHandPenTwirlRandom-v0", "myoArmReachRandom-v0")
    pages += [site / f"tasks/{name}.html" for name in tasks]
    with Chromium((width, 800)) as browser:
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        for page in pages:
            if page.stem in ("audit", "genindex", "search", "py-modindex"):
                continue
            visited(browser, page.as_uri())
            browser.run("document.querySelectorAll('details').forEach(d => d.open = true)")
            assert json.loads(browser.run(CUT)) == [], page.relative_to(site)
            assert browser.run("document.querySelectorAll('meta[name=description]').length") >= 1, page
            blocks = browser.run("document.querySelectorAll('.highlight').length")
            assert browser.run("document.querySelectorAll('button.copy').length") == blocks


def test_every_family_has_a_recording(site):
    """On a small page, as software draws; patience is for each picture, as busy cores draw few."""
    families = {myowarp.TASKS[key].family for key in myowarp.TASKS}
    with Chromium((400, 300)) as browser:
        for family in sorted(families):
            visited(browser, "about:blank")  # another `#name` alone loads nothing
            browser.open(f"{(site / 'recordings/player.html').as_uri()}#{family}")
            browser.wait_for("activation")
            seen, until = set(), time.monotonic() + PATIENCE
            while len(seen) < 3:  # times that the bar below the scene has shown
                assert time.monotonic() < until, f"{family}: the bar has shown {seen}"
                shown = browser.run("(document.querySelector('input') || {}).value")
                if shown not in seen:
                    seen.add(shown)
                    until = time.monotonic() + PATIENCE
                time.sleep(0.2)
            assert browser.run("document.querySelectorAll('canvas').length") > 0
