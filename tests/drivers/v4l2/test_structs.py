"""The structures, request numbers and constants are the kernel's own: asked of its header through a C compiler."""

import ctypes
import enum
import platform
import shutil
import subprocess

import pytest

from drivers.v4l2 import constants, structs
from drivers.v4l2.structs import Request

MEMBERS = {
    structs.Capability: ("v4l2_capability", {}),
    structs.FormatDescription: ("v4l2_fmtdesc", {}),
    structs.PixFormat: ("v4l2_pix_format", {}),
    structs.Format: ("v4l2_format", {}),
    structs.FrameSize: ("v4l2_frmsizeenum", {"size": "stepwise"}),
    structs.FrameInterval: (
        "v4l2_frmivalenum",
        {"shortest": "stepwise.min", "longest": "stepwise.max", "step": "stepwise.step"},
    ),
    structs.StreamParameters: ("v4l2_streamparm", {}),
    structs.RequestBuffers: ("v4l2_requestbuffers", {}),
    structs.BufferDescription: ("v4l2_buffer", {}),
    structs.InputDescription: ("v4l2_input", {}),
    structs.Rectangle: ("v4l2_rect", {}),
    structs.Selection: ("v4l2_selection", {}),
    structs.ControlValue: ("v4l2_control", {}),
    structs.QueryControl: ("v4l2_queryctrl", {}),
    structs.MenuItem: ("v4l2_querymenu", {"item": "name"}),
    structs.BtTimings: ("v4l2_bt_timings", {}),
    structs.DvTimings: ("v4l2_dv_timings", {"timings": "bt"}),
    structs.Event: ("v4l2_event", {}),
    structs.EventSubscription: ("v4l2_event_subscription", {}),
}
NESTED = [
    (structs.StreamParameters, "v4l2_streamparm", "parm.capture.timeperframe"),
    (structs.StreamParameters, "v4l2_streamparm", "parm.capture.capability"),
    (structs.BufferDescription, "v4l2_buffer", "m.offset"),
    (structs.BufferDescription, "v4l2_buffer", "timestamp.tv_usec"),
    (structs.Format, "v4l2_format", "fmt.pix.sizeimage"),
    (structs.Event, "v4l2_event", "u.src_change.changes"),
]
PREFIXES = {
    constants.CapabilityFlag: "V4L2_CAP_",
    constants.BufferType: "V4L2_BUF_TYPE_",
    constants.FieldOrder: "V4L2_FIELD_",
    constants.BufferFlag: "V4L2_BUF_FLAG_",
    constants.InputStatus: "V4L2_IN_ST_",
    constants.InputCapability: "V4L2_IN_CAP_",
    constants.StandardBits: "V4L2_STD_",
    constants.SelectionTarget: "V4L2_SEL_TGT_",
    constants.ControlType: "V4L2_CTRL_TYPE_",
    constants.ControlFlag: "V4L2_CTRL_FLAG_",
    constants.ControlId: "V4L2_CID_",
    constants.SizeType: "V4L2_FRMSIZE_TYPE_",
}
RENAMED = {"V4L2_STD_LINES_525": "V4L2_STD_525_60"}
PLAIN = {
    "V4L2_MEMORY_MMAP": constants.MEMORY_MMAP,
    "V4L2_DV_BT_656_1120": constants.BT_TIMINGS_TYPE,
    "V4L2_EVENT_SOURCE_CHANGE": constants.EVENT_SOURCE_CHANGE,
    "V4L2_EVENT_SRC_CH_RESOLUTION": constants.SOURCE_RESOLUTION_CHANGED,
    **{
        f"V4L2_PIX_FMT_{name}": constants.fourcc(code)
        for name, code in {
            "GREY": "GREY", "Y10": "Y10", "Y12": "Y12", "Y16": "Y16", "Y16_BE": "Y16-BE", "YUYV": "YUYV",
            "UYVY": "UYVY", "NV12": "NV12", "MJPEG": "MJPG", "JPEG": "JPEG",
        }.items()
    },
}  # fmt: skip


def offset(structure: type[ctypes.Structure], path: str) -> int:
    first, _, rest = path.partition(".")
    if first == "src_change":  # one of the union's members, of which only this one is used
        return offset(structure, rest)
    field = getattr(structure, first)
    kind = {name: kind for name, kind, *_ in structure._fields_}[first]
    return field.offset + (offset(kind, rest) if rest else 0)


def expectations() -> dict[str, int]:
    """C expressions, and what this program takes their values for."""
    expected = {}
    for structure, (name, renamed) in MEMBERS.items():
        expected[f"sizeof(struct {name})"] = ctypes.sizeof(structure)
        for member, *_ in structure._fields_:
            expected[f"offsetof(struct {name}, {renamed.get(member, member)})"] = getattr(structure, member).offset
    for structure, name, path in NESTED:
        expected[f"offsetof(struct {name}, {path})"] = offset(structure, path)
    for request in Request:
        expected[f"VIDIOC_{request.name}"] = int(request)
    for enumeration, prefix in PREFIXES.items():
        for name, member in enumeration.__members__.items():
            expected[RENAMED.get(prefix + name, prefix + name)] = int(member)
    return expected | PLAIN


def test_every_enumeration_is_compared():
    enums = {e for e in vars(constants).values() if isinstance(e, enum.EnumType) and e.__module__ == constants.__name__}
    assert enums == set(PREFIXES)
    structures = {s for s in vars(structs).values() if isinstance(s, type) and issubclass(s, ctypes.Structure)}
    compared = set(MEMBERS) | {structs.Fraction}
    assert {s for s in structures if not s.__name__.startswith("_")} == compared


def test_layouts_and_numbers_are_those_of_the_kernels_header(tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("NOT COMPARED with linux/videodev2.h: no C compiler here")
    expected = expectations()
    headers = "\n".join(f"#include <{h}>" for h in ("stddef.h", "stdio.h", "sys/time.h", "linux/videodev2.h"))
    lines = "\n".join(f'printf("%lld\\n", (long long)({expression}));' for expression in expected)
    (tmp_path / "ask.c").write_text(f"{headers}\nint main(void) {{\n{lines}\n}}\n")
    built = subprocess.run(
        [compiler, "-o", str(tmp_path / "ask"), str(tmp_path / "ask.c")], capture_output=True, text=True, check=False
    )
    if "videodev2.h: No such file" in built.stderr:
        pytest.skip("NOT COMPARED with linux/videodev2.h: the kernel's headers are not here")
    assert built.returncode == 0, built.stderr
    told = subprocess.run([tmp_path / "ask"], capture_output=True, text=True, check=True).stdout.split()
    theirs = dict(zip(expected, map(int, told), strict=True))
    assert {e: v & 0xFFFFFFFF for e, v in theirs.items()} == {e: v & 0xFFFFFFFF for e, v in expected.items()}


@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="numbers of other machines may differ")
def test_request_numbers_are_the_known_ones():
    assert {request.name: int(request) for request in Request} == {
        "QUERYCAP": 0x80685600,
        "ENUM_FMT": 0xC0405602,
        "G_FMT": 0xC0D05604,
        "S_FMT": 0xC0D05605,
        "REQBUFS": 0xC0145608,
        "QUERYBUF": 0xC0585609,
        "QBUF": 0xC058560F,
        "DQBUF": 0xC0585611,
        "STREAMON": 0x40045612,
        "STREAMOFF": 0x40045613,
        "G_PARM": 0xC0CC5615,
        "S_PARM": 0xC0CC5616,
        "G_STD": 0x80085617,
        "S_STD": 0x40085618,
        "ENUMINPUT": 0xC050561A,
        "G_CTRL": 0xC008561B,
        "S_CTRL": 0xC008561C,
        "QUERYCTRL": 0xC0445624,
        "QUERYMENU": 0xC02C5625,
        "G_INPUT": 0x80045626,
        "S_INPUT": 0xC0045627,
        "QUERYSTD": 0x8008563F,
        "ENUM_FRAMESIZES": 0xC02C564A,
        "ENUM_FRAMEINTERVALS": 0xC034564B,
        "G_SELECTION": 0xC040565E,
        "S_SELECTION": 0xC040565F,
        "S_DV_TIMINGS": 0xC0845657,
        "G_DV_TIMINGS": 0xC0845658,
        "DQEVENT": 0x80885659,
        "SUBSCRIBE_EVENT": 0x4020565A,
        "QUERY_DV_TIMINGS": 0x80845663,
    }


def test_a_fourcc_is_written_as_v4l2_ctl_writes_it():
    for text in ("GREY", "Y10", "Y16", "Y16-BE", "MJPG"):
        assert constants.fourcc_text(constants.fourcc(text)) == text
    assert constants.fourcc("Y16-BE") == 0xA0363159
