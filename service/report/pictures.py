"""Pictures of verifications, small enough for a page, with what was measured drawn over them."""

from __future__ import annotations

import base64
import hashlib
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from drivers.decoding import decode_picture
from drivers.errors import UnsupportedFormatError
from service.report.markup import Html, element

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from drivers.frame import Pixels
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.session.reader import RecordedSession

__all__ = ["picture"]

WIDTH_PX: Final = 640
QUALITY: Final = 80
MOST_RINGS: Final = 400


def picture(session: RecordedSession, record: EvidenceRecord) -> Html:
    """Show a record's picture; where it cannot be shown, say why."""
    try:
        data = session.evidence_picture(record).read_bytes()
        pixels = decode_picture(data, record.values["picture"])[0]
    except OSError as error:
        return _missing(f"the picture cannot be read: {error.strerror}")
    except UnsupportedFormatError as error:
        return _missing(f"the picture cannot be read: {error.message}")
    if hashlib.sha256(data).hexdigest() != record.values["picture_sha256"]:
        return _missing("the picture was changed since: its hash is not the one in the record")
    height, width = pixels.shape[:2]
    shown = element("image", href=_address(pixels), width=str(width), height=str(height))
    return element(
        "svg", shown, *_rings(record.values["result"]), *_target(record.values["result"]),
        viewBox=f"0 0 {width} {height}", class_="picture", role="img",
    )  # fmt: skip


def _missing(why: str) -> Html:
    return element("p", f"✖ {why}", class_="missing")


def _address(pixels: Pixels) -> str:
    """The picture itself, as an address: JPEG, at most `WIDTH_PX` wide."""
    brightest = 255 if pixels.dtype == np.uint8 else max(1, int(pixels.max()))
    grey: NDArray[Any] = pixels * (255.0 / brightest)
    if grey.shape[1] > WIDTH_PX:
        height = max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))
        grey = cv2.resize(grey, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.rint(grey).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode('ascii')}"


def _rings(line: Mapping[str, Any]) -> list[Html]:
    """A dot on every tube measured, dark on light, so that it is seen on both."""
    return [
        element("circle", cx=f"{t['x_px']:.1f}", cy=f"{t['y_px']:.1f}", r="3", class_="tube")
        for t in line["tubes"][:MOST_RINGS]
        if t["origin"] == "measured"
    ]


def _target(line: Mapping[str, Any]) -> list[Html]:
    """A frame around the target, with its name."""
    place = (line["alignment"] or {}).get("place")
    found = next((t for t in line["tubes"] if [t["row"], t["column"]] == place), None)
    if place is None or found is None:
        return []
    x, y = found["x_px"], found["y_px"]
    frame = element("rect", x=f"{x - 14:.1f}", y=f"{y - 14:.1f}", width="28", height="28", class_="target")
    name = element(
        "text", found["name"] or f"place {place[0]}, {place[1]}", x=f"{x:.1f}", y=f"{y - 20:.1f}", class_="name"
    )
    return [frame, name]
