import os

from drivers.access import Holder, holders, how_to_permit
from tests.drivers.tree import put


def test_processes_that_hold_a_device_are_named(tmp_path):
    node = tmp_path / "video0"
    node.touch()
    for pid, name, target in ((71, "ffmpeg", node), (9, "sh", tmp_path / "other"), (123, "cheese", node)):
        descriptors = put(tmp_path / f"proc/{pid}/fd").parent
        put(descriptors, comm=name)
        (descriptors / "fd/3").symlink_to(target)
    put(tmp_path / "proc/55", comm="ended")
    put(tmp_path / "proc/self")
    assert holders(str(node), tmp_path / "proc") == [Holder(71, "ffmpeg"), Holder(123, "cheese")]
    assert str(Holder(71, "ffmpeg")) == "ffmpeg (pid 71)"


def test_this_very_process_is_seen_to_hold_what_it_opened(tmp_path):
    node = tmp_path / "node"
    with node.open("w"):
        assert [h.pid for h in holders(str(node))] == [os.getpid()]
    assert holders(str(node)) == []


def test_who_may_not_is_told_the_group_or_the_rule(tmp_path, monkeypatch):
    node = tmp_path / "node"
    node.touch()
    monkeypatch.setattr("drivers.access.grp.getgrgid", lambda gid: type("Group", (), {"gr_name": "video"}))
    node.chmod(0o660)
    assert how_to_permit(str(node)) == "it is for group video: sudo usermod -aG video $USER, and log in again"
    node.chmod(0o600)
    assert "udev rule config/deploy/70-bowlsight.rules" in how_to_permit(str(node))
    assert "udev rule" in how_to_permit(str(tmp_path / "absent"))
