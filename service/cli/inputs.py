"""What commands are given: steam generator, camera, station file, and whether they go together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.cli.terminal import say
from service.config.shipped import shipped_config
from service.config.station import FieldOrder, Station, read_station
from service.vision.paper import assumed_camera

if TYPE_CHECKING:
    from drivers.grabber import FrameFormat
    from service.vision.camera import Camera

__all__ = ["field_order", "fitting_camera", "large_enough", "station", "station_file"]

STATION_FILE = Path("config/station.toml")
SMALLEST_PX = 16


def station_file(path: Path | None) -> Path:
    """The station file named, or the working directory's, or the one shipped."""
    if path is None and not STATION_FILE.exists():
        return shipped_config("station.toml")
    return path or STATION_FILE


def station(path: Path | None) -> Station:
    """Read `station_file`."""
    return read_station(station_file(path))


def field_order(given: str | None, default: FieldOrder = FieldOrder.AUTO) -> FieldOrder:
    """The option's value, or the default where it was not given."""
    return default if given is None else FieldOrder(given)


def large_enough(size_px: tuple[int, int], source: str) -> None:
    """Refuse pictures that no sheet fits on; raises ConfigError."""
    if min(size_px) < SMALLEST_PX:
        raise ConfigError(
            f"{source}: its pictures are {size_px[0]}x{size_px[1]} px; give a source of at least"
            f" {SMALLEST_PX}x{SMALLEST_PX} px"
        )


def fitting_camera(camera: Camera | None, picture_format: FrameFormat, source: str, *, quiet: bool = False) -> Camera:
    """Check that the camera is that of the pictures; without one, assume a sensor, and say so unless `quiet`.

    Raises
    ------
    ConfigError
        The camera file is for pictures of another size, or they are too small for any.
    """
    size = (picture_format.width_px, picture_format.height_px)
    large_enough(size, source)
    if camera is None:
        camera = assumed_camera(size)
        if not quiet:
            dx, dy = (1e3 * side for side in camera.pixel_pitch_mm)
            say(f"no camera file: pixels of {dx:.5g} x {dy:.5g} um assumed ({camera.name}), all else estimated")
    elif camera.image_size_px != size:
        (w, h), (cw, ch) = size, camera.image_size_px
        raise ConfigError(
            f"{source}: its pictures are {w}x{h} px, but camera {camera.name!r} has image_size_px = [{cw}, {ch}];"
            " give the camera file of this source"
        )
    return camera
