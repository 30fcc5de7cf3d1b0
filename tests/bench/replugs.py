"""A device that is unplugged again and again: what the process holds must not grow with it.

    python -m tests.bench.replugs [CYCLES] [--leak BYTES]

Run in a process of its own, so that nothing else moves its memory. After a warm-up of a fifth of the cycles, what the
process holds is sampled after every tenth, while the service runs. Allocators give and take whole arenas, at one moment
or another; so the least of the second half is held against the least of the first: what leaks in every cycle lifts
it, what only comes and goes does not. Fails where a cycle costs more than 4 kB of memory that is never given back, or
any file or thread. --leak loses so many bytes a cycle on purpose: what the check is worth.
"""

import argparse
import gc
import logging
import sys

import numpy as np

from drivers.faults import Fault, FaultKind
from service.acquisition.resources import resources
from tests.bench.faults import run
from tests.bench.soak import own_bytes

CYCLES = 1000
APART, UNPLUGGED_S = 6, 0.7
WARM_UP_SHARE, EVERY = 0.2, 10
LIMIT_BYTES = 4000
"""A cycle: an arena of 1 MiB that stays behind by chance is less."""


class Watch:
    """Samples what the process holds after every tenth replug: rows of bytes, files, threads."""

    def __init__(self, cycles: int, leak_bytes: int) -> None:
        self._leak_bytes, self._leaked = leak_bytes, []
        self.replugs, self.samples = 0, np.zeros((cycles // EVERY, 3))

    def __call__(self, text: str, _level: str) -> None:
        """Take what the service tells."""
        if "streams again" not in text:
            return
        if self._leak_bytes:
            self._leaked.append(b"\1" * self._leak_bytes)
        self.replugs += 1
        if self.replugs % EVERY == 0:
            gc.collect()
            held = resources()
            self.samples[self.replugs // EVERY - 1] = own_bytes(), held.fds, held.threads


def main(cycles: int, leak_bytes: int) -> int:
    """Unplug so often, and say what grew; 1 where something did."""
    logging.getLogger("service").setLevel(logging.CRITICAL)  # some thousand records that nobody reads
    faults = tuple(Fault(FaultKind.DISCONNECT, APART * (i + 1), seconds=UNPLUGGED_S) for i in range(cycles))
    watch = Watch(cycles, leak_bytes)
    _, health, _ = run(faults, APART * (cycles + 1), tell=watch)
    assert health.recoveries == watch.replugs == cycles, (health.recoveries, watch.replugs)
    assert health.generation >= cycles + 1
    kept = watch.samples[int(WARM_UP_SHARE * len(watch.samples)) :]
    first, second = kept[: len(kept) // 2], kept[len(kept) // 2 :]
    grown = second.min(axis=0) - first.min(axis=0)
    a_cycle = grown[0] / (EVERY * len(first))
    print(f"{cycles:,} replugs, measured over the last {EVERY * len(kept):,}: {a_cycle:+.0f} bytes a cycle")
    print(f"  memory {first[:, 0].min() / 1e6:.2f} MB, then {second[:, 0].min() / 1e6:.2f} MB")
    print(f"  files {grown[1]:+.0f}, threads {grown[2]:+.0f}")
    return int(a_cycle > LIMIT_BYTES or bool(np.any(grown[1:] > 0)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("cycles", nargs="?", type=int, default=CYCLES)
    parser.add_argument("--leak", type=int, default=0, metavar="BYTES")
    given = parser.parse_args()
    sys.exit(main(given.cycles, given.leak))
