import json

import pytest

from drivers.access import Holder
from drivers.discovery import Device
from drivers.grabber import SignalStatus, Standard
from drivers.video_device import OfferedFormat, OfferedInput, VideoDevice
from service.cli import devices, main

GRABBER = VideoDevice(
    "/dev/video0",
    "USB Video",
    "usb-534d:2109-A1",
    "uvcvideo",
    inputs=(
        OfferedInput("Composite", "analogue", (Standard.PAL,), in_use=True, signal=SignalStatus.NO_SIGNAL),
        OfferedInput("Camera 1", "camera", (Standard.NONE,), in_use=False, signal=SignalStatus.UNKNOWN),
    ),
    formats=(OfferedFormat("YUYV", tuple((w, 48) for w in range(10, 18))), OfferedFormat("MJPG", ())),
    held_by=(Holder(71, "ffmpeg"),),
)
SHUT = VideoDevice("/dev/video2", "Other", "path-pci-1", problem="may not be opened by this user; ask somebody")

BARE = VideoDevice("/dev/bus/usb/001/004", "Lab", "usb-1209:0001-SN1", "no kernel driver", scheme="uvc")


@pytest.fixture
def machine(monkeypatch):
    monkeypatch.setattr(devices, "video_devices", lambda: [GRABBER, SHUT])
    monkeypatch.setattr(devices, "usb_grabbers", lambda: [BARE])
    monkeypatch.setattr(devices, "serial_ports", lambda: [Device("/dev/ttyUSB0", "FT232R", "/dev/serial/by-id/x")])


def test_it_lists_what_can_be_opened_with_the_line_to_paste(machine, capsys):
    assert main(["devices"]) == 0
    opened, seen = capsys.readouterr().out.split("\nvideo devices\n")
    assert 'device = "simulated"' in opened
    video, serial = seen.split("\nserial ports")
    assert video.splitlines() == [
        "  /dev/video0  USB Video (uvcvideo)",
        '    device = "v4l2:usb-534d:2109-A1"',
        '    input = "Composite"  analogue, pal, in use, signal no-signal',
        '    input = "Camera 1"  camera',
        "    ?encoding=YUYV  10x48 11x48 12x48 13x48 14x48 15x48 and 2 more",
        "    ?encoding=MJPG  ",
        "    open in ffmpeg (pid 71)",
        "  /dev/video2  Other",
        '    device = "v4l2:path-pci-1"',
        "    may not be opened by this user; ask somebody",
        "  /dev/bus/usb/001/004  Lab (no kernel driver)",
        '    device = "uvc:usb-1209:0001-SN1"',
    ]
    assert "/dev/serial/by-id/x" in serial


def test_as_json_it_is_all_there_for_programs(machine, capsys):
    assert main(["devices", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == 1
    assert [v["device"] for v in told["video"]] == [
        "v4l2:usb-534d:2109-A1", "v4l2:path-pci-1", "uvc:usb-1209:0001-SN1",
    ]  # fmt: skip
    first = told["video"][0]
    assert first["inputs"][0] == {
        "name": "Composite", "kind": "analogue", "standards": ["pal"], "in_use": True, "signal": "no-signal",
    }  # fmt: skip
    assert first["formats"][1] == {"encoding": "MJPG", "sizes_px": []}
    assert first["held_by"] == [{"pid": 71, "command": "ffmpeg"}]
    assert told["video"][1]["problem"].startswith("may not")
    assert told["serial"][0]["port"] == "/dev/serial/by-id/x"


def test_a_machine_without_devices_says_so(monkeypatch, capsys):
    monkeypatch.setattr(devices, "video_devices", list)
    monkeypatch.setattr(devices, "usb_grabbers", list)
    monkeypatch.setattr(devices, "serial_ports", list)
    assert main(["devices"]) == 0
    assert capsys.readouterr().out.count("  none\n") == 2
