"""Pictures of every page of the dashboard: python3 tests/figures/screens.py URL FOLDER [--empty URL] [--state STATE].. [PAGE..]

    palpate run experiments/quickstart.toml --data /tmp/screens          # data to show
    palpate serve --data /tmp/screens --bind 127.0.0.1:8474              # and a virtual rig, with a run for `busy`
    palpate serve --data /tmp/empty --bind 127.0.0.1:8475                # for the state `empty`
    python3 tests/figures/screens.py http://127.0.0.1:8474 screens --empty http://127.0.0.1:8475

Each page as a desk (1400 x 900), a phone (390 x 844) and a wall screen (1920 x 1080), light and dark, in the
state `busy`: the service as it is. In the states `empty` (another service), `lost` (no connection), `tripped`
and `disk` (nearly full) as a desk and a phone, light: for the last three the browser changes what the page
receives, so that nothing happens to the rig. Reports what the pages write to the console, and each page whose
content is wider than the screen. `pages.py` prints what the pages cost. Needs Chromium (PALPATE_CHROMIUM) and
playwright.
"""

import argparse
import json
import os
import pathlib
import shutil

from playwright.sync_api import sync_playwright

SIZES = {"desk": (1400, 900), "phone": (390, 844), "wall": (1920, 1080)}
PAGES = "import('/web/pages.js').then(pages => pages.PAGES.map(page => page.name))"
WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
SETTLE_MS, LOST_MS = 3000, 3500
TRIP = {"kind": "force", "detail": "cell 3 reads 91.4 N, limit 88.0 N"}


def nearly_full(status):
    status["disk"] = {"free_bytes": 90_000_000, "needed_bytes": 4_200_000_000}


def tripped(status):
    status["rig"].update(state="tripped", trip=TRIP)
    if status["run"]:
        status["run"].update(state="paused", paused_why="trip")


def with_status(change):
    """Lets a page receive only changed statuses: without its socket it asks for them."""

    def changed(route):
        answer = route.fetch()
        status = answer.json()
        if isinstance(status, dict) and "rig" in status:
            change(status)
        route.fulfill(response=answer, body=json.dumps(status))

    def before(page):
        page.route_web_socket("**/status/live*", lambda wire: wire.close())
        page.route("**/api/v1/status", changed)

    return before


def lose(page):
    """Cuts the connection of a page that was shown."""
    page.context.set_offline(True)
    page.route("**/*", lambda route: route.abort())
    page.wait_for_timeout(LOST_MS)


# What is done before a page is opened, after it was shown, and the sizes and lights of its pictures.
BOTH, ALL = [("desk", "light"), ("phone", "light")], [(size, light) for size in SIZES for light in ("light", "dark")]
STATES = {
    "busy": (None, None, ALL), "empty": (None, None, BOTH), "lost": (None, lose, BOTH),
    "tripped": (with_status(tripped), None, BOTH), "disk": (with_status(nearly_full), None, BOTH),
}


def picture(browser, url, name, state, size, light, folder):
    before, after, _ = STATES[state]
    width, height = SIZES[size]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=light)
    page = context.new_page()
    file = f"{name}-{size}-{light}.png" if state == "busy" else f"{name}-{size}-{state}.png"
    told = []
    page.on("console", lambda message: told.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: told.append(str(error)))
    if before:
        before(page)
    page.goto(url + ("/" if name == "night" else f"/{name}"), wait_until="domcontentloaded")
    page.wait_for_timeout(SETTLE_MS)
    said = list(told)
    if after:
        after(page)
    page.screenshot(path=folder / file, full_page=size == "desk")
    wide = page.evaluate(WIDE)
    if wide > 0:
        print(f"{file}: {wide} pixels wider than the screen", flush=True)
    for text in said:
        # A browser reports every refused request; what is refused in a changed state is no fault.
        if state != "empty" and "the server responded with a status of" not in text and "WebSocket" not in text:
            print(f"{file}: {text}", flush=True)
    page.unroute_all(behavior="ignoreErrors")
    context.close()


def main():
    """Makes all pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("pages", nargs="*")
    parser.add_argument("--empty", help="a service on an empty folder")
    parser.add_argument("--state", action="append", choices=list(STATES))
    args = parser.parse_intermixed_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("PALPATE_CHROMIUM") or shutil.which("chromium"),
            args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
        page = browser.new_page()
        page.goto(args.url)
        names = args.pages or page.evaluate(PAGES)
        page.close()
        for state in args.state or list(STATES):
            url = args.empty if state == "empty" else args.url
            for name in names if url else []:
                for size, light in STATES[state][2]:
                    picture(browser, url.rstrip("/"), name, state, size, light, args.folder)
            print(f"{state}: {len(names)} pages" if url else f"{state}: none, without --empty", flush=True)
        browser.close()


main()
