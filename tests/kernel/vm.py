"""A small virtual machine with a full kernel: real capture devices where the machine itself has none.

Debian's kernel package is unpacked into a cache folder, never installed. QEMU boots it in software (no KVM is asked
for) with this machine's own files, read-only, under a layer in memory: the guest runs the project's own environment.
"""

import contextlib
import gzip
import io
import lzma
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from ctypes.util import find_library
from pathlib import Path

CACHE = Path(os.environ.get("BOWLSIGHT_VM_CACHE") or Path.home() / ".cache/bowlsight/vm")
META_PACKAGE = "linux-image-amd64"
FIRST_MODULES = ("virtio_pci", "virtio_console", "9pnet_virtio", "9p", "overlay")
TOOLS_S, DOWNLOAD_S = 60, 300
SEARCHED = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"

# What the kernel starts: load what files come through, put a layer in memory over the host's, go there.
INIT = r"""#!/bin/busybox sh
B=/bin/busybox
$B mount -t proc proc /proc; $B mount -t sysfs sysfs /sys; $B mount -t devtmpfs dev /dev
for m in @MODULES@; do $B insmod /modules/$m || echo "insmod $m failed"; done
$B mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=524288,cache=loose host /host
$B mount -t tmpfs -o size=70% tmpfs /layer; $B mkdir -p /layer/upper /layer/work
$B mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work overlay /new
for d in proc sys dev; do $B mkdir -p /new/$d; $B mount --move /$d /new/$d; done
$B mkdir -p /new/dev/pts /new/dev/shm /new/run /new/mnt/exchange /new/lib/modules
$B mount -t devpts devpts /new/dev/pts; $B mount -t tmpfs tmpfs /new/dev/shm; $B mount -t tmpfs tmpfs /new/run
$B mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 exchange /new/mnt/exchange
$B ln -s @MODULE_FOLDER@ /new/lib/modules/@RELEASE@
$B ip link set lo up
cd /new
exec $B chroot /new /bin/sh /mnt/exchange/stage2
"""
STAGE2 = r"""
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
export BOWLSIGHT_EXCHANGE=/mnt/exchange PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
cd @FOLDER@
setsid sh -c @COMMAND@ </dev/null >/dev/hvc0 2>&1
echo $? > /mnt/exchange/status
dmesg > /mnt/exchange/dmesg
sync
echo o > /proc/sysrq-trigger
sleep 60
"""
# hpet: a TSC that is measured on a busy machine has been seen to run eight times too fast
PARAMETERS = (
    "console=ttyS0 panic=-1 quiet loglevel=3 mitigations=off random.trust_cpu=on no_timer_check nokaslr audit=0"
    " selinux=0 apparmor=0 clocksource=hpet tsc=unstable"
)


class UnavailableError(Exception):
    """What is needed to boot cannot be had here; the message says what."""


def tool(name: str, package: str) -> str:
    found = shutil.which(name, path=SEARCHED)
    if found is None:
        raise UnavailableError(f"{name} is not installed (Debian package {package})")
    return found


def is_static(binary: Path) -> bool:
    """Whether a program needs no other files; the boot image has none."""
    return b"/ld-linux" not in binary.read_bytes()[:4096]


def run_tool(arguments: list[str], seconds: float, folder: Path | None = None) -> str:
    try:
        done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=seconds, check=True)
    except subprocess.TimeoutExpired as error:
        raise UnavailableError(f"{arguments[0]} did not end within {seconds:g} s") from error
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or str(error)
        raise UnavailableError(f"{' '.join(arguments[:3])}: {said.strip().splitlines()[-1]}") from error
    return done.stdout


class Kernel:
    """The unpacked kernel package."""

    def __init__(self, root: Path):
        self.root = root
        self.release = next((root / "lib/modules").iterdir()).name
        self.modules = root / "lib/modules" / self.release

    @classmethod
    def get(cls) -> "Kernel":
        """Take it from the cache, or have apt download it; raises UnavailableError."""
        root = CACHE / "kernel"
        if not (root / "lib/modules").is_dir():
            CACHE.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
                cls._unpack(Path(scratch))
                shutil.rmtree(root, ignore_errors=True)
                (Path(scratch) / "kernel").rename(root)
        return cls(root)

    @staticmethod
    def _unpack(scratch: Path):
        depends = run_tool([tool("apt-cache", "apt"), "depends", META_PACKAGE], TOOLS_S)
        names = [word for word in depends.split() if word.startswith("linux-image-") and word[12].isdigit()]
        if not names:
            raise UnavailableError(f"apt knows no kernel behind {META_PACKAGE}")
        run_tool([tool("apt-get", "apt"), "download", "-q", names[0]], DOWNLOAD_S, scratch)
        ((package),) = scratch.glob("*.deb")
        run_tool([tool("dpkg-deb", "dpkg"), "-x", str(package), str(scratch / "kernel")], DOWNLOAD_S)
        release = names[0].removeprefix("linux-image-")
        run_tool([tool("depmod", "kmod"), "-b", str(scratch / "kernel"), release], DOWNLOAD_S)

    def with_dependencies(self, names: tuple[str, ...]) -> list[str]:
        """Module files below `modules`, each after those that it needs."""
        table = {}
        for line in (self.modules / "modules.dep").read_text().splitlines():
            file, _, needs = line.partition(":")
            table[Path(file).name.partition(".")[0].replace("-", "_")] = [*reversed(needs.split()), file]
        return list(dict.fromkeys(file for name in names for file in table[name]))

    def image(self) -> Path:
        """Give the kernel as an ELF file: QEMU enters it directly, instead of unpacking it in software."""
        image = self.root / "vmlinux"
        if not image.exists():
            packed = (self.root / f"boot/vmlinuz-{self.release}").read_bytes()
            start = packed.find(b"\xfd7zXZ\0")
            if start < 0:
                return self.root / f"boot/vmlinuz-{self.release}"
            image.write_bytes(lzma.LZMADecompressor().decompress(packed[start:]))
        return image


def cpio(entries: list[tuple[str, int, bytes]]) -> bytes:
    """An initial file system: (name, mode, content) each. The format is in the kernel's buffer-format.rst."""
    out = io.BytesIO()
    for number, (name, mode, content) in enumerate([*entries, ("TRAILER!!!", 0, b"")], 1):
        device = (5, 1) if name == "dev/console" else (0, 0)
        fields = (number, mode, 0, 0, 1, 0, len(content), 0, 0, *device, len(name) + 1, 0)
        out.write(b"070701" + b"".join(b"%08X" % value for value in fields) + name.encode() + b"\0")
        out.write(b"\0" * (-out.tell() % 4) + content)
        out.write(b"\0" * (-out.tell() % 4))
    return out.getvalue()


def module(file: Path) -> tuple[str, bytes]:
    """Name and content of a module, unpacked: busybox loads no others."""
    content = file.read_bytes()
    return (file.stem, lzma.decompress(content)) if file.suffix == ".xz" else (file.name, content)


def boot_image(kernel: Kernel, busybox: Path) -> bytes:
    modules = [module(kernel.modules / file) for file in kernel.with_dependencies(FIRST_MODULES)]
    init = INIT.replace("@MODULES@", " ".join(name for name, _ in modules)).replace(
        "@MODULE_FOLDER@", str(kernel.modules)
    )
    folders = ("bin", "proc", "sys", "dev", "modules", "host", "layer", "new")
    return gzip.compress(
        cpio(
            [(folder, 0o040755, b"") for folder in folders]
            + [("dev/console", 0o020600, b"")]
            + [("init", 0o100755, init.replace("@RELEASE@", kernel.release).encode())]
            + [("bin/busybox", 0o100755, busybox.read_bytes())]
            + [(f"modules/{name}", 0o100644, content) for name, content in modules]
        ),
        compresslevel=1,
    )


def requirements() -> tuple[str, Path, Kernel]:
    """QEMU, a static busybox and the kernel; raises UnavailableError."""
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise UnavailableError(f"they need Linux on x86_64, this is {sys.platform} on {platform.machine()}")
    qemu, busybox = tool("qemu-system-x86_64", "qemu-system-x86"), Path(tool("busybox", "busybox-static"))
    if not is_static(busybox):
        raise UnavailableError(f"{busybox} is not static (Debian package busybox-static)")
    for needed, package in (("modprobe", "kmod"), ("udevadm", "udev")):
        tool(needed, package)
    if find_library("usb-1.0") is None:
        raise UnavailableError("libusb is not installed (Debian package libusb-1.0-0)")
    return qemu, busybox, Kernel.get()


def boot(command: list[str], exchange: Path, seconds: float) -> int:
    """Run a command in the guest, its output going to ours; gives its exit status.

    Parameters
    ----------
    command
        Run as root in the current folder; finds `exchange` at $BOWLSIGHT_EXCHANGE.
    exchange
        Folder that both sides write to.
    seconds
        After this long the machine is switched off.

    Raises
    ------
    UnavailableError
        What is needed is not here.
    TimeoutError
        It did not end in time.
    """
    qemu, busybox, kernel = requirements()
    (exchange / "boot").write_bytes(boot_image(kernel, busybox))
    stage2 = STAGE2.replace("@FOLDER@", shlex.quote(str(Path.cwd())))
    (exchange / "stage2").write_text(stage2.replace("@COMMAND@", shlex.quote(shlex.join(command))))
    arguments = [
        qemu, "-machine", "q35", "-accel", "tcg,thread=multi,tb-size=512", "-cpu", "max", "-smp", "2", "-m", "2048",
        "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot",
        "-kernel", str(kernel.image()), "-initrd", str(exchange / "boot"),
        "-append", PARAMETERS,
        "-serial", f"file:{exchange}/console",
        "-device", "virtio-serial-pci", "-chardev", "stdio,id=out,signal=off", "-device", "virtconsole,chardev=out",
        "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
        "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
        "-fsdev", f"local,id=exchange,path={exchange},security_model=none",
        "-device", "virtio-9p-pci,fsdev=exchange,mount_tag=exchange",
        "-object", "rng-random,id=random,filename=/dev/urandom", "-device", "virtio-rng-pci,rng=random",
    ]  # fmt: skip
    with subprocess.Popen(arguments, stdin=subprocess.DEVNULL) as machine:
        try:
            machine.wait(seconds)
        except subprocess.TimeoutExpired:
            machine.kill()
            raise TimeoutError(f"the guest did not end within {seconds:g} s\n{console(exchange)}") from None
    with contextlib.suppress(OSError):
        return int((exchange / "status").read_text())
    raise TimeoutError(f"the guest broke off (QEMU's exit status {machine.returncode})\n{console(exchange)}")


def console(exchange: Path, lines: int = 25) -> str:
    """The last that the guest's kernel said."""
    with contextlib.suppress(OSError):
        return "\n".join((exchange / "console").read_text(errors="replace").splitlines()[-lines:])
    return ""


def main() -> int:
    """Boot, and run what the command line says."""
    with tempfile.TemporaryDirectory(prefix="bowlsight-vm-") as exchange:
        began = time.monotonic()
        status = boot(sys.argv[1:], Path(exchange), 600)
        print(f"guest: {time.monotonic() - began:.1f} s, exit status {status}")
        return status


if __name__ == "__main__":
    sys.exit(main())
