"""A guard while a policy is opened: whatever its type does then, nothing is fetched."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any

#: Where the guarded code wanted to connect to; None outside the guard.
_attempts: ContextVar[list[str] | None] = ContextVar("attempts", default=None)


class FetchError(RuntimeError):
    """Something wanted to connect to another machine; no OSError, which libraries would take for a reason to retry."""


@contextmanager
def offline() -> Iterator[list[str]]:
    """Refuse connections to other machines, in this thread, inside the block.

    Yields:
        The machines that something inside wanted to connect to, so far.
    """
    _install_hook()
    attempts: list[str] = []
    token = _attempts.set(attempts)
    try:
        yield attempts
    finally:
        _attempts.reset(token)


@cache
def _install_hook() -> None:
    # An audit hook cannot be taken away again; outside the guard it does nothing.
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    if event not in ("socket.connect", "socket.getaddrinfo"):
        return
    attempts = _attempts.get()
    address = arguments[0] if event == "socket.getaddrinfo" else arguments[1]
    if attempts is None or (event == "socket.connect" and not isinstance(address, tuple)):  # a socket of this machine
        return
    host = address[0] if isinstance(address, tuple) else address
    attempts.append(host.decode(errors="replace") if isinstance(host, bytes) else str(host))
    raise FetchError(f"{attempts[-1]} is not connected to while a policy is opened")
