"""What the pages of the dashboard cost a browser, against their limits: python3 tests/figures/pages.py PALPATE

    cargo build --release --bin palpate --example fill_database
    python3 tests/figures/pages.py TARGET/release/palpate [--data FOLDER] [--trials N] [--minutes M] [PAGE..]
    python3 tests/figures/pages.py URL [PAGE..]               # the pages of a service that is there

With PALPATE: fills FOLDER (a temporary one, if absent) with 198,000 trials and a week of events (`week.py`; the example
is searched next to PALPATE), starts a service and a virtual rig at the speed of the wall, promotes a small net, puts
three weights on the skin, and opens every page. Then it starts the paper's campaign and opens the night again. Last, on
another folder and at speed 20, the gaps between trials are measured while 20 dashboards are followed in every second
minute (`latency.py PALPATE dashboards` is this part alone).

Each page is opened in a new browser with a cold cache. Printed for each: time to the first paint; memory in MB of the
whole renderer process, its share of the pages that it shares included (PSS), of the same with all of these (RSS), and
of its scripts (JS heap), each after a garbage collection and again after the clicks; time of the main thread in a
minute; for each click the time to the first picture that it changed, and to the last answer that it asked for. The
limit of memory is compared with the PSS: the RSS counts the program of the browser once for each process.
On the page `live` the messages received and the pictures drawn are counted for 20 s. Ends with a table of each
figure, its limit, and `ok` or `OVER`. A browser without a GPU draws: a machine with one needs less.

A PAGE may have parameters: "live?method=paper". Needs Chromium (PALPATE_CHROMIUM) and playwright.
"""

import argparse
import json
import pathlib
import statistics
import sys
import tempfile
from dataclasses import dataclass, field

from playwright.sync_api import Error, sync_playwright

sys.dont_write_bytecode = True
sys.path[1:1] = [str(pathlib.Path(__file__).parents[1] / "system/browser")]
import latency  # noqa: E402
import views  # noqa: E402
import week  # noqa: E402
from bench import Bench  # noqa: E402
from wire import Wire  # noqa: E402

PAINT_LIMIT_MS, MEMORY_LIMIT_MB, CLICK_LIMIT_MS, LOST_LIMIT_MS = 1000, 150, 100, 3000
# Of a board's 30 frames per second; the edges of the counted time may cut one.
FRAMES_LIMIT_PER_S = 29.5
# What a person clicks on each page: name, selector, and the value of a choice, or the place as shares of the element.
# A click whose element is absent is not shown: the data decide.
CLICKS = {
    "night": [("colour by force", "select[aria-label='What the colours show']", "force"),
              ("all events", "select[aria-label='Which events']", "all"),
              ("predicted end", "select[aria-label='Second chart']", "end"),
              ("a place of the skin", "canvas.skin", (0.5, 0.5))],
    "plan": [("plan of the first choice", "main select", 1)],
    "runs": [("filter", "#state", 1), ("all", "#state", 0), ("open a run", "main tbody a", None),
             ("colour by FVU", "#colouring", "fvu"), ("all runs", "section.back a", None)],
    "trials": [("more rows", "button:text-is('More')", None), ("open a trial", "main tbody a", None),
               ("previous trial", "button:text-is('← Previous')", None), ("next trial", "button:text-is('Next →')", None),
               ("close it", "button:text-is('Close')", None)],
    "data": [("open a dataset", "main tbody a", None)],
    # Not in the middle, where there is a contact.
    "model": [("another contact on the skin", "canvas.skin", (0.3, 0.3)), ("a contact that is there", "canvas.skin", (0.3, 0.3))],
    "nets": [("open a net", "main tbody a", None)],
    "live": [("scale of the colours", "select[aria-label='Force at the end of the colours']", "20")],
    "wear": [("first choice", "main select", 1)],
}
# Opened items of the filled folder, in addition to the pages.
ITEMS = ["runs?run=1", "plan?run=1", "trials?trial=1000", "model?run=1"]
# In the page: from an input to the first painted change of the document, and to the last answer of the service.
WATCH = """
globalThis.palpateClick = () => {
  const all = { subtree: true, childList: true, attributes: true, attributeOldValue: true, characterData: true }
  let begun = 0, painted = 0, seen = null
  // The bar follows the clock of the service; an attribute that is set to what it was changes nothing.
  const isAnswer = ({ type, target, attributeName, oldValue }) => !(target.closest ? target : target.parentElement)?.closest('.bar')
    && (type !== 'attributes' || target.getAttribute(attributeName) !== oldValue)
  const paint = records => { if (!painted && records.some(isAnswer)) requestAnimationFrame(() => setTimeout(() => { painted ||= performance.now() })) }
  const begin = event => { if (!begun) { begun = event.timeStamp; seen = new MutationObserver(paint); seen.observe(document.body, all) } }
  for (const kind of ['click', 'change']) addEventListener(kind, begin, { capture: true, once: true })
  performance.clearResourceTimings()
  return () => {
    seen?.disconnect()
    // What is asked later follows the clock of the page, not the click.
    const asked = performance.getEntriesByType('resource').filter(r => r.startTime >= begun && r.startTime < begun + 700 && r.responseEnd && !r.name.includes('/live'))
    const slowest = asked.sort((a, b) => b.duration - a.duration)[0]
    return begun ? { painted: painted ? painted - begun : null, last: Math.max(0, ...asked.map(r => r.responseEnd - begun)),
      slowest: slowest?.duration ?? 0, name: slowest?.name ?? '', asked: asked.length } : null
  }
}
"""
PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? -1"
COUNTS = """Object.fromEntries(['arrived', 'drawn'].map(key =>
  [key, Number(document.querySelector('[data-drawn]')?.dataset[key] ?? -1)]))"""
# Frames that the service did not receive from the board.
MISSED = "fetch('/api/v1/status').then(answer => answer.json()).then(({ rig }) => rig.stream.missed)"
NODES = "document.querySelectorAll('*').length"
SETTLE_MS, ANSWER_MS, LIVE_S, MAIN_THREAD_S = 4000, 2500, 20, 10


@dataclass
class Memory:
    """Memory of a page, MB."""

    pss: float
    rss: float
    scripts: float

    def __str__(self):
        return f"renderer {self.pss:.0f} MB (RSS {self.rss:.0f} MB), scripts {self.scripts:.1f} MB"


@dataclass
class Costs:
    """What was measured: each figure with the page that it is of."""

    paint_ms: dict = field(default_factory=dict)
    memory: dict = field(default_factory=dict)
    clicks_ms: dict = field(default_factory=dict)
    live: dict = field(default_factory=dict)
    lost_ms: float | None = None
    gaps: tuple | None = None


class Watched:
    """A page in its own browser, with what it costs."""

    def __init__(self, playwright, url, path, frames=False):
        self.browser = views.launched(playwright, "--disable-features=SpareRendererForSitePerProcess")
        self.page = self.browser.new_page(viewport={"width": 1400, "height": 900})
        self.wire = self.page.context.new_cdp_session(self.page)
        self.wire.send("Performance.enable")
        self.live, self.sequences = None, []
        if frames:
            self.wire.send("Network.enable")
            self.wire.on("Network.webSocketCreated", self.opened)
            self.wire.on("Network.webSocketFrameReceived", self.heard)
        self.page.goto(url + path, wait_until="domcontentloaded")
        self.page.wait_for_timeout(SETTLE_MS)

    def opened(self, event):
        if "/api/v1/live" in event["url"]:
            self.live = event["requestId"]

    def heard(self, event):
        if event["requestId"] == self.live:
            self.sequences.append(json.loads(event["response"]["payloadData"]).get("sequence"))

    def metrics(self):
        return {one["name"]: one["value"] for one in self.wire.send("Performance.getMetrics")["metrics"]}

    def memory(self, collect=True):
        """Memory of its renderer, the largest one of the browser, and of its scripts; garbage is collected first."""
        if collect:
            self.wire.send("HeapProfiler.collectGarbage")
        processes = self.browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        sizes = [(0.0, 0.0)]
        for process in processes:
            if process["type"] == "renderer":
                rollup = pathlib.Path(f"/proc/{process['id']}/smaps_rollup").read_text().splitlines()
                kib = {line.split(":")[0]: int(line.split()[1]) for line in rollup[1:]}
                sizes.append((kib["Pss"] / 1024, kib["Rss"] / 1024))
        return Memory(*max(sizes), self.metrics()["JSHeapUsedSize"] / 1e6)

    def main_thread_s(self):
        """Seconds of its main thread in a minute."""
        before = self.metrics()["TaskDuration"]
        self.page.wait_for_timeout(1e3 * MAIN_THREAD_S)
        return (self.metrics()["TaskDuration"] - before) * 60 / MAIN_THREAD_S

    def click(self, selector, value):
        """What a click took: milliseconds to the picture and to the last answer, or None without its element.

        On a page whose values follow the rig, one of these may be the first change after the click.
        """
        one = self.page.locator(selector).first
        if not one.count() or not one.is_visible() or not one.is_enabled():
            return None
        self.page.evaluate(f"{WATCH}; globalThis.palpateEnd = palpateClick()")
        if value is None:
            one.click()
        elif isinstance(value, tuple):
            box = one.bounding_box()
            one.click(position={"x": value[0] * box["width"], "y": value[1] * box["height"]})
        else:
            options = one.locator("option")
            if isinstance(value, int) and options.count() <= value:
                return None
            one.select_option(**({"index": value} if isinstance(value, int) else {"value": value}))
        self.page.wait_for_timeout(ANSWER_MS)
        return self.page.evaluate("palpateEnd()")

    def close(self):
        self.browser.close()


def clicked(costs, name, words, what):
    if not what:
        return
    if what["painted"] is not None:
        costs.clicks_ms[f"{name}: {words}"] = what["painted"]
    slow = f" ({what['slowest']:.0f} ms: {what['name'].split('/api/v1')[-1]})" if what["slowest"] > 500 else ""
    picture = "no change" if what["painted"] is None else f"picture after {what['painted']:.0f} ms"
    print(f"  {words}: {picture}, {what['asked']} answers, the last after {what['last']:.0f} ms{slow}", flush=True)


def live_frames(costs, name, watched):
    """Of LIVE_S: what the wire carried, which frames of the board are missing in it, and what the page drew."""
    before = watched.page.evaluate(COUNTS)
    if before["arrived"] < 0:
        print("  live: no model serves", flush=True)
        return
    watched.sequences.clear()
    missed = watched.page.evaluate(MISSED)
    watched.page.wait_for_timeout(1e3 * LIVE_S)
    heard, after = list(watched.sequences), watched.page.evaluate(COUNTS)
    missed = watched.page.evaluate(MISSED) - missed
    skipped = sum(next_ - one - 1 for one, next_ in zip(heard, heard[1:]) if next_ and one)
    arrived, drawn = (after[key] - before[key] for key in ("arrived", "drawn"))
    costs.live[name] = {"per_s": len(heard) / LIVE_S, "skipped": skipped, "undrawn": arrived - drawn}
    print(f"  live: the wire carried {len(heard) / LIVE_S:.1f} messages per second, {skipped} frames of the board are "
          f"missing in them, the service did not receive {missed}; of {arrived:.0f} that arrived {arrived - drawn:.0f} were not drawn", flush=True)


def one_page(playwright, costs, url, name, called=None):
    """Opens a page and measures it; it is `called` so in the table."""
    kind, called = name.partition("?")[0], called or name
    watched = Watched(playwright, url, "/" + name.removeprefix("night"), frames=kind == "live")
    costs.paint_ms[called], busy_s = watched.page.evaluate(PAINT), watched.main_thread_s()
    costs.memory[called] = watched.memory()
    print(f"{called}: first paint {costs.paint_ms[called]:.0f} ms, {costs.memory[called]}, "
          f"main thread {busy_s:.1f} s a minute, {watched.page.evaluate(NODES)} elements", flush=True)
    if kind == "live":
        live_frames(costs, called, watched)
    for words, selector, value in CLICKS.get(kind, []):
        try:
            clicked(costs, called, words, watched.click(selector, value))
        except Error as error:
            print(f"  {words}: {str(error).splitlines()[0]}", flush=True)
    costs.memory[f"{called}, after the clicks"] = watched.memory()
    print(f"  after the clicks: {costs.memory[f'{called}, after the clicks']}", flush=True)
    watched.close()


def links(playwright, costs, url, names):
    """The link to each page, from the page before it."""
    watched = Watched(playwright, url, "/settings")
    print("links:", flush=True)
    took = []
    for name in names:
        what = watched.click(f"#links a[data-page={name}]", None)
        clicked(costs, "link", name, what)
        took.append(what["painted"] or 0)
    costs.memory["all pages, one after the other"] = watched.memory()
    print(f"  median {statistics.median(took):.0f} ms, longest {max(took):.0f} ms; after all of them: "
          f"{costs.memory['all pages, one after the other']}", flush=True)
    watched.close()


def followed(playwright, costs, url, minutes):
    """The night, watched."""
    watched = Watched(playwright, url, "/")
    for minute in range(minutes + 1):
        print(f"night after {minute} min: {watched.memory(collect=False)} before a collection", flush=True)
        if minute < minutes:
            watched.page.wait_for_timeout(60_000)
    costs.memory[f"night, after {minutes} min"] = watched.memory()
    print(f"  {costs.memory[f'night, after {minutes} min']} after it", flush=True)
    watched.close()


def lost(playwright, costs, url):
    """From the newest status to the words that it is old, on a network that has become silent."""
    wire = Wire(url)
    watched = Watched(playwright, wire.url, "/")
    watched.page.evaluate(views.LOST)
    wire.silence()
    costs.lost_ms = watched.page.evaluate("palpateLost")
    print(f"lost connection: shown {costs.lost_ms:.0f} ms after the newest status", flush=True)
    watched.close()
    wire.close()


# --- Everything by one command ------------------------------------------------------------------------

WEIGHTS = [{"x_mm": x, "y_mm": y, "force_n": 9.81} for x, y in ((150.0, 160.0), (390.0, 200.0), (270.0, 420.0))]


def a_week(playwright, costs, args, folder):
    """The pages on a filled folder, then while the paper's campaign is under way."""
    example = args.fill or pathlib.Path(args.target).resolve().parent / "examples/fill_database"
    if not example.exists():
        raise SystemExit(f"{example}: missing; build it with cargo build --example fill_database, or name it by --fill")
    week.fill(example, folder, args.trials)
    with Bench(args.target, folder, speed=1.0) as bench:
        bench.home()
        bench.api("/serving", {"what": bench.net()})
        bench.hands(cmd="place", weights=WEIGHTS)
        of_service(playwright, costs, bench.url, args.pages, ITEMS)
        bench.hands(cmd="clear")
        bench.begin(bench.carried("real-hex"))
        for name in ("night", "live"):
            one_page(playwright, costs, bench.url, name, f"{name}, a run under way")
        followed(playwright, costs, bench.url, args.minutes)


def of_service(playwright, costs, url, wanted, items=()):
    """The pages of a service, and its links."""
    watched = Watched(playwright, url, "/settings")
    names = [view.name for view in views.pages(watched.page)]
    watched.close()
    for name in wanted or [*names, *items]:
        one_page(playwright, costs, url, name)
    if not wanted:
        links(playwright, costs, url, names)
        lost(playwright, costs, url)


def rows(costs):
    """Each figure: what, value, limit, whether it is met."""
    if costs.paint_ms:
        page, ms = max(costs.paint_ms.items(), key=lambda item: item[1])
        yield (f"first paint, cold cache (longest: {page})", f"{ms:.0f} ms", f"{PAINT_LIMIT_MS} ms",
               0 <= min(costs.paint_ms.values()) and ms <= PAINT_LIMIT_MS)
        page, size = max(costs.memory.items(), key=lambda item: item[1].pss)
        yield (f"memory of the renderer, PSS (largest: {page}; RSS {size.rss:.0f} MB, JS heap {size.scripts:.0f} MB)",
               f"{size.pss:.0f} MB", f"{MEMORY_LIMIT_MB} MB", size.pss <= MEMORY_LIMIT_MB)
    if costs.clicks_ms:
        click, ms = max(costs.clicks_ms.items(), key=lambda item: item[1])
        slow = sum(ms > CLICK_LIMIT_MS for ms in costs.clicks_ms.values())
        yield (f"click to picture (longest of {len(costs.clicks_ms)}: {click}; {slow} over)", f"{ms:.0f} ms",
               f"{CLICK_LIMIT_MS} ms", not slow)
    for page, live in costs.live.items():
        yield (f"{page}: messages per second", f"{live['per_s']:.1f}", f"at least {FRAMES_LIMIT_PER_S}",
               live["per_s"] >= FRAMES_LIMIT_PER_S)
        # The last one that arrived may be drawn after it was counted.
        yield (f"{page}: frames skipped, not drawn", f"{live['skipped']}, {live['undrawn']:.0f}", "0, 1",
               not live["skipped"] and live["undrawn"] <= 1)
    if costs.lost_ms is not None:
        yield ("lost connection, until it is shown", f"{costs.lost_ms:.0f} ms", f"{LOST_LIMIT_MS} ms",
               costs.lost_ms <= LOST_LIMIT_MS)
    if costs.gaps:
        words, is_met = costs.gaps
        yield ("last frame to next motion, p99, without and with 20 dashboards", words,
               f"{latency.GAP_LIMIT_MS:.0f} ms more, {latency.GAPS_LEAST} gaps each", is_met)


def table(costs):
    print("\n| figure | value | limit | |\n|---|---|---|---|")
    for figure, value, limit, is_met in rows(costs):
        print(f"| {figure} | {value} | {limit} | {'ok' if is_met else 'OVER'} |", flush=True)


def main():
    """Prints all figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", metavar="PALPATE or URL")
    parser.add_argument("pages", nargs="*")
    parser.add_argument("--data", type=pathlib.Path, help="folder to fill, or that was filled before")
    parser.add_argument("--fill", type=pathlib.Path, help="the example fill_database")
    parser.add_argument("--trials", type=int, default=week.TRIALS)
    parser.add_argument("--minutes", type=int, default=5, help="for which the night is watched while a run is active")
    parser.add_argument("--seconds", type=int, default=480, help="for which gaps are measured; 0: not at all")
    args = parser.parse_intermixed_args()
    costs = Costs()
    with sync_playwright() as playwright, tempfile.TemporaryDirectory(prefix="palpate-figures-") as folder:
        if args.target.startswith("http"):
            of_service(playwright, costs, args.target.rstrip("/"), args.pages)
        else:
            a_week(playwright, costs, args, args.data or pathlib.Path(folder) / "week")
            if args.seconds and not args.pages:
                costs.gaps = latency.with_dashboards(args.target, pathlib.Path(folder) / "gaps", args.seconds)
    table(costs)


main()
