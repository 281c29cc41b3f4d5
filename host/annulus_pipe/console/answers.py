"""What an HTTP request is answered with: JSON, {"ok": true, ..} or {"ok": false, "error": one line}.

    async def progress(request: Request) -> Response:
        asked = await asked_for(request)                       # a mapping, or Refusal
        return accepted(done=program.tune.ask(asked["lamp"]))  # AnnulusError becomes a 409

Endpoints raise; web.py answers for them.
"""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from annulus_pipe import untrusted
from annulus_pipe.console.wire import plain
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

ASKED_MAX = 96 << 10  # bytes: a photograph of 48 KiB as text, and what is said of it


class Refusal(AnnulusError):
    """With the status of the answer."""

    def __init__(self, status: int, error: str) -> None:
        super().__init__(error)
        self.status = status


def accepted(status: int = 200, **fields: Any) -> "Response":
    return _answer({"ok": True, **fields}, status)


def refused(error: str, status: int = 409) -> "Response":
    return _answer({"ok": False, "error": untrusted.one_line(error)}, status)


async def asked_for(request: "Request") -> Mapping[str, Any]:
    """The JSON object that was sent."""
    try:
        content = untrusted.sayable(untrusted.parse_json(await request.body(), ASKED_MAX))
        return untrusted.mapping(content, "what is asked")
    except ValueError as error:
        raise Refusal(400, str(error)) from None


def _answer(body: Mapping[str, Any], status: int) -> "Response":
    from starlette.responses import Response

    text = json.dumps(plain(body), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Response(text.encode("utf-8", "replace"), status, {"Cache-Control": "no-store"}, "application/json")
