"""Question and answer over a byte channel: whole messages, deadlines, and no answer taken for another question's."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from drivers.errors import DeviceTimeoutError

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.serial_channel import ByteChannel

    Splitter: TypeAlias = Callable[[bytes], tuple[list[bytes], bytes]]

__all__ = ["Dialogue", "DialogueCounters", "Reply", "split_lines"]

FRESH_QUIET_S = 0.1
"""A line just opened is listened to for so long: a device that talks of its own accord is in mid-message."""
MOST_ROUNDS, MOST_CHUNKS = 3, 16
SILENT_LIMIT = 10
"""Questions unanswered in a row after which the line is opened anew: a socket's other end may be gone unnoticed."""
LONGEST_LINE = 64


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer, with the monotonic times its question was sent and it was in hand."""

    message: bytes
    sent_ns: int
    received_ns: int


@dataclass(slots=True)
class DialogueCounters:
    """Questions asked = answered + unanswered + broken off by a lost line; messages that answered nothing."""

    asked: int = 0
    answered: int = 0
    unanswered: int = 0
    unexpected: int = 0


def split_lines(data: bytes) -> tuple[list[bytes], bytes]:
    """Cut lines ending in LF, CR LF or CR out of `data`; returns them without their ends, and what is left over.

    Empty ones are left out. What is left over is cut to its end where it is longer than any line can be.
    """
    *lines, rest = data.replace(b"\r", b"\n").split(b"\n")
    return [line for line in lines if line], rest[-LONGEST_LINE:]


class Dialogue:
    """Asks one device at a time one thing.

    A message that comes when none is awaited is thrown away; the beginning of one is kept, so that its end is never
    taken for a message. After a question without an answer, and on a line just opened, it first listens until the
    line is quiet: the late answer must not pass for that to the next question.

    Parameters
    ----------
    channel
        The line.
    split
        Cuts whole messages off what arrived: returns them and the rest. Bounds the rest.
    timeout_s
        Longest wait for an answer.
    """

    def __init__(self, channel: ByteChannel, split: Splitter, timeout_s: float) -> None:
        self.channel, self.counters = channel, DialogueCounters()
        self._split, self._timeout_s = split, timeout_s
        self._messages: deque[bytes] = deque()
        self._rest = self._heard = b""
        self._line = 0
        self._quiet_s = 0.0
        self._silent = 0

    def ask(self, question: bytes, is_answer: Callable[[bytes], bool]) -> Reply:
        """Send a question and wait for the first message that is an answer to it: four times `timeout_s` at most.

        Raises
        ------
        DeviceTimeoutError
            None came in time.
        DeviceError
            The line cannot be opened, or was lost.
        """
        self._make_ready()
        self.channel.send(question)
        self.counters.asked += 1
        reply = self.await_reply(is_answer)
        self.counters.answered += 1
        return reply

    def await_reply(self, is_answer: Callable[[bytes], bool]) -> Reply:
        """Wait for a further message, after `ask`; raises as that."""
        clock = self.channel.clock
        sent_ns = clock.monotonic_ns()
        deadline_ns = sent_ns + round(self._timeout_s * 1e9)
        while True:
            while self._messages:
                if is_answer(message := self._messages.popleft()):
                    self._silent = 0
                    return Reply(message, sent_ns, clock.monotonic_ns())
                self.counters.unexpected += 1
                self._heard = message
            left_ns = deadline_ns - clock.monotonic_ns()
            if left_ns <= 0:
                raise self._unanswered()
            self._take(self.channel.receive(left_ns / 1e9))

    def _take(self, data: bytes) -> None:
        messages, self._rest = self._split(self._rest + data)
        self._messages.extend(messages)

    def _make_ready(self) -> None:
        if self._line != (line := self.channel.connect()):
            self._line, self._quiet_s, self._rest = line, FRESH_QUIET_S, b""
        if self._quiet_s:
            self._listen_until_quiet(self._quiet_s)
            self._quiet_s = 0.0
        else:
            for _ in range(MOST_CHUNKS):
                if not (data := self.channel.receive(0)):
                    break
                self._take(data)
        self._messages.clear()
        self._heard = b""

    def _listen_until_quiet(self, quiet_s: float) -> None:
        """Hear the line out until it was silent for so long, or gives no peace for three times that."""
        clock = self.channel.clock
        deadline_ns = clock.monotonic_ns() + round(MOST_ROUNDS * quiet_s * 1e9)
        while clock.monotonic_ns() < deadline_ns:
            if not (data := self.channel.receive(quiet_s)):
                self._rest = b""
                return
            self._take(data)
            self._messages.clear()

    def _unanswered(self) -> DeviceTimeoutError:
        self.counters.unanswered += 1
        self._quiet_s = self._timeout_s
        self._silent += 1
        if self._silent >= SILENT_LIMIT:
            self._silent = 0
            self.channel.drop(f"{SILENT_LIMIT} questions in a row without an answer")
        heard = self._rest or self._heard
        but = f", but heard {heard!r}; are model, address and speed right?" if heard else "; is the device on?"
        return DeviceTimeoutError(self.channel.name, f"no answer within {self._timeout_s:g} s{but}")
