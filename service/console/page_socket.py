"""One open page: the newest frame as soon as it has drawn the last one, the state, and the time for its clock."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import TYPE_CHECKING, Any, Final

from starlette.websockets import WebSocketDisconnect

from service.console.access import Bucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.websockets import WebSocket

    from drivers.grabber import Clock
    from service.console.board import Board

__all__ = ["MESSAGES_HZ", "SocketPage"]

MESSAGES_HZ: Final = 60.0
"""What a page may send: a receipt for each of thirty frames a second, and asking the time."""
MESSAGES_BURST: Final = 120.0
UNSEEN: Final = 1
"""Frames on their way to a page: while it draws one, another would only wait for it and grow old."""
RECEIPT_TIMEOUT_S: Final = 5.0
LONGEST_MESSAGE: Final = 200
TOO_BUSY, BAD_MESSAGE, RESTARTING = 1008, 1007, 1012


class SocketPage:
    """Serves one page until it goes or misbehaves.

    Parameters
    ----------
    socket
        Accepted.
    hello, state
        What it is told first, and the state, coded, whenever `changed` says so.
    """

    def __init__(
        self, socket: WebSocket, board: Board, clock: Clock, hello: dict[str, Any], state: Callable[[], str]
    ) -> None:
        self._socket, self._board, self._clock = socket, board, clock
        self._hello, self._state = hello, state
        self._woken = asyncio.Event()
        self._told_state = ""
        self._pongs: list[float] = []
        self._sent = self._seen = self._numbers = 0
        self._sent_ms = 0.0

    async def serve(self) -> None:
        """Run until the page goes."""
        self._board.join(self._woken)
        receiving = asyncio.create_task(self._receive())
        sending = asyncio.create_task(self._send())
        try:
            done, _ = await asyncio.wait((receiving, sending), return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
                    await task
        finally:
            self._board.leave(self._woken)
            for task in (receiving, sending):
                task.cancel()
            await asyncio.gather(receiving, sending, return_exceptions=True)

    # -- from the page -----------------------------------------------------------------------------------------------

    async def _receive(self) -> None:
        bucket = Bucket(MESSAGES_HZ, MESSAGES_BURST, self._clock)
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if not bucket.take():
                await self._socket.close(TOO_BUSY, "too many messages")
                return
            if not self._take(message.get("text")):
                await self._socket.close(BAD_MESSAGE, "not a message that this understands")
                return

    def _take(self, text: str | None) -> bool:
        """Take a receipt or a ping; False where it is neither."""
        if text is None or len(text) > LONGEST_MESSAGE:
            return False
        try:
            given = json.loads(text)
        except (ValueError, RecursionError):
            return False
        match given:
            case {"seen": int(number)} if self._seen <= number <= self._numbers:
                self._seen = number
            case {"ping": int() | float() as at}:
                self._pongs.append(at)
            case _:
                return False
        self._woken.set()
        return True

    # -- to the page -------------------------------------------------------------------------------------------------

    async def _send(self) -> None:
        await self._socket.send_text(json.dumps(self._hello))
        while True:
            await self._send_texts()
            await self._send_frame()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._woken.wait(), RECEIPT_TIMEOUT_S)
            self._woken.clear()

    async def _send_texts(self) -> None:
        pongs, self._pongs = self._pongs, []
        for at in pongs:
            await self._socket.send_text(json.dumps({"type": "pong", "ping": at, "now_ms": self._now_ms()}))
        state = self._state()
        if state is not self._told_state:
            self._told_state = state
            await self._socket.send_text(state)

    async def _send_frame(self) -> None:
        posted = self._board.newest
        if posted is None or posted.number == self._sent:
            return
        if self._numbers - self._seen >= UNSEEN and self._now_ms() - self._sent_ms < 1e3 * RECEIPT_TIMEOUT_S:
            return
        self._sent, self._sent_ms = posted.number, self._now_ms()
        self._numbers += 1
        await self._socket.send_bytes(posted.message)

    def _now_ms(self) -> float:
        return self._clock.monotonic_ns() / 1e6
