"""Scenario of bulk work: the orders on the page Model, as a service with a queue would state them."""

from playwright.sync_api import expect

import views
from person import URL, a_viewer, in_dialog, said, seen_as

MACHINE = {"at_once": 2, "memory_mib": 16384, "gpu": True}
OPEN, COMPLETE, ELSEWHERE = "ab" * 32, "cd" * 32, "ef" * 32


def order(of, folder, done, **more):
    """An order of 200 chunks."""
    usual = {"order": of, "folder": folder, "chunks": 200, "done": done, "waiting": 0, "running": 0, "again": 0, "again_error": None,
             "failed": 0, "missing": 0, "per_minute": None, "to_go_s": None, "errors": []}
    return usual | more


def bulk(page, browser):
    """Cancels an order after a question, gathers another and submits a third; a viewer sees the progress and no button."""
    sent = []

    def answer(route):
        if route.request.method != "GET":
            sent.append((route.request.method, route.request.url.split("/workers/")[1]))
            route.fulfill(json={})
            return
        gather = {"folder": "complete", "into": "sim-random/complete", "state": "done", "error": None}
        route.fulfill(json={
            "configured": True, "workers": [{"worker": "desk/1/a", "heard_s": 3, "lost": False, "about": MACHINE}],
            "orders": [order(OPEN, "open", 120, waiting=78, running=2, per_minute=12.34, to_go_s=375), order(COMPLETE, "complete", 200),
                       order(ELSEWHERE, None, 200)],
            "unsubmitted": ["later"], "gather": gather if len(sent) > 1 else None})

    def shown(of):
        of.route("**/api/v1/workers**", answer)
        of.goto(f"{URL}/model")
        found = of.get_by_role("region", name="Workers: bulk work")
        expect(found).to_contain_text("120 of 200")
        return found

    views.named(page)
    panel = shown(page)
    expect(panel.get_by_role("row", name="desk/1/a")).to_contain_text("yes")
    expect(panel).to_contain_text("12.3")
    bar = panel.get_by_role("progressbar", name="Chunks done of open")
    assert abs(bar.evaluate("bar => bar.position") - 0.6) < 1e-6
    cancel = panel.get_by_role("button", name="Cancel open")
    cancel.click()
    in_dialog(page, "Cancel")
    expect(page.locator("dialog[open]")).to_have_count(0)
    assert not sent, "a cancellation that is not confirmed is not sent"
    cancel.click()
    in_dialog(page, "Cancel the order")
    said(page, "Cancel open: done.")
    panel.get_by_role("button", name="Gather complete").click()
    said(page, "Gathering of complete into sim-random/complete: done.")
    panel.get_by_role("button", name="Submit later").click()
    said(page, "Submit later: done.")
    assert sent == [("DELETE", f"orders/{OPEN}"), ("POST", "folders/complete/gather"), ("POST", "folders/later")], sent
    assert panel.get_by_role("button", name="Gather").count() == 1, "the results of an order from elsewhere have no folder"
    other = a_viewer(browser)
    panel = shown(other)
    seen_as(other, "viewer")
    expect(panel.locator("button:visible")).to_have_count(0)
