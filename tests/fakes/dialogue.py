"""A line on which one dialogue can take place and no other: what is not sent, sent besides, or not read, fails."""

from tests.fakes.clock import ManualClock


class ScriptedChannel:
    """Plays (sent, heard) pairs as a `ByteChannel`; time passes only as the script says.

    `heard` is a list of pieces: bytes that arrive together, a number of seconds without any, or an exception that
    sending (as its first piece) or receiving raises. `sent` None: the device talks of its own accord.
    """

    name = "scripted"

    def __init__(self, script=(), clock=None):
        self.clock = clock or ManualClock()
        self.script = [(sent, list(heard)) for sent, heard in script]
        self.pieces = []
        self.lines = 1
        self.dropped, self.aborted, self.closed = [], 0, 0
        self._speak()

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        if kind is None:
            assert not self.script, f"never sent: {self.script}"
            assert not self.pieces, f"never read: {self.pieces}"

    def _speak(self):
        while self.script and self.script[0][0] is None:
            self.pieces += self.script.pop(0)[1]

    def connect(self):
        return self.lines

    def send(self, data):
        assert not self.pieces, f"{self.pieces} was not read before {data!r} was sent"
        assert self.script, f"{data!r} was sent, and nothing more was expected"
        expected, heard = self.script.pop(0)
        assert data == expected, f"sent {data!r}, expected {expected!r}"
        if heard and isinstance(heard[0], Exception):
            self._speak()
            raise heard[0]
        self.pieces = heard
        self._speak()

    def receive(self, timeout_s):
        if self.pieces and isinstance(self.pieces[0], int | float):
            passed = min(timeout_s, self.pieces[0])
            self.clock.advance(passed)
            self.pieces[0] -= passed
            if self.pieces[0] > 1e-9:
                return b""
            self.pieces.pop(0)
            return self.receive(timeout_s - passed)
        if not self.pieces:
            self.clock.advance(timeout_s)
            return b""
        piece = self.pieces.pop(0)
        if isinstance(piece, Exception):
            raise piece
        return piece

    def drop(self, reason):
        self.dropped.append(reason)
        self.lines += 1

    def abort(self):
        self.aborted += 1

    def close(self):
        self.closed += 1
