"""Reading back what was logged for the viewer, with rerun's own reader."""

import contextlib
import os
import subprocess
import time
import warnings
from pathlib import Path

import pyarrow as pa
from rerun.chunk import RrdReader

from service.sinks.viewer_page import rerun_program

PATIENCE_S = 60.0


class Rrd:
    """The rows of an .rrd file by entity, in the order of its frames; times in ns."""

    def __init__(self, path: Path):
        self.rows, self.static = {}, {}
        # a file still being written may be absent, empty or torn, and has no footer: whoever reads it reads again
        with warnings.catch_warnings(), contextlib.suppress(ValueError, RuntimeError):
            warnings.simplefilter("ignore")
            for chunk in RrdReader(path).stream():
                rows = _plain(chunk.to_record_batch()).to_pylist()
                (self.static if chunk.is_static else self.rows).setdefault(chunk.entity_path, []).extend(rows)
        for rows in self.rows.values():
            rows.sort(key=lambda row: (row["frame"], row["log_time"]))

    def column(self, entity, name):
        return [row.get(name) for row in self.rows.get(entity, [])]

    def frames(self, entity="/status"):
        return self.column(entity, "frame")


def _plain(batch):
    """Times as nanoseconds: Python's own kinds hold microseconds only."""
    timed = [pa.types.is_timestamp(c.type) or pa.types.is_duration(c.type) for c in batch.columns]
    columns = [c.cast(pa.int64()) if t else c for c, t in zip(batch.columns, timed, strict=True)]
    return pa.RecordBatch.from_arrays(columns, names=batch.schema.names)


class Client:
    """A real viewer without a screen: rerun itself, writing what it is sent to a file."""

    def __init__(self, grpc_url: str, path: Path, port: int):
        command = [rerun_program(), "--bind", "127.0.0.1", "--port", str(port), "--save", path, grpc_url]
        quiet = os.environ | {"CI": "1", "RUST_LOG": "off"}
        self.path = path
        self.process = subprocess.Popen(command, env=quiet, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def wait_for_bytes(self, count: int):
        wait_until(lambda: self.path.exists() and self.path.stat().st_size > count)

    def end(self):
        self.process.kill()
        self.process.wait(PATIENCE_S)


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "what was waited for did not happen"
        time.sleep(0.01)
