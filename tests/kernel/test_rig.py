"""The rig itself: what cannot run says so, and what fails fails."""

import pytest

from tests.kernel import run as rig
from tests.kernel import vm


@pytest.fixture
def booted(monkeypatch):
    """Let `boot` do as it is told instead of booting; gives the list of what it was asked for."""
    asked = []

    def boot_with(outcome):
        def boot(command, exchange, seconds):
            asked.append(command)
            assert (exchange / "pictures.npy").exists()
            if isinstance(outcome, Exception):
                raise outcome
            (exchange / "figures").write_text("a figure\n")
            return outcome

        monkeypatch.setattr(rig, "boot", boot)
        return asked

    return boot_with


def test_what_cannot_be_had_is_said_loudly_and_is_no_failure(booted, capsys):
    booted(vm.UnavailableError("qemu-system-x86_64 is not installed (Debian package qemu-system-x86)"))
    assert rig.main([]) == 0
    said = "kernel tests did NOT run: qemu-system-x86_64 is not installed (Debian package qemu-system-x86)"
    assert capsys.readouterr().out.splitlines() == ["!" * 120, said, "!" * 120]


@pytest.mark.parametrize(
    ("outcome", "status", "words"),
    [(0, 0, "passed"), (1, 1, "FAILED"), (TimeoutError("the guest did not end"), 1, "FAILED: the guest did not end")],
)
def test_the_guests_verdict_is_the_verdict(booted, capsys, outcome, status, words):
    asked = booted(outcome)
    assert rig.main([]) == status
    assert f"kernel tests {words}" in capsys.readouterr().out
    assert any(word.endswith("guest_vivid.py") for word in asked[0])


def test_a_tool_that_is_missing_is_named_with_its_package(monkeypatch):
    monkeypatch.setattr(vm, "SEARCHED", "/nowhere")
    monkeypatch.setattr(vm.platform, "machine", lambda: "x86_64")
    with pytest.raises(vm.UnavailableError, match=r"qemu-system-x86_64 is not installed \(Debian package"):
        vm.requirements()
    monkeypatch.setattr(vm.platform, "machine", lambda: "riscv64")
    with pytest.raises(vm.UnavailableError, match="on riscv64"):
        vm.requirements()


def test_so_is_libusb(monkeypatch):
    monkeypatch.setattr(vm, "tool", lambda name, _: f"/bin/{name}")
    monkeypatch.setattr(vm, "is_static", lambda _: True)
    monkeypatch.setattr(vm, "find_library", lambda _: None)
    monkeypatch.setattr(vm.platform, "machine", lambda: "x86_64")
    with pytest.raises(vm.UnavailableError, match=r"libusb is not installed \(Debian package libusb-1\.0-0\)"):
        vm.requirements()


def test_a_tool_that_fails_or_hangs_is_told_in_its_own_words():
    with pytest.raises(vm.UnavailableError, match=r"ls: .*No such file"):
        vm.run_tool(["ls", "/nowhere/at/all"], 10)
    with pytest.raises(vm.UnavailableError, match="did not end within"):
        vm.run_tool(["sleep", "60"], 0.05)


def test_the_boot_image_has_its_files_in_order():
    image = vm.cpio([("bin", 0o040755, b""), ("init", 0o100755, b"#!/bin/sh\n")])
    assert image.startswith(b"070701")
    assert image.count(b"070701") == 3
    assert len(image) % 4 == 0
    assert b"init\0" in image
    assert b"#!/bin/sh\n" in image
