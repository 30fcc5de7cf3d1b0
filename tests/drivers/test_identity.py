"""Video devices are known by what survives a replug."""

from pathlib import Path

import pytest

from drivers.identity import find_usb_devices, find_video_nodes, usb_video_devices, video_nodes
from tests.drivers.tree import put, usb_device, video_node
from tests.fakes.usb import Plugged, plug_in
from tests.fakes.uvc import FakeUvcDevice


@pytest.fixture
def machine(tmp_path):
    """A webcam with two nodes and a serial number, a grabber without one behind a hub, a board on PCI, a platform's."""
    webcam = usb_device(tmp_path, "1-2", serial="A/1 ?")
    stk = usb_device(tmp_path, "1-3.4", vendor="05e1", product="0408")
    video_node(tmp_path, "video10", put(tmp_path / "devices/pci0000:00/0000:03:00.0"), name="Board")
    video_node(tmp_path, "video0", webcam / "1-2:1.0")
    video_node(tmp_path, "video1", webcam / "1-2:1.0", index="1")
    video_node(tmp_path, "video2", stk / "1-3.4:1.0", name="STK1160")
    platform = put(tmp_path / "devices/platform/vivid.0")
    (platform / "subsystem").symlink_to(put(tmp_path / "bus/platform"))
    video_node(tmp_path, "video3", platform, name="vivid-000-vid-cap")
    return tmp_path


def test_a_device_is_known_by_number_else_by_place(machine):
    assert [(n.node, n.name, n.identity) for n in video_nodes(machine)] == [
        ("/dev/video0", "USB Video", "usb-534d:2109-A%2F1%20%3F"),
        ("/dev/video1", "USB Video", "usb-534d:2109-A%2F1%20%3F#1"),
        ("/dev/video2", "STK1160", "path-pci-0000:00:14.0-usb-0:3.4"),
        ("/dev/video3", "vivid-000-vid-cap", "path-platform-vivid.0"),
        ("/dev/video10", "Board", "path-0000:03:00.0"),
    ]


def test_each_is_found_by_what_it_is_listed_as_and_by_its_place(machine):
    for n in video_nodes(machine):
        assert find_video_nodes(n.identity, machine)[0].node == n.node
    place = "path-pci-0000:00:14.0-usb-0:2"
    assert [n.node for n in find_video_nodes(place, machine)] == ["/dev/video0", "/dev/video1"]
    assert [n.node for n in find_video_nodes(f"{place}#1", machine)] == ["/dev/video1"]
    assert find_video_nodes("usb-534d:2109-B2", machine) == []
    assert find_video_nodes(f"{place}#7", machine) == []


def test_twins_are_known_by_place(tmp_path):
    for port, node in (("1-1", "video0"), ("1-4", "video1")):
        video_node(tmp_path, node, usb_device(tmp_path, port, serial="0001") / f"{port}:1.0")
    places = ["path-pci-0000:00:14.0-usb-0:1", "path-pci-0000:00:14.0-usb-0:4"]
    assert [n.identity for n in video_nodes(tmp_path)] == places
    assert {n.place for n in find_video_nodes("usb-534d:2109-0001", tmp_path)} == set(places)


def test_the_number_of_the_bus_does_not_matter_but_which_of_the_controllers_it_is(tmp_path):
    for bus, speed in (("usb7", "480"), ("usb12", "5000")):
        put(tmp_path / f"devices/pci0000:00/0000:00:14.0/{bus}", speed=speed)
    video_node(tmp_path, "video0", usb_device(tmp_path, "7-1") / "7-1:1.0")
    video_node(tmp_path, "video1", usb_device(tmp_path, "12-1") / "12-1:1.0")
    places = [n.place for n in video_nodes(tmp_path)]
    assert places == ["path-pci-0000:00:14.0-usb-0:1", "path-pci-0000:00:14.0-usb-1:1"]


def test_two_cameras_in_one_device_are_told_apart(tmp_path):
    usb = usb_device(tmp_path, "1-1", serial="S")
    video_node(tmp_path, "video0", usb / "1-1:1.3")
    video_node(tmp_path, "video1", usb / "1-1:1.0")
    assert [n.identity for n in video_nodes(tmp_path)] == ["usb-534d:2109-S#1", "usb-534d:2109-S"]


def test_a_machine_without_video_devices_has_none(tmp_path):
    assert video_nodes(tmp_path) == find_video_nodes("usb-1-2", tmp_path) == []


def test_a_device_that_goes_away_while_it_is_looked_at_keeps_its_node(tmp_path):
    put(tmp_path / "class/video4linux/video0")
    ((device),) = video_nodes(tmp_path)
    assert (device.node, device.name) == ("/dev/video0", "video0")


def test_a_usb_device_without_a_root_hub_is_known_by_its_port(tmp_path):
    usb = put(tmp_path / "devices/odd/1-2", idVendor="1", idProduct="2")
    video_node(tmp_path, "video0", usb / "1-2:1.0")
    assert video_nodes(tmp_path)[0].place == "path-usb-1-2"


def test_a_usb_device_is_known_by_the_same_identity_as_its_node(tmp_path):
    for port, address, serial in (("1-2", 4, "A/1 ?"), ("1-3.4", 12, None)):
        folder = plug_in(tmp_path, Plugged(FakeUvcDevice(serial=serial), address=address), port=port)
        video_node(tmp_path, f"video{address}", folder / f"{port}:1.0")
    put(tmp_path / "bus/usb/devices/1-9/1-9:1.0", bInterfaceClass="08")
    put(tmp_path / "bus/usb/devices/1-7/1-7:1.0", bInterfaceClass="0e")
    devices = usb_video_devices(tmp_path)
    assert [d.identity for d in devices] == [n.identity for n in video_nodes(tmp_path)]
    assert [(d.node, d.name, d.bus_and_address) for d in devices] == [
        ("/dev/bus/usb/001/004", "Lab Fake UVC grabber", (1, 4)),
        ("/dev/bus/usb/001/012", "Lab Fake UVC grabber", (1, 12)),
    ]
    assert [d.identity for d in find_usb_devices(devices[0].place, tmp_path)] == [devices[0].identity]


def test_usb_twins_are_known_by_place_and_what_serves_them_is_told(tmp_path):
    plug_in(tmp_path, Plugged(FakeUvcDevice(), address=4), port="1-2", driver="uvcvideo")
    plug_in(tmp_path, Plugged(FakeUvcDevice(), address=5), port="1-3")
    assert [(d.identity, d.kernel_driver) for d in usb_video_devices(tmp_path)] == [
        ("path-pci-0000:00:14.0-usb-0:2", "uvcvideo"),
        ("path-pci-0000:00:14.0-usb-0:3", ""),
    ]
    assert len(find_usb_devices("usb-1209:0001-SN1", tmp_path)) == 2


def test_a_usb_device_that_goes_away_while_it_is_looked_at_is_left_out(tmp_path, monkeypatch):
    plug_in(tmp_path, Plugged(FakeUvcDevice()))
    look = Path.glob

    def gone(folder, pattern):
        if pattern == "*:*":
            raise FileNotFoundError(folder)
        return look(folder, pattern)

    monkeypatch.setattr(Path, "glob", gone)
    assert usb_video_devices(tmp_path) == []
