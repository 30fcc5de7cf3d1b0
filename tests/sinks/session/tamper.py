"""Change single bytes of a session, one at a time, and see that `verify` finds each.

    python -m tests.sinks.session.tamper [SESSION] [--changes 1000]

Without a SESSION it records a small one with evidence. The session is put back as it was after every change.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from service.sinks.session.verification import verify_session
from tests.sinks.session.recorded import record_with_evidence


def files_of(session: Path) -> list[Path]:
    return sorted(p for p in session.rglob("*") if p.is_file() and p.stat().st_size)


def tampered(session: Path, count: int, rng: np.random.Generator, *, only: str = ""):
    """Change one byte after the other; gives file, place, and what was found."""
    files = [f for f in files_of(session) if only in str(f.relative_to(session))]
    for k in range(count):
        file = files[k % len(files)]
        whole = bytearray(file.read_bytes())
        at, by = int(rng.integers(len(whole))), int(rng.integers(1, 256))
        whole[at] ^= by
        file.write_bytes(whole)
        found = [finding for finding in verify_session(session) if finding.grave]
        whole[at] ^= by
        file.write_bytes(whole)
        yield file.relative_to(session), at, by, found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", nargs="?", type=Path)
    parser.add_argument("--changes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        session = args.session
        if session is None:
            session = record_with_evidence(Path(folder))
        assert not [f for f in verify_session(session) if f.grave], "is not sound to begin with"
        passed = unnamed = 0
        for file, at, by, found in tampered(session, args.changes, np.random.default_rng(args.seed)):
            if not found:
                passed += 1
                print(f"PASSED: {file} byte {at} xor {by}")
            elif not any(f.file == str(file) for f in found):
                unnamed += 1
                print(f"found, but under another name: {file} byte {at} xor {by}: {found[0]}")
        print(f"{args.changes} single bytes changed: {passed} passed verify, {unnamed} found under another file's name")
    return int(passed > 0)


if __name__ == "__main__":
    sys.exit(main())
