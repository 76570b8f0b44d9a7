"""Who may talk to the page: requests to this machine by its own name, from the page itself, of limited size."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

Scope = Mapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
SAFE = ("GET", "HEAD", "OPTIONS")
# The page itself needs scripts in the page; nothing may come from or go to another machine.
POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self'; object-src 'none'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()), (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"), (b"cross-origin-resource-policy", b"same-origin"),
    (b"x-frame-options", b"DENY"),
)  # fmt: skip


class Guard:
    """An ASGI application before another one.

    A foreign Host header is refused (DNS rebinding: another name that leads to this machine), a foreign or missing
    Origin where something may change or a websocket opens (cross-site requests), and a body above the limit.

    Parameters
    ----------
    app : ASGI application
    port : int
    limit : int
        Bytes of a request's body.
    """

    def __init__(self, app: Any, port: int, limit: int):
        self.app, self.limit = app, limit
        self.hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}
        self.origins = {f"http://{host}" for host in self.hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        refused = self.refusal(scope)
        if refused is not None:
            await _refuse(scope, send, *refused)
        elif scope["type"] == "websocket":
            await self.app(scope, receive, send)
        else:
            await self._limited(scope, receive, send)

    def refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and reason where a request is refused."""
        given: dict[bytes, list[str]] = {}
        for name, value in scope["headers"]:
            given.setdefault(name.lower(), []).append(value.decode("latin-1"))
        hosts, origins = given.get(b"host", []), given.get(b"origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.hosts:
            return 403, "This page answers to 127.0.0.1 and localhost only."
        must = scope["type"] == "websocket" or scope["method"] not in SAFE
        if (must and not origins) or any(o.lower() not in self.origins for o in origins):
            return 403, "Requests from other pages are refused."
        sizes = given.get(b"content-length", [])
        if sizes and not (sizes[0].isdigit() and int(sizes[0]) <= self.limit):
            return 413, self.too_large
        return None

    @property
    def too_large(self) -> str:
        """What is said about an upload above the limit."""
        return f"The file is too large: at most {self.limit / 1e6:g} MB are taken."

    async def _limited(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the bytes of a body that does not say its length."""
        seen, begun = 0, False

        async def counted() -> Any:
            nonlocal seen
            message = await receive()
            seen += len(message.get("body", b""))
            return message if seen <= self.limit else {"type": "http.disconnect"}

        async def marked(message: Any) -> None:
            nonlocal begun
            if seen > self.limit and not begun:
                return  # whatever the application says of a request that it did not get
            if message["type"] == "http.response.start":
                begun = True
                message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
            await send(message)

        try:
            await self.app(scope, counted, marked)
        except Exception:
            if seen <= self.limit:
                raise
        if seen > self.limit and not begun:
            await _refuse(scope, send, 413, self.too_large)


async def _refuse(scope: Scope, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})  # before it is accepted: 403
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close"), *HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": reason.encode()})
