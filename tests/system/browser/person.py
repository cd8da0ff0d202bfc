"""What a person does and sees: the words on the pages, the rig's hands, and facts that the service states.

Of a scenario: `scenarios.py` is called with the address of the service and of the rig's control socket.
"""

import json
import pathlib
import socket
import sys
import time
import urllib.request

from playwright.sync_api import expect

import views

URL, CONTROL = sys.argv[2:4]
# A machine with other work is slow; nothing here measures time.
LIMIT_MS = views.LIMIT_MS
RUN_MS = 240_000


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
        time.sleep(0.05)
    return found


def hands(command):
    """Tells the virtual rig what hands do."""
    host, port = CONTROL.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=30) as wire:
        wire.sendall(json.dumps(command).encode() + b"\n")
        reply = json.loads(wire.makefile().readline())
    assert reply["ok"], reply


def asked(trial):
    """Waits until the run asks for a placement; returns its weights."""

    def there():
        run = api("/status")["run"] or {}
        wanted = run.get("wanted") or {}
        return run.get("paused_why") == "manual_trial" and wanted.get("trial") == trial and wanted

    return until(f"placement {trial}", there)["contacts"]


def button(page, words):
    return page.get_by_role("button", name=words, exact=isinstance(words, str)).first


def pressed(page, words):
    """Presses a button."""
    one = button(page, words)
    expect(one).to_be_visible(timeout=LIMIT_MS)
    one.click()


def said(page, text, limit_ms=LIMIT_MS):
    """Waits until the page shows a text."""
    expect(page.get_by_text(text).first).to_be_visible(timeout=limit_ms)


def in_dialog(page, words):
    page.locator("dialog[open]").get_by_role("button", name=words, exact=True).click()


def confirmed(page):
    """Confirms what a dialog asks."""
    page.locator("dialog[open] button.main").click()


def named(page):
    """Enters the name when it is asked for."""
    dialog = page.locator("dialog[open]")
    expect(dialog.get_by_label("Name")).to_be_visible(timeout=LIMIT_MS)
    dialog.get_by_label("Name").fill("Ada")
    confirmed(page)


def state(page, words, limit_ms=LIMIT_MS):
    expect(page.locator("#bar-state")).to_contain_text(words, ignore_case=True, timeout=limit_ms)


def downloaded(page, press):
    with page.expect_download(timeout=LIMIT_MS) as coming:
        press()
    path = pathlib.Path(coming.value.path())
    return coming.value.suggested_filename, path.read_bytes()


def tabbed(page, selector, most=200):
    """Reaches an element with the Tab key alone, and sees that it has the focus."""
    for _ in range(most):
        page.keyboard.press("Tab")
        if page.evaluate("selector => document.activeElement.matches(selector)", selector):
            outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
            assert outline != "none", f"{selector}: the focus is not visible"
            return
    raise AssertionError(f"{selector}: not reached by {most} Tab keys")


def a_viewer(browser):
    """A page of a person whose key only allows to look, to pause and to stop."""
    secret = api("/keys", {"name": "Vera", "role": "viewer"})["secret"]
    page = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
    page.set_default_timeout(LIMIT_MS)
    views.named(page)
    views.with_key(secret)(page)
    return page


def seen_as(page, role):
    """Waits until the page knows the role of its caller."""
    known = "import('/web/lib/live.js').then(({ live }) => live.caller?.role)"
    until(f"the role {role}", lambda: page.evaluate(known) == role)
