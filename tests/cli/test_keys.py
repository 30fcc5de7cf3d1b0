"""Keys reach a command that runs in a terminal, and nothing is read where there is none."""

import io
import os
import pty
import sys
from pathlib import Path

from service.cli.keys import pressed_keys

SCRIPT = """
import os, termios
from service.cli.keys import pressed_keys
before = termios.tcgetattr(0)
with pressed_keys() as keys:
    os.write(1, b"ready ")
    got = ""
    while len(got) < 2:
        got += keys()
    os.write(1, f"got {got} ".encode())
os.write(1, b"same" if termios.tcgetattr(0) == before else b"other")
"""


def test_keys_are_read_without_enter_and_the_terminal_is_put_back():
    child, master = pty.fork()
    if child == 0:
        os.chdir(Path(__file__).parents[2])
        os.execv(sys.executable, [sys.executable, "-c", SCRIPT])
    said, pressed = b"", False
    try:
        while not said.endswith((b"same", b"other")):
            said += os.read(master, 100)
            if b"ready" in said and not pressed:
                pressed = os.write(master, b"vm") == 2
    finally:
        os.waitpid(child, 0)
        os.close(master)
    assert b"got vm" in said
    assert said.endswith(b"same")


def test_without_a_terminal_there_are_no_keys(monkeypatch):
    for stdin in (io.StringIO("v"), None):
        monkeypatch.setattr(sys, "stdin", stdin)
        with pressed_keys() as keys:
            assert keys is None
