from drivers.discovery import Device
from service.cli import devices, main


def test_it_lists_what_can_be_opened_and_what_is_only_seen(monkeypatch, capsys):
    monkeypatch.setattr(devices, "video_devices", lambda: [Device("/dev/video0", "USB Video", "usb:534d:2109:A1")])
    monkeypatch.setattr(devices, "serial_ports", list)
    assert main(["devices"]) == 0
    opened, seen = capsys.readouterr().out.split("video devices that the system shows")
    assert 'device = "simulated"' in opened
    assert "/dev/video0" not in opened
    video, serial = seen.split("serial ports")
    assert "usb:534d:2109:A1" in video
    assert "cannot grab from them yet" in video
    assert serial.endswith("none\n")
