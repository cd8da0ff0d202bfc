"""Scenarios in headless Chromium: python3 scenarios.py NAME URL CONTROL

A scenario does what a person does, by the words that stand on the pages, and fails where the page does
not answer. CONTROL is the address of the virtual rig's control socket: the hands that place weights.
PALPATE_CHROMIUM is the browser, PALPATE_SCREENS the folder for a picture of the page that failed.
"""

import json
import os
import pathlib
import re
import shutil
import socket
import sys
import time
import urllib.request

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect, sync_playwright

NAME, URL, CONTROL = sys.argv[1:4]
# A machine with other work is slow; nothing here measures time.
LIMIT_MS = 60_000
RUN_MS = 240_000
PAGES = ["/", "/queue", "/plan", "/place", "/runs", "/trials", "/data", "/model", "/nets", "/live", "/rig",
         "/wear", "/settings"]
# Severities of axe that fail.
SERIOUS = ("serious", "critical")


def api(path, body=None):
    """The answer of the service, as JSON."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"{URL}/api/v1{path}", data, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        text = answer.read()
        return json.loads(text) if text else None


def until(what, test, seconds=120):
    """Waits for a fact that is not on the page."""
    ends = time.monotonic() + seconds
    while not (found := test()):
        assert time.monotonic() < ends, f"{what} does not come"
        time.sleep(0.2)
    return found


def hands(command):
    """Tells the virtual rig what hands do."""
    host, port = CONTROL.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=30) as wire:
        wire.sendall(json.dumps(command).encode() + b"\n")
        reply = json.loads(wire.makefile().readline())
    assert reply["ok"], reply


def button(page, words):
    return page.get_by_role("button", name=words, exact=isinstance(words, str)).first


def pressed(page, words):
    """Presses a button, the stop excepted by its own name."""
    one = button(page, words)
    expect(one).to_be_visible(timeout=LIMIT_MS)
    one.click()


def said(page, text, limit_ms=LIMIT_MS):
    """Waits until the page shows a text."""
    expect(page.get_by_text(text).first).to_be_visible(timeout=limit_ms)


def in_dialog(page, words):
    page.locator("dialog[open]").get_by_role("button", name=words, exact=True).click()


def named(page):
    """Gives the name when it is asked for."""
    dialog = page.locator("dialog[open]")
    expect(dialog.get_by_label("Name")).to_be_visible(timeout=LIMIT_MS)
    dialog.get_by_label("Name").fill("Ada")
    in_dialog(page, "Continue")


def state(page, words, limit_ms=LIMIT_MS):
    expect(page.locator("#bar-state")).to_contain_text(words, ignore_case=True, timeout=limit_ms)


def downloaded(page, press):
    with page.expect_download(timeout=LIMIT_MS) as coming:
        press()
    path = pathlib.Path(coming.value.path())
    return coming.value.suggested_filename, path.read_bytes()


def accessible(page, browser):
    """Axe finds nothing serious on any page, light and dark, and no page writes an error."""
    for scheme in ("light", "dark"):
        context = browser.new_context(color_scheme=scheme, viewport={"width": 1400, "height": 900})
        one = context.new_page()
        errors = watched(one)
        for path in PAGES:
            one.goto(URL + path)
            expect(one.locator("main h1")).to_be_visible(timeout=LIMIT_MS)
            one.wait_for_timeout(1200)
            found = Axe().run(one).response["violations"]
            serious = [(v["id"], [n["target"] for n in v["nodes"]][:3]) for v in found if v["impact"] in SERIOUS]
            assert not serious, f"{path}, {scheme}: {serious}"
            assert not errors, f"{path}, {scheme}: {errors}"
        context.close()


def watched(page):
    """The list of errors that a page writes; an answer that a page asked for in vain is none."""
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))

    def console(message):
        if message.type == "error" and "Failed to load resource" not in message.text:
            errors.append(message.text)

    page.on("console", console)
    return errors


def first_evening(page, browser):
    """From the empty folder by one button to a finished campaign, a trial, a lineage, a dataset."""
    page.goto(URL)
    pressed(page, "Run the quickstart")
    named(page)
    if page.locator("dialog[open]").count():
        in_dialog(page, "Start")
    state(page, "running")
    said(page, re.compile("264"))
    until("the end of the run", lambda: api("/runs")["items"][0].get("exit_status") == "success", 240)
    said(page, "Finished")
    # A trial.
    page.goto(f"{URL}/trials?run=1")
    page.locator("main tbody th a").first.click()
    said(page, re.compile("Twin", re.I))
    expect(page).to_have_url(re.compile("trial="))
    before = page.url

    def another():
        page.keyboard.press("k")
        page.wait_for_timeout(300)
        return page.url != before

    until("the trial before", another)
    # A dataset, its download and its lineage down to a frame.
    api("/datasets", {"name": "run-1"})
    page.goto(f"{URL}/data")
    page.locator("main tbody th a").first.click()
    said(page, re.compile("read_parquet"))
    name, content = downloaded(page, lambda: page.get_by_role("link", name="Parquet", exact=True).first.click())
    assert name.endswith(".parquet") and content[:4] == b"PAR1", name
    said(page, "What it was made from")
    page.locator("button.walk-box", has_text="Run 1").first.click()
    page.locator(".walk-list button").first.click()
    expect(page.get_by_role("link", name="Open this trial")).to_be_visible(timeout=LIMIT_MS)
    page.get_by_role("link", name="Open this trial").click()
    expect(page).to_have_url(re.compile("/trials[?]trial="), timeout=LIMIT_MS)
    accessible(page, browser)


SMALL = """name = 'small'
seed = 5
sensor = 'sensors/ert-28.toml'
[real_hex]
tips = [1]
configurations = 8
depths = 6
block = 8
reference_every = 8
"""


def operate(page, browser):
    """Checked, armed and started by the page; paused, resumed, stopped at once, homed and finished."""
    errors = watched(page)
    page.goto(f"{URL}/queue")
    said(page, re.compile("quickstart"))
    page.locator("input[type=file]").first.set_input_files(
        {"name": "small.toml", "mimeType": "text/plain", "buffer": SMALL.encode()})
    pressed(page, "Add to queue")
    named(page)
    run = until("the run in the queue", lambda: api("/queue")["items"])[0]
    page.goto(f"{URL}/plan?run={run['scan_id']}")
    said(page, re.compile("48"))
    pressed(page, "Arm and start")
    in_dialog(page, "Start")
    state(page, "running", RUN_MS)
    page.goto(URL)
    pressed(page, "Pause")
    state(page, "paused")
    pressed(page, "Resume")
    state(page, "running")
    # Answers that never end hold all connections that a browser opens to one service.
    page.evaluate("import('/web/lib/api.js').then(({ ask }) => { for (let n = 0; n < 8; n += 1)"
                  " ask('/api/v1/events?since=0', { accept: 'text/event-stream', wait: 0 }).catch(() => 0) })")
    page.wait_for_timeout(1000)
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.locator("body")).to_contain_text("Emergency stop latched", timeout=2000)
    said(page, re.compile("Every axis stopped after"))
    pressed(page, "Reset")
    until("the reset", lambda: api("/status")["rig"]["state"] != "tripped")
    pressed(page, "Home")
    until("homing", lambda: api("/status")["rig"]["state"] == "homed")
    pressed(page, "Resume")
    until("the end of the run", lambda: api(f"/runs/{run['uid']}").get("exit_status") == "success", 240)
    assert not errors, errors


def place(page, browser):
    """Three weights trials: one is placed wrongly first and named; the page leads through all."""
    api("/rig/actions", {"action": "connect", "who": "test"})
    page.goto(f"{URL}/place")
    sensor = (pathlib.Path(__file__).parents[3] / "experiments/sensors/ert-28.toml").read_text()
    text = ("name = 'weights'\nseed = 3\nsensor = 's'\n[real_random]\ncontacts = [2]\ntrials_each = 3\n"
            "weights_n = [9.81]\n[measure]\nframes_per_trial = 10\n")
    said(page, "No run waits for weights")
    api("/queue", {"file": "weights.toml", "definition": text, "sensor": sensor, "who": "test"})
    pressed(page, "Arm and start")
    named(page)
    in_dialog(page, "Start")
    for trial in range(3):
        wanted = until("the placement", lambda: (api("/status")["run"] or {}).get("wanted"))
        assert wanted["trial"] == trial, wanted
        hands({"cmd": "place", "weights": wanted["contacts"]})
        done = button(page, "Done")
        expect(done).to_be_enabled(timeout=LIMIT_MS)
        page.wait_for_timeout(1500)
        page.keyboard.press("Enter")

        def over():
            run = api("/status")["run"]
            return run is None or (run.get("wanted") or {}).get("trial") != trial

        until("the next placement", over)
    until("the end of the run", lambda: api("/runs")["items"][0].get("exit_status") == "success")


def touch(page, browser):
    """A trained net is promoted by the page, and what it sees is followed live."""
    errors = watched(page)
    page.goto(f"{URL}/nets")
    pressed(page, re.compile("^Promote"))
    in_dialog(page, "Promote")
    named(page)
    until("the promotion", lambda: any(one.get("what") for one in api("/serving")["serves"]))
    hands({"cmd": "place", "weights": [{"x_mm": 270.0, "y_mm": 280.0, "force_n": 9.81}]})
    page.goto(f"{URL}/live?method=fast")
    said(page, re.compile("per s|/s|frames"))
    page.wait_for_timeout(3000)
    assert not errors, errors


def main():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("PALPATE_CHROMIUM") if os.path.sep in os.environ.get("PALPATE_CHROMIUM", "")
            else shutil.which(os.environ.get("PALPATE_CHROMIUM", "chromium")),
            args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
        page = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
        page.set_default_timeout(LIMIT_MS)
        try:
            globals()[NAME](page, browser)
        except BaseException:
            folder = pathlib.Path(os.environ.get("PALPATE_SCREENS", "."))
            folder.mkdir(parents=True, exist_ok=True)
            page.screenshot(path=folder / f"{NAME}.png", full_page=True)
            print(f"{page.url}: the page as a picture is {folder / NAME}.png", file=sys.stderr)
            raise
        print(f"{NAME}: done")


main()
