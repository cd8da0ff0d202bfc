"""Pictures of every page of the dashboard in every state: python3 tests/figures/screens.py PALPATE FOLDER

    python3 tests/figures/screens.py TARGET/debug/palpate screens          # everything; then open screens/index.html
    python3 tests/figures/screens.py http://127.0.0.1:8474 screens [--empty URL] [--state STATE].. [VIEW..]

With PALPATE it starts two services in a temporary folder: an empty one, and one with a finished campaign, its dataset,
a net that serves, a campaign with three tips under way, and one that is queued. With a URL it shows that service.

Pages, opened items (a trial, a dataset, a net, a report, a lineage ..), dialogs, forms and the description of the API
in the state `busy`: the service as it is. The pages also `empty` (another service), `lost` (no connection), `tripped`,
`halted` (an e-stop that an axis has not acknowledged) and `disk` (nearly full): for the last four the browser changes what the page receives, or its connection is cut, so
that nothing happens to the rig. Each as a desk (1400 x 900, the whole page) and a phone (390 x 844), light and dark;
the busy pages also as a wall screen (1920 x 1080). `tests/system/browser/views.py` lists what there is.

FOLDER/index.html shows all pictures by state and view, and above them the errors that the pages wrote to the console,
and each page whose content is wider than the screen. A VIEW is a name of it, such as `night` or `dialog-abort`.
`pages.py` measures what the pages cost. Needs Chromium (PALPATE_CHROMIUM) and playwright.
"""

import argparse
import html
import pathlib
import sys
import tempfile
from contextlib import ExitStack

from playwright.sync_api import Error, sync_playwright

sys.dont_write_bytecode = True
sys.path[1:1] = [str(pathlib.Path(__file__).parents[1] / "system/browser")]
import views  # noqa: E402
from bench import Bench, call  # noqa: E402

SIZES = {"desk": (1400, 900), "phone": (390, 844), "wall": (1920, 1080)}
LIGHTS = ("light", "dark")
STATES = ["busy", "empty", *views.BROKEN]
WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
SETTLE_MS, REDRAWN_MS = 2500, 700
# Slow enough that the campaign lasts while the pictures are made.
SPEED, QUICKSTART_S = 6.0, 600
THREE_TIPS = """name = 'three-tips'\nseed = 7\nsensor = 'sensors/ert-28.toml'\n[real_hex]\ntips = [3]
configurations = 400\n"""
BUSY_TRIALS = 120


def furnished(bench):
    """Gives each page something to show."""
    bench.home()
    run = bench.carried("quickstart")
    bench.begin(run)
    bench.ended(run, QUICKSTART_S)
    bench.api("/datasets", {"name": "run-1"})
    bench.api("/serving", {"what": bench.net()})
    bench.net(seed=2)  # One that does not serve can be promoted.
    run = bench.queue(THREE_TIPS)
    bench.begin(run)
    bench.stored(BUSY_TRIALS)
    bench.carried("real-random")


class Sheet:
    """The pictures and the faults, and the page that shows them."""

    def __init__(self, folder):
        self.folder, self.pictures, self.faults = folder, {}, []
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, state, view, size, light):
        """Name of the file of a picture, which the page will show."""
        middle = "" if state == "busy" else f"{state}-"
        name = f"{view}-{middle}{size}-{light}.png"
        self.pictures.setdefault(state, {}).setdefault(view, {})[size, light] = name
        return self.folder / name

    def fault(self, words):
        """Something to mend."""
        self.faults.append(words)
        print(words, flush=True)

    def write(self):
        """Writes index.html."""
        jumps = " · ".join(f'<a href="#{state}">{state}</a>' for state in self.pictures)
        faults = "".join(f"<li>{html.escape(words)}</li>" for words in self.faults)
        states = "".join(self.state(state, of) for state, of in self.pictures.items())
        (self.folder / "index.html").write_text(PAGE.format(
            jumps=jumps, faults=f"<ol>{faults}</ol>" if faults else "<p>No fault.</p>", states=states))

    def state(self, state, of):
        """The pictures of a state, a row for each view."""
        return f'<h2 id="{state}">{state}</h2>' + "".join(self.row(view, sizes) for view, sizes in of.items())

    def row(self, view, sizes):
        """The pictures of a view."""
        shown = "".join(
            f'<a class="{size}" href="{name}"><img loading="lazy" src="{name}" alt="{view}, {size}, {light}"></a>'
            for (size, light), name in sizes.items())
        return f"<h3>{html.escape(view)}</h3><div>{shown}</div>"


PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Pictures of the dashboard</title>
<style>
  body {{ font: 15px/1.4 system-ui, sans-serif; margin: 0 20px 40px; background: #888; color: #000 }}
  nav {{ position: sticky; top: 0; background: #888; padding: 8px 0; z-index: 1 }}
  h2 {{ scroll-margin-top: 44px }} h3 {{ margin: 18px 0 4px }}
  div {{ display: flex; flex-wrap: wrap; gap: 10px; align-items: flex-start }}
  div a {{ overflow: hidden; background: #fff }}
  img {{ display: block; width: 100% }}
  .desk {{ width: 460px; height: 420px }} .phone {{ width: 194px; height: 420px }} .wall {{ width: 620px }}
</style>
<nav>{jumps}</nav>
{faults}
{states}
"""


def pictures(browser, sheet, url, view, state, sizes):
    """The pictures of a view in a state: a page for each size, light and dark."""
    for size in sizes:
        width, height = SIZES[size]
        look = {"viewport": {"width": width, "height": height}, "color_scheme": LIGHTS[0]}
        called = f"{view.name}, {state}, {size}"
        try:
            with views.shown(browser, url, view, state, SETTLE_MS, **look) as (page, errors):
                for words in errors:
                    sheet.fault(f"{called}: {words}")
                for light in LIGHTS:
                    page.emulate_media(color_scheme=light)
                    page.wait_for_timeout(REDRAWN_MS)
                    page.screenshot(path=sheet.add(state, view.name, size, light), full_page=size == "desk")
                wide = page.evaluate(WIDE)
                if wide > 0:
                    sheet.fault(f"{called}: {wide} pixels wider than the screen")
        except Error as error:
            sheet.fault(f"{called}: not shown, {str(error).splitlines()[0]}")


def state_pictures(browser, sheet, url, state, wanted, get):
    """All pictures of a state."""
    page = browser.new_page()
    page.goto(url)
    plain = views.pages(page)
    page.close()
    items = [*views.opened(get), *views.DOCS, *views.DIALOGS, *views.FORMS] if state == "busy" else []
    for view in [*plain, *items]:
        if not wanted or view.name in wanted:
            sizes = list(SIZES) if state == "busy" and view in plain else ["desk", "phone"]
            pictures(browser, sheet, url, view, state, sizes)
    print(f"{state}: {len(sheet.pictures.get(state, {}))} views", flush=True)


def services(args, stack):
    """The addresses of the busy and the empty service; the latter may be None."""
    if args.target.startswith("http"):
        return args.target.rstrip("/"), args.empty and args.empty.rstrip("/")
    folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="palpate-screens-")))
    empty = "empty" in args.state and stack.enter_context(Bench(args.target, folder / "empty"))
    busy = stack.enter_context(Bench(args.target, folder / "busy", SPEED))
    furnished(busy)
    return busy.url, empty and empty.url


def main():
    """Makes all pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", metavar="PALPATE or URL")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("views", nargs="*", metavar="VIEW")
    parser.add_argument("--empty", metavar="URL", help="a service on an empty folder")
    parser.add_argument("--state", action="append", choices=STATES)
    args = parser.parse_intermixed_args()
    args.state = args.state or STATES
    sheet = Sheet(args.folder)
    with ExitStack() as stack:
        url, empty = services(args, stack)
        playwright = stack.enter_context(sync_playwright())
        browser = views.launched(playwright)
        for state in args.state:
            of = empty if state == "empty" else url
            if of:
                state_pictures(browser, sheet, of, state, args.views, lambda path: call(url, f"/api/v1{path}", seconds=60))
            else:
                print("empty: none, without --empty", flush=True)
            sheet.write()
        browser.close()
    print(f"{args.folder / 'index.html'}: {len(sheet.faults)} faults")


main()
