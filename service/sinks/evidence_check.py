"""Whether the evidence of a session is as it was written, and says what its frames and results say."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from drivers.decoding import decode_picture
from drivers.errors import UnsupportedFormatError
from drivers.session_index import pixels_crc32
from service.sinks.evidence import HEADS, RECORDS, TORN, head_line, read_records, without_times
from service.sinks.session.about import file_sha256
from service.sinks.session.finding import Finding
from service.sinks.session.places import ABOUT, EVIDENCE, RESULTS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from drivers.session_index import Evidence, Row
    from service.sinks.evidence import EvidenceRecord

__all__ = ["EvidenceCheck", "record_key"]

Key: TypeAlias = tuple[int, int | None, int, int, str]


def record_key(record: EvidenceRecord) -> Key:
    """What tells a record's frame from all others of the session."""
    frame = record.values["frame"]
    return (
        frame["generation"], frame["sequence"], frame["timestamp_ns"], frame["received_ns"], frame["field"]
    )  # fmt: skip


def _row_key(row: Row) -> Key:
    return row.generation, row.sequence, row.timestamp_ns, row.received_ns, str(row.field)


class EvidenceCheck:
    """Checks the chain, the pictures, and that both agree with what was recorded beside them.

    The index is read by whoever calls: `frame` and `lines` take what it says, then `findings` tells.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._place = folder, folder / EVIDENCE
        self.witnessed: list[Evidence] = []
        """What the index says of the records."""
        self._rows: dict[Key, Row] = {}
        self._lines: dict[int, list[dict[str, Any]]] = {}
        self._wanted = self._keys()

    def _keys(self) -> set[Key]:
        """Frames that there is evidence of, as far as it can be read."""
        try:
            return {record_key(r) for _, r, _ in read_records(self._place, None) if r is not None}
        except (OSError, KeyError, TypeError):
            return set()

    def frame(self, row: Row) -> None:
        """Take a recorded frame."""
        if (key := _row_key(row)) in self._wanted:
            self._rows[key] = row

    def lines(self, number: int | None, text: bytes) -> None:
        """Take a frame's result lines, which are sound."""
        if number is not None and any(row.number == number for row in self._rows.values()):
            self._lines[number] = [without_times(json.loads(line)) for line in text.splitlines()]

    def findings(self, genesis: str | None, *, closed: bool) -> Iterator[Finding]:
        """Check all of it.

        Parameters
        ----------
        genesis
            What the chain begins with; None: the hash of the description, where the index does not have it any more.
        closed
            Whether the session was closed in order; else its last record may be unfinished.
        """
        if not self._place.is_dir():
            if self.witnessed:
                yield Finding(EVIDENCE, f"is gone, with {self.witnessed[-1].records} records")
            return
        hashes: list[str] = []
        pictures = {RECORDS, HEADS}
        try:
            for number, record, problem in read_records(self._place, genesis or file_sha256(self._folder / ABOUT)):
                hashes.append("" if record is None else record.sha256)
                if record is not None:
                    pictures.add(record.values["picture"])
                    yield from self._record(record)
                if problem is not None:
                    yield Finding(f"{EVIDENCE}/{RECORDS}", f"line {number} {problem}", grave=closed or problem != TORN)
        except OSError as error:
            yield Finding(f"{EVIDENCE}/{RECORDS}", f"cannot be read: {error.strerror}", grave=bool(self.witnessed))
        yield from self._heads(hashes, closed=closed)
        yield from self._index(hashes, closed=closed)
        for path in sorted(self._place.iterdir()):
            if path.name not in pictures:
                yield Finding(f"{EVIDENCE}/{path.name}", "belongs to no record", grave=closed)

    def _heads(self, hashes: Sequence[str], *, closed: bool) -> Iterator[Finding]:
        name = f"{EVIDENCE}/{HEADS}"
        try:
            lines = (self._place / HEADS).read_bytes().split(b"\n")
        except OSError as error:
            yield Finding(name, f"cannot be read: {error.strerror}", grave=bool(self.witnessed))
            return
        for i, line in enumerate(lines[:-1]):
            if i >= len(hashes):
                yield Finding(f"{EVIDENCE}/{RECORDS}", f"record {i} is missing: {HEADS} has its hash")
            elif line != head_line(i + 1, hashes[i]):
                yield Finding(name, f"line {i + 1} is not the hash of record {i}")
        if lines[-1] or len(lines) - 1 < len(hashes):
            missing = len(hashes) - len(lines) + 1
            yield Finding(name, "ends before the records do, or in no line end", grave=closed or missing > 1)

    def _index(self, hashes: Sequence[str], *, closed: bool) -> Iterator[Finding]:
        name = f"{EVIDENCE}/{RECORDS}"
        for said in self.witnessed:
            if said.records > len(hashes):
                yield Finding(name, f"record {said.records - 1} is missing: the index has its hash")
            elif hashes[said.records - 1] not in ("", said.sha256):
                yield Finding(name, f"record {said.records - 1} is not the one whose hash is in the index")
        unknown = len(hashes) - (self.witnessed[-1].records if self.witnessed else 0)
        if unknown > (0 if closed else 1):
            yield Finding(name, f"has {unknown} records that the index knows nothing of")

    def _record(self, record: EvidenceRecord) -> Iterator[Finding]:
        values = record.values
        name = f"{EVIDENCE}/{Path(str(values['picture'])).name}"
        row = self._rows.get(record_key(record))
        try:
            data = (self._folder / name).read_bytes()
        except OSError as error:
            yield Finding(name, f"cannot be read: {error.strerror}")
        else:
            if hashlib.sha256(data).hexdigest() != values["picture_sha256"]:
                yield Finding(name, f"was changed: its hash is not the one in record {record.number}")
            elif row is not None and _pixels_crc32(data, name) != row.crc32:
                yield Finding(name, f"is not the picture that was recorded as frame {row.number}")
        if row is not None and row.number in self._lines and values["result"] not in self._lines[row.number]:
            text = f"record {record.number} has another result than frame {row.number} has in {RESULTS}"
            yield Finding(f"{EVIDENCE}/{RECORDS}", text)


def _pixels_crc32(png: bytes, name: str) -> int | None:
    try:
        return pixels_crc32(decode_picture(png, name)[0])
    except UnsupportedFormatError:
        return None
