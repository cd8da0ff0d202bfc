"""What the pages of the dashboard cost a browser: python3 tests/figures/pages.py URL [--minutes M] [PAGE..]

    palpate serve --data /tmp/screens --bind 127.0.0.1:8474              # with data to show, and a rig
    python3 tests/figures/pages.py http://127.0.0.1:8474

A PAGE may have parameters: "live?method=paper". Opens each page in a new browser with a cold cache and prints: time to the first paint; memory of the whole
renderer process (its share of the shared pages included) and of its scripts; main thread time in a minute;
for each click the time to the first picture that it changed, and to the last answer that it asked for. The
clicks are those of CLICKS, and for each page the link that leads to it from the night.

With --minutes, the night is watched for M minutes and its memory printed each minute. On the page `live`
the messages received and the pictures drawn are counted for 20 s. A browser without a GPU draws: a
machine with one needs less. Needs Chromium (PALPATE_CHROMIUM) and playwright.
"""

import argparse
import os
import pathlib
import shutil
import statistics

from playwright.sync_api import Error, sync_playwright

# What a person clicks on each page: name, selector, and the value of a choice. A click whose element is
# absent is not shown: the data decide.
CLICKS = {
    "night": [("colour by force", "select[aria-label='What the colours show']", "force"),
              ("all events", "select[aria-label='Which events']", "all"),
              ("predicted end", "select[aria-label='Second chart']", "end"),
              ("a place of the skin", "canvas.skin", None)],
    "plan": [("plan of the first choice", "main select", 1)],
    "runs": [("filter", "#state", 1), ("all", "#state", 0), ("open a run", "main tbody a", None),
             ("colour by FVU", "#colouring", "fvu"), ("all runs", "section.back a", None)],
    "trials": [("more rows", "button:text-is('More')", None), ("open a trial", "main tbody a", None),
               ("previous trial", "button:text-is('← Previous')", None), ("next trial", "button:text-is('Next →')", None),
               ("close it", "button:text-is('Close')", None)],
    "data": [("open a dataset", "main tbody a", None)],
    "model": [("a contact on the skin", "canvas.skin", None)],
    "nets": [("open a net", "main tbody a", None)],
    "live": [("scale of the colours", "select[aria-label='Force at the end of the colours']", "20")],
    "wear": [("first choice", "main select", 1)],
}
# In the page: from an input to the first painted change of the document, and to the last answer of the service.
WATCH = """
globalThis.palpateClick = () => {
  const all = { subtree: true, childList: true, attributes: true, characterData: true }
  let begun = 0, painted = 0, seen = null
  const paint = () => { if (!painted) requestAnimationFrame(() => setTimeout(() => { painted ||= performance.now() })) }
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
PAGES = "import('/web/pages.js').then(pages => pages.PAGES.map(page => page.name))"
SETTLE_MS, ANSWER_MS, LIVE_S, MAIN_THREAD_S = 4000, 2500, 20, 10


def launched(playwright):
    return playwright.chromium.launch(
        executable_path=os.environ.get("PALPATE_CHROMIUM") or shutil.which("chromium"),
        args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-features=SpareRendererForSitePerProcess"])


class Watched:
    """A page in its own browser, with what it costs."""

    def __init__(self, playwright, url, path, frames=False):
        self.browser = launched(playwright)
        self.page = self.browser.new_page(viewport={"width": 1400, "height": 900})
        self.wire = self.page.context.new_cdp_session(self.page)
        self.wire.send("Performance.enable")
        self.received = 0
        if frames:
            self.wire.send("Network.enable")
            self.wire.on("Network.webSocketCreated", self.opened)
            self.wire.on("Network.webSocketFrameReceived", self.heard)
        self.live = None
        self.page.goto(url + path, wait_until="domcontentloaded")
        self.page.wait_for_timeout(SETTLE_MS)

    def opened(self, event):
        if "/api/v1/live" in event["url"]:
            self.live = event["requestId"]

    def heard(self, event):
        self.received += event["requestId"] == self.live

    def metrics(self):
        return {one["name"]: one["value"] for one in self.wire.send("Performance.getMetrics")["metrics"]}

    def memory_mb(self, collect=True):
        """Renderer and scripts, MB. A collection first: what is garbage is no need."""
        if collect:
            self.wire.send("HeapProfiler.collectGarbage")
        processes = self.browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        shares = [0.0]
        for process in processes:
            if process["type"] != "renderer":
                continue
            rollup = pathlib.Path(f"/proc/{process['id']}/smaps_rollup").read_text()
            shares.append(sum(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:")) / 1024)
        return max(shares), self.metrics()["JSHeapUsedSize"] / 1e6

    def main_thread_s(self):
        """Seconds of its main thread in a minute."""
        before = self.metrics()["TaskDuration"]
        self.page.wait_for_timeout(1e3 * MAIN_THREAD_S)
        return (self.metrics()["TaskDuration"] - before) * 60 / MAIN_THREAD_S

    def click(self, selector, value):
        """What a click took: milliseconds to the picture and to the last answer, or None without its element."""
        one = self.page.locator(selector).first
        if not one.count() or not one.is_visible() or not one.is_enabled():
            return None
        self.page.evaluate(f"{WATCH}; globalThis.palpateEnd = palpateClick()")
        if value is None:
            one.click()
        else:
            options = one.locator("option")
            if isinstance(value, int) and options.count() <= value:
                return None
            one.select_option(**({"index": value} if isinstance(value, int) else {"value": value}))
        self.page.wait_for_timeout(ANSWER_MS)
        return self.page.evaluate("palpateEnd()")

    def close(self):
        self.browser.close()


def clicked(name, what):
    if what:
        slow = f" ({what['slowest']:.0f} ms: {what['name'].split('/api/v1')[-1]})" if what["slowest"] > 500 else ""
        picture = "no change" if what["painted"] is None else f"picture after {what['painted']:.0f} ms"
        print(f"  {name}: {picture}, {what['asked']} answers, the last after {what['last']:.0f} ms{slow}", flush=True)


def live_frames(watched):
    """Of LIVE_S: what the wire carried, and what the page received and drew by its own counts."""
    counts = "Object.fromEntries(['arrived', 'drawn'].map(key => [key, Number(document.querySelector('[data-drawn]')?.dataset[key])]))"
    wire, before = watched.received, watched.page.evaluate(counts)
    watched.page.wait_for_timeout(1e3 * LIVE_S)
    after = watched.page.evaluate(counts)
    arrived, pictures = (after[key] - before[key] for key in ("arrived", "drawn"))
    print(f"  live: the wire carried {(watched.received - wire) / LIVE_S:.1f} messages per second, the page drew "
          f"{pictures / LIVE_S:.1f}; of {arrived:.0f} that arrived {arrived - pictures:.0f} were not drawn", flush=True)


def one_page(playwright, url, name):
    kind = name.partition("?")[0]
    watched = Watched(playwright, url, "/" + name.removeprefix("night"), frames=kind == "live")
    paint, busy = watched.page.evaluate(PAINT), watched.main_thread_s()
    whole, scripts = watched.memory_mb()
    print(f"{name}: first paint {paint:.0f} ms, renderer {whole:.0f} MB, scripts {scripts:.1f} MB, "
          f"main thread {busy:.1f} s a minute", flush=True)
    if kind == "live":
        live_frames(watched)
    for words, selector, value in CLICKS.get(kind, []):
        try:
            clicked(words, watched.click(selector, value))
        except Error as error:
            print(f"  {words}: {str(error).splitlines()[0]}", flush=True)
    whole, scripts = watched.memory_mb()
    print(f"  after the clicks: renderer {whole:.0f} MB, scripts {scripts:.1f} MB", flush=True)
    watched.close()


def links(playwright, url, names):
    """The link to each page, from the page before it."""
    watched = Watched(playwright, url, "/settings")
    print("links:", flush=True)
    took = []
    for name in names:
        what = watched.click(f"#links a[data-page={name}]", None)
        clicked(name, what)
        took.append(what["painted"] or 0)
    whole, scripts = watched.memory_mb()
    print(f"  median {statistics.median(took):.0f} ms, longest {max(took):.0f} ms; after all of them: "
          f"renderer {whole:.0f} MB, scripts {scripts:.1f} MB", flush=True)
    watched.close()


def followed(playwright, url, minutes):
    watched = Watched(playwright, url, "/")
    for minute in range(minutes + 1):
        whole, scripts = watched.memory_mb(collect=False)
        print(f"night after {minute} min: renderer {whole:.0f} MB, scripts {scripts:.1f} MB before a collection", flush=True)
        if minute < minutes:
            watched.page.wait_for_timeout(60_000)
    print("  {:.0f} MB and {:.1f} MB after it".format(*watched.memory_mb()), flush=True)
    watched.close()


def main():
    """Prints all figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("pages", nargs="*")
    parser.add_argument("--minutes", type=int, default=0)
    args = parser.parse_intermixed_args()
    url = args.url.rstrip("/")
    with sync_playwright() as playwright:
        watched = Watched(playwright, url, "/settings")
        names = watched.page.evaluate(PAGES)
        watched.close()
        for name in args.pages or names:
            one_page(playwright, url, name)
        if not args.pages:
            links(playwright, url, names)
        if args.minutes:
            followed(playwright, url, args.minutes)


main()
