"""The evidence log: a verification is a record and its picture, chained by hashes, appended and never changed.

Each line of ``evidence/records.jsonl`` ends with ``"hash"``: the SHA-256 of its text before that key, in which
``previous`` is the hash of the line before; the first one's is that of the session's description, which holds those of
the configuration. The hash of each line is written to ``evidence/heads.jsonl`` too, and to the session's index: lines
taken off the end are missed there.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from drivers.decoding import decode_picture
from service.sinks.evidence_record import claim_and_sight, figures, identity
from service.sinks.session.surroundings import utc_source, utc_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from drivers.frame import Frame, Pixels
    from service.results import FrameResult
    from service.sinks.evidence_record import EvidenceContext

__all__ = [
    "HEADS",
    "RECORDS",
    "SCHEMA",
    "TORN",
    "EvidenceLog",
    "EvidenceRecord",
    "head_line",
    "read_records",
    "without_times",
]

SCHEMA = 1
TORN: Final = "is cut short, or its line end was changed"
RECORDS, HEADS = "records.jsonl", "heads.jsonl"
_SUFFIX: Final = re.compile(rb',"hash":"([0-9a-f]{64})"}')
_SUFFIX_BYTES: Final = 75


@dataclass(frozen=True, slots=True)
class EvidenceRecord:
    """A verification as it was written.

    Attributes
    ----------
    number
        From 0 on.
    values
        The line's values; see `docs/formats.md`.
    sha256
        The line's own hash.
    """

    number: int
    values: Mapping[str, Any]
    sha256: str


class EvidenceLog:
    """Writes verifications into a session's folder. Callable from any thread; each call waits for the disk.

    Parameters
    ----------
    folder
        The session's `evidence` folder; it is made with the first record.
    genesis
        SHA-256 of the session's description.
    context
        What all records of the session have in common.
    witness
        Told the number of records and the last one's hash, to write them elsewhere as well.
    wall_ns
        UTC.
    """

    def __init__(
        self,
        folder: Path,
        genesis: str,
        context: EvidenceContext,
        *,
        witness: Callable[[int, str], None] = lambda _number, _hash: None,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._folder, self._context, self._witness, self._wall_ns = folder, context, witness, wall_ns
        self._lock = threading.Lock()
        self._previous, self._count = genesis, 0

    @property
    def count(self) -> int:
        """Records so far."""
        return self._count

    def verify(
        self,
        frame: Frame,
        result: FrameResult,
        claim: str | None,
        operator: str,
        reason: str | None = None,
        *,
        kind: str = "verify",
        mark: str | None = None,
    ) -> EvidenceRecord:
        """Put on record what a frame shows.

        Parameters
        ----------
        frame, result
            A frame that was measured, and its result: of an interlaced one, of either field.
        claim
            The tube that it is said to be, in any spelling; None: nobody says.
        operator
            Who says so.
        reason
            Why what the pictures say is overridden; None: it is not.
        kind, mark
            "verify", "periodic", or "before" and "after" the acquisition mark named.

        Raises
        ------
        OSError
            It cannot be written; then there is no such record.
        """
        with self._lock:
            number, wall_ns = self._count, self._wall_ns()
            picture = self._picture(number, frame.pixels)
            values = {
                "schema": SCHEMA,
                "number": number,
                "kind": kind,
                "mark": mark,
                "utc": utc_text(wall_ns),
                "utc_source": utc_source(),
                "operator": operator,
                "reason": (reason or "").strip() or None,
                **identity(self._context),
                **claim_and_sight(self._context, result, claim),
                **figures(result),
                "calibration": self._context.calibration.at(wall_ns),
                "software": self._context.software,
                "configuration_sha256": self._context.configuration_sha256,
                "frame": _frame(frame),
                **picture,
                "result": without_times(result.to_dict()),
            }
            return self._append(values)

    def _picture(self, number: int, pixels: Pixels) -> dict[str, str]:
        """Write the picture whole, see that it can be read, and give its name and hash."""
        done, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        png = data.tobytes()
        name = f"{number:06d}.png"
        if not done or not np.array_equal(decode_picture(png, name)[0], pixels):
            raise OSError(None, "the picture cannot be put into a PNG file without loss", name)
        self._folder.mkdir(exist_ok=True)
        path = self._folder / name
        _write(path, png, os.O_TRUNC)  # one without a record was left by an interrupted call: it is replaced
        return {"picture": name, "picture_sha256": hashlib.sha256(png).hexdigest()}

    def _append(self, values: Mapping[str, Any]) -> EvidenceRecord:
        number = self._count
        body = json.dumps({**values, "previous": self._previous}, separators=(",", ":"), allow_nan=False)[:-1]
        digest = hashlib.sha256(body.encode("ascii")).hexdigest()
        _write(self._folder / RECORDS, f'{body},"hash":"{digest}"}}\n'.encode("ascii"), os.O_APPEND)
        self._previous, self._count = digest, number + 1
        _write(self._folder / HEADS, head_line(self._count, digest) + b"\n", os.O_APPEND)
        self._witness(self._count, digest)
        return EvidenceRecord(number, dict(values), digest)


def head_line(records: int, digest: str) -> bytes:
    """What the list of hashes says of the last of so many records."""
    return f'{{"records":{records},"hash":"{digest}"}}'.encode("ascii")


def without_times(line: Mapping[str, Any]) -> dict[str, Any]:
    """A result line without what differs each time: how long it took."""
    return {key: value for key, value in line.items() if key != "elapsed_ms"}


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "source": frame.source,
        "generation": frame.generation,
        "sequence": frame.sequence,
        "timestamp_ns": frame.timestamp_ns,
        "received_ns": frame.received_ns,
        "field": str(frame.field),
    }


def _write(path: Path, data: bytes, how: int) -> None:
    """Write to the disk itself; what finds no room is taken back."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | how, 0o644)
    try:
        before, rest = (os.fstat(handle).st_size if how & os.O_APPEND else 0), memoryview(data)
        try:
            while rest:
                rest = rest[os.write(handle, rest) :]
            os.fsync(handle)
        except OSError as error:
            os.ftruncate(handle, before)
            error.filename = str(path)
            raise
    finally:
        os.close(handle)


def read_records(folder: Path, genesis: str | None) -> Iterator[tuple[int, EvidenceRecord | None, str | None]]:
    """Read the records of an evidence folder: line number, record, and None or what is wrong with it.

    Parameters
    ----------
    genesis
        SHA-256 of the session's description; None: what the first record follows is not checked.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    previous = genesis
    with (folder / RECORDS).open("rb") as file:
        for number, raw in enumerate(file, 1):
            found = _SUFFIX.fullmatch(raw, max(0, len(raw) - 1 - _SUFFIX_BYTES), len(raw) - 1)
            record, problem = _record(raw, number - 1, previous)
            previous = found[1].decode() if found else hashlib.sha256(raw).hexdigest()
            yield number, record, problem


def _record(raw: bytes, number: int, previous: str | None) -> tuple[EvidenceRecord | None, str | None]:
    if not raw.endswith(b"\n"):
        return None, TORN
    body = raw[: -1 - _SUFFIX_BYTES]
    found = _SUFFIX.fullmatch(raw, len(body), len(raw) - 1)
    if found is None or hashlib.sha256(body).hexdigest().encode() != found[1]:
        return None, "was changed: its hash is not that of its text"
    try:
        values = json.loads(body + b"}")
        if values.pop("previous") != previous and previous is not None:
            return None, "does not follow the record before it: one was changed, taken out or put in"
        if values["number"] != number:
            return None, f"has number {values['number']}, where {number} belongs"
    except (ValueError, KeyError, TypeError, AttributeError):
        return None, "is no evidence record"
    return EvidenceRecord(number, values, found[1].decode()), None
