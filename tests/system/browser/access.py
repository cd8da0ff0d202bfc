"""Scenario of roles: a viewer sees no button that would be refused, on any page."""

import re

from playwright.sync_api import Error, expect

import views
from person import URL, a_viewer, api, seen_as

# It makes an admin of this machine of the viewer.
NOT_PRESSED = re.compile("^Forget")
MORE_THAN_VIEWER = "[data-role=operator]:visible, [data-role=admin]:visible"
SETTLE_MS, ANSWER_MS, PRESS_MS = 1500, 250, 3000


def viewer(page, browser):
    """Presses every button that a viewer sees, and confirms what is asked: no answer is 401 or 403."""
    page.goto(URL)
    looked_at = [view for view in views.pages(page) + views.opened(api) if not view.is_docs]
    # The pages have such controls: an admin sees them.
    page.goto(f"{URL}/queue")
    seen_as(page, "admin")
    expect(page.locator(MORE_THAN_VIEWER).first).to_be_visible()
    other, refused = a_viewer(browser), []

    def note(answer):
        if answer.status in (401, 403):
            refused.append(f"{other.url}: {answer.request.method} {answer.url}: {answer.status}")

    other.on("response", note)
    # The night is the last one: there a viewer may end the run.
    counts = {view.path: presses(other, view.path) for view in sorted(looked_at, key=lambda view: view.path == "/")}
    print(counts)
    assert not refused, "\n".join(refused)
    assert counts["/"] >= 2, "a viewer may pause and end a run"
    expect(other.locator("#stop")).to_be_enabled()


def presses(page, path):
    """Presses each button of a page, one of those that differ in numbers alone; returns how many it pressed."""
    here = settled(page, path)
    shown = page.locator(MORE_THAN_VIEWER)
    assert not shown.count(), f"{path}: {shown.all_inner_texts()}"
    done = set()
    while one := unpressed(page, done):
        try:
            one.click(timeout=PRESS_MS, no_wait_after=True)
        except Error:
            continue  # It is gone or covered: a person cannot press it either.
        page.wait_for_timeout(ANSWER_MS)
        answer_dialogs(page)
        if page.url != here:
            here = settled(page, path)
    return len(done)


def settled(page, path):
    """Opens a page and what is folded on it; returns the address that the page has then."""
    page.goto(URL + path)
    seen_as(page, "viewer")
    page.evaluate("document.querySelectorAll('main details:not(.menu)').forEach(one => { one.open = true })")
    page.wait_for_timeout(SETTLE_MS)
    return page.url


def unpressed(page, done):
    """The first button that was not pressed yet, which is noted in `done`; None without one."""
    for one in page.query_selector_all("main button"):
        try:
            words = re.sub(r"\d+", "N", one.get_attribute("aria-label") or one.inner_text())
            if words not in done and not NOT_PRESSED.match(words) and one.is_visible() and one.is_enabled():
                done.add(words)
                return one
        except Error:
            continue  # The page has replaced it.
    return None


def answer_dialogs(page):
    """Confirms what is asked; a dialog that asks nothing is closed."""
    for _ in range(3):
        dialog = page.locator("dialog[open]")
        if not dialog.count():
            return
        confirm = dialog.locator("button.main")
        confirm.first.click() if confirm.count() else page.keyboard.press("Escape")
        page.wait_for_timeout(ANSWER_MS)
