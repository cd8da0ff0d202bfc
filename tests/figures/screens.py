"""Pictures of every page of the dashboard: python3 tests/figures/screens.py URL FOLDER [PAGE..]

    palpate run experiments/quickstart.toml --data /tmp/screens          # data to show
    palpate serve --data /tmp/screens --bind 127.0.0.1:8474              # and a virtual rig
    python3 tests/figures/screens.py http://127.0.0.1:8474 screens

Each page as a desk (1400 x 900), a phone (390 x 844) and a wall screen (1920 x 1080), light and dark; the
night also without a connection and with a full disk (the browser changes what the page receives).
Prints for each page: time to the first paint and memory of its scripts, from a cold cache. Needs
Chromium (PALPATE_CHROMIUM) and playwright.
"""

import json
import os
import pathlib
import shutil
import sys

from playwright.sync_api import sync_playwright

URL, FOLDER = sys.argv[1].rstrip("/"), pathlib.Path(sys.argv[2])
PAGES = sys.argv[3:] or ["night", "queue", "plan", "place", "runs", "trials", "data", "model", "nets", "live",
                         "rig", "wear", "settings"]
SIZES = {"desk": (1400, 900), "phone": (390, 844), "wall": (1920, 1080)}
PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? -1"
HEAP = "performance.memory.usedJSHeapSize / 1e6"
SETTLE_MS = 2500


def full(route):
    """A status whose disk is nearly full."""
    answer = route.fetch()
    status = answer.json()
    if isinstance(status, dict) and "rig" in status:
        status["disk"] = {"free_bytes": 90_000_000, "needed_bytes": 4_200_000_000}
    route.fulfill(response=answer, body=json.dumps(status))


def nearly_full(page):
    """Lets a page receive only such statuses: without its socket it asks for them."""
    page.route_web_socket("**/status/live*", lambda wire: wire.close())
    page.route("**/api/v1/status", full)


def open_page(browser, path, size, scheme, before=None):
    width, height = SIZES[size]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    if before:
        before(page)
    page.goto(URL + path, wait_until="domcontentloaded")
    page.wait_for_timeout(SETTLE_MS)
    return context, page


def main():
    FOLDER.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = os.environ.get("PALPATE_CHROMIUM") or shutil.which("chromium")
        browser = playwright.chromium.launch(
            executable_path=chromium,
            args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--enable-precise-memory-info"])
        for name in PAGES:
            path = "/" if name == "night" else f"/{name}"
            for size in SIZES:
                for scheme in ("light", "dark"):
                    context, page = open_page(browser, path, size, scheme)
                    if size == "desk" and scheme == "light":
                        paint, heap = page.evaluate(PAINT), page.evaluate(HEAP)
                        print(f"{name}: first paint {paint:.0f} ms, scripts hold {heap:.1f} MB", flush=True)
                    page.screenshot(path=FOLDER / f"{name}-{size}-{scheme}.png", full_page=size == "desk")
                    context.close()
        if "night" in PAGES:
            context, page = open_page(browser, "/", "desk", "light")
            context.set_offline(True)
            page.route("**/*", lambda route: route.abort())
            page.wait_for_timeout(5000)
            page.screenshot(path=FOLDER / "night-desk-lost.png")
            context.close()
            context, page = open_page(browser, "/", "desk", "light", nearly_full)
            page.screenshot(path=FOLDER / "night-desk-disk.png")
            context.close()
        browser.close()


main()
