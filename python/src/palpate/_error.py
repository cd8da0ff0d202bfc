"""Why the service did not answer, in its own words.

Uses: the standard library. Never: a text that hides that of the service.
"""

import json
from typing import Any


class PalpateError(Exception):
    """A request that was refused, or that no service answered.

    ``status``: HTTP status; None if there was no answer.
    ``title``, ``detail``: what the service states (RFC 9457).
    ``errors``: each problem, with ``file``, ``key``, ``value`` and ``limit``.
    """

    def __init__(
        self,
        status: int | None,
        detail: str,
        *,
        title: str = "",
        errors: tuple[dict[str, Any], ...] = (),
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.errors = errors

    def __reduce__(self) -> tuple[Any, ...]:
        """Lets a worker process raise it in its parent."""
        return _again, (self.status, self.detail, self.title, self.errors)

    def __str__(self) -> str:
        return self.detail if self.status is None else f"{self.detail} (HTTP {self.status})"


def _again(
    status: int | None, detail: str, title: str, errors: tuple[dict[str, Any], ...]
) -> PalpateError:
    return PalpateError(status, detail, title=title, errors=errors)


def refused(status: int, reason: str, body: bytes) -> PalpateError:
    """The error of a response: a problem body, or whatever a proxy has sent instead.

    >>> refused(502, "Bad Gateway", b"<html>nginx</html>").detail
    'Bad Gateway: <html>nginx</html>'
    """
    try:
        problem = json.loads(body)
        detail = str(problem["detail"])
    except (ValueError, KeyError, TypeError):
        shown = " ".join(body[:200].decode(errors="replace").split())
        return PalpateError(status, f"{reason}: {shown}" if shown else reason, title=reason)
    errors = tuple(problem.get("errors") or ())
    return PalpateError(status, detail, title=str(problem.get("title", reason)), errors=errors)
