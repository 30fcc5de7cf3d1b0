from pathlib import Path
from types import SimpleNamespace

from drivers import discovery
from drivers.discovery import Device, serial_ports


def port(**values):
    plain = {"description": "n/a", "hwid": "n/a", "vid": None, "pid": None, "serial_number": None, "location": None}
    return SimpleNamespace(**plain | values)


def test_serial_ports_go_by_their_adapter_else_by_their_name(monkeypatch, tmp_path):
    ports = [
        port(device="/dev/ttyUSB1", description="FT232R", vid=0x0403, pid=0x6001, serial_number="A9"),
        port(device="/dev/ttyUSB0", description="CP2102", vid=0x10C4, pid=0xEA60, location="1-1.4"),
        port(device="/dev/ttyS0"),
        port(device="/dev/ttyS1", description="ttyS1", hwid="00:01"),
    ]
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: ports)
    assert serial_ports(tmp_path) == [
        Device("/dev/ttyS0", "serial port", "/dev/ttyS0"),
        Device("/dev/ttyS1", "ttyS1", "00:01"),
        Device("/dev/ttyUSB0", "CP2102", "usb:10c4:ea60@1-1.4"),
        Device("/dev/ttyUSB1", "FT232R", "usb:0403:6001:A9"),
    ]


def test_a_serial_port_is_named_by_the_link_that_stays_its_own(monkeypatch, tmp_path):
    """Two adapters with the same serial number share a link in by-id, and it leads to whichever came last."""
    for folder in ("dev", "by-id", "by-path"):
        (tmp_path / folder).mkdir()
    ports = []
    for n, (pid, serial, socket, name) in enumerate(
        [
            (0x6011, "A9", "1-1:1.0", "FT4232H_A9-if00"),
            (0x6011, "A9", "1-1:1.1", "FT4232H_A9-if01"),
            (0xEA60, "0001", "1-2", "CP2102_0001"),
            (0xEA60, "0001", "1-3", "CP2102_0001"),
            (0x7523, None, "1-4", "CH340"),
            (0x7523, None, "1-5", "CH340"),
            (0x2303, None, "1-6", "PL2303"),
        ]
    ):
        node = tmp_path / "dev" / f"ttyUSB{n}"
        node.touch()
        (tmp_path / "by-id" / name).unlink(missing_ok=True)
        (tmp_path / "by-id" / name).symlink_to(node)
        (tmp_path / "by-path" / socket).symlink_to(node)
        ports.append(port(device=str(node), vid=1, pid=pid, serial_number=serial, location=socket))
    (tmp_path / "by-id" / "of-another").symlink_to(tmp_path / "dev" / "gone")
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: ports)
    assert [Path(device.identity).relative_to(tmp_path).as_posix() for device in serial_ports(tmp_path)] == [
        "by-id/FT4232H_A9-if00",
        "by-id/FT4232H_A9-if01",
        "by-path/1-2",
        "by-path/1-3",
        "by-path/1-4",
        "by-path/1-5",
        "by-id/PL2303",
    ]
