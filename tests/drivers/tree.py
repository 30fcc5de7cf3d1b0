"""A system's device tree, as far as video devices show in it."""

from pathlib import Path


def put(folder: Path, **files: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(f"{text}\n")
    return folder


def usb_device(
    sysfs: Path, port: str, *, vendor="534d", product="2109", serial=None, controller="0000:00:14.0"
) -> Path:
    """A USB device at a port such as 1-2 or 1-2.4, on bus 1 of a PCI controller; gives its folder."""
    bus = port.partition("-")[0]
    slot = put(sysfs / "devices/pci0000:00" / controller)
    put(sysfs / "bus/pci")
    if not (slot / "subsystem").exists():
        (slot / "subsystem").symlink_to(sysfs / "bus/pci")
    files = {"idVendor": vendor, "idProduct": product} | ({"serial": serial} if serial else {})
    return put(slot / f"usb{bus}" / port, **files)


def video_node(sysfs: Path, node: str, hardware: Path, *, name="USB Video", index="0") -> Path:
    """A video node of a piece of hardware; gives its link in the class folder, to be unlinked by an unplug."""
    put(hardware)
    folder = put(hardware / "video4linux" / node, name=name, index=index)
    if not (folder / "device").exists():
        (folder / "device").symlink_to(hardware)
    link = put(sysfs / "class/video4linux") / node
    link.symlink_to(folder)
    return link
