"""Scenario of roles: a viewer sees no button that would be refused, on any page."""

from playwright.sync_api import Error, expect

import views
from person import URL, a_viewer, api, seen_as

MORE_THAN_VIEWER = "[data-role=operator]:visible, [data-role=admin]:visible"
ANSWER_MS, ANSWER_MOST_MS, PRESS_MS, CONFIRM_MS = 150, 500, 3000, 15_000
# In the page: the name of the first button that is not among those and can be pressed, kept as `nextButton`. A name is
# the text under the heading of its part. Forget makes an admin of this machine of the viewer.
NEXT = """done => {
  for (const one of document.querySelectorAll('main button')) {
    const part = one.closest('section, form, fieldset, details')?.querySelector('h1, h2, h3, legend, summary')
    const text = one.getAttribute('aria-label') || one.innerText
    const name = `${part?.innerText ?? ''} / ${text}`.replace(/\\d+/g, 'N')
    if (done.includes(name) || text.startsWith('Forget') || !one.checkVisibility({ visibilityProperty: true })) continue
    if (one.matches(':disabled') || one.closest('[aria-disabled=true]')) continue
    globalThis.nextButton = one
    return name
  }
  return null
}"""


def viewer(page, browser):
    """Presses every button that a viewer sees, once on the views of one page, and confirms what is asked: no answer is
    401 or 403."""
    page.goto(URL)
    looked_at = [view for view in views.pages(page) + views.opened(api) if not view.is_docs]
    # The pages have such controls: an admin sees them.
    page.goto(f"{URL}/queue")
    seen_as(page, "admin")
    expect(page.locator(MORE_THAN_VIEWER).first).to_be_visible()
    other, refused, done = a_viewer(browser), [], {}
    waiting = views.unanswered(other)

    def note(answer):
        if answer.status in (401, 403):
            refused.append(f"{other.url}: {answer.request.method} {answer.url}: {answer.status}")

    other.on("response", note)
    # The night is the last one: there a viewer may end the run.
    counts = {}
    for view in sorted(looked_at, key=lambda view: view.path == "/"):
        of_page = done.setdefault(view.path.split("?")[0], [])
        counts[view.path] = presses(other, waiting, view.path, of_page)
    print(counts)
    assert not refused, "\n".join(refused)
    assert counts["/"] >= 2, "a viewer may pause and end a run"
    expect(other.locator("#stop")).to_be_enabled()


def presses(page, waiting, path, done):
    """Presses each button of a page that is not `done` by its name; returns how many it pressed, and adds their names."""
    here, before, missed = settled(page, waiting, path), len(done), []
    shown = page.locator(MORE_THAN_VIEWER)
    assert not shown.count(), f"{path}: {shown.all_inner_texts()}"
    while name := page.evaluate(NEXT, done + missed):
        try:
            page.evaluate_handle("nextButton").as_element().click(timeout=PRESS_MS, no_wait_after=True)
        except Error:
            missed.append(name)  # It is gone or covered: a person cannot press it either.
            continue
        done.append(name)
        answered(page, waiting)
        answer_dialogs(page, waiting)
        if page.url != here:
            here = settled(page, waiting, path)
    return len(done) - before


def settled(page, waiting, path):
    """Opens a page and what is folded on it; returns the address that the page has then."""
    page.goto(URL + path)
    seen_as(page, "viewer")
    page.evaluate("document.querySelectorAll('main details:not(.menu)').forEach(one => { one.open = true })")
    views.quiet(page, waiting)
    return page.url


def answered(page, waiting):
    """Waits until what was pressed is answered; a recording is not before its end."""
    views.quiet(page, waiting, ANSWER_MS, ANSWER_MOST_MS)


def answer_dialogs(page, waiting):
    """Confirms what is asked; a dialog that asks nothing is closed. One may close by itself: what it asks about has ended."""
    for _ in range(3):
        dialog = page.locator("dialog[open]")
        if not dialog.count():
            return
        confirm = dialog.locator("button.main")
        try:
            confirm.first.click(timeout=CONFIRM_MS) if confirm.count() else page.keyboard.press("Escape")
        except Error:
            if dialog.count():
                raise
        answered(page, waiting)
