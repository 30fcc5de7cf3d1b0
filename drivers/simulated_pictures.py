"""The pictures of the simulated device: rendered once, shown in a loop, spoiled as its faults want it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from drivers.faults import FaultKind

if TYPE_CHECKING:
    from drivers.frame import Pixels
    from drivers.simulated_device import Exposure
    from drivers.simulation import Scene

__all__ = ["CHANNELS", "NEUTRAL", "SIGNALLESS", "PictureLoop"]

CHANNELS: Final = 4
SIGNALLESS: Final = 3
NEUTRAL: Final = 128.0
NO_SIGNAL_SHARE: Final = 16 / 255


class PictureLoop:
    """A scene there and back, for every channel from another place on.

    Parameters
    ----------
    scene
        What is to be seen.
    frames
        Pictures from one end to the other.
    rng
        For pictures that are noise.
    """

    def __init__(self, scene: Scene, frames: int, rng: np.random.Generator) -> None:
        self._scene, self._rng = scene, rng
        self._way = max(1, 2 * frames - 2)
        self._rendered: list[Pixels] = []
        self._gain, self._lift_share = 1.0, 0.0
        self._adjusted: dict[int, Pixels] = {}

    def render(self) -> None:
        """Draw the pictures, where that is not done yet."""
        # an interlaced picture shown on the way back would have its fields in the wrong order: it is drawn apart
        count = self._way if self._scene.interlaced else self._way // 2 + 1
        self._rendered = self._rendered or [self._scene.picture(k) for k in range(count)]

    def adjust(self, brightness: float, contrast: float) -> None:
        """Set brightness and contrast, 0 to 255; 128 changes nothing."""
        self._gain, self._lift_share = contrast / NEUTRAL, (brightness - NEUTRAL) / 255
        self._adjusted.clear()

    def scene_number(self, pixels: Pixels) -> int | None:
        """Frame of the scene that a picture handed out shows; None where it was changed."""
        return next((k for k, picture in enumerate(self._rendered) if picture is pixels), None)

    def picture(self, exposure: Exposure) -> tuple[Pixels, str | None]:
        """What a frame shows after all its faults, and what the device says is wrong with it."""
        kinds, sound = exposure.kinds, self._sound(exposure)
        height, width = sound.shape
        if FaultKind.WRONG_SIZE in kinds:
            small = sound[::2, ::2].copy()
            return _sealed(small), f"is {small.shape[1]}x{small.shape[0]} px where {width}x{height} px were granted"
        if FaultKind.TRUNCATE in kinds:
            cut = sound.copy()
            cut[height // 2 :] = 0
            return _sealed(cut), f"truncated: {cut[: height // 2].nbytes} of {cut.nbytes} bytes"
        defect = "the device flagged an error" if FaultKind.ERROR_FLAG in kinds else None
        if FaultKind.BLACK in kinds:
            return _sealed(np.zeros_like(sound)), defect
        if FaultKind.NOISE in kinds:
            return _sealed(self._rng.integers(0, np.iinfo(sound.dtype).max, sound.shape, sound.dtype)), defect
        return sound, defect

    def _sound(self, exposure: Exposure) -> Pixels:
        if exposure.channel == SIGNALLESS:
            like = self._rendered[0]
            return _sealed(np.full_like(like, round(NO_SIGNAL_SHARE * np.iinfo(like.dtype).max)))
        place = (exposure.shows + exposure.channel * self._way // CHANNELS) % self._way
        shown = place if self._scene.interlaced else min(place, self._way - place)
        if (self._gain, self._lift_share) == (1, 0):
            return self._rendered[shown]
        if shown not in self._adjusted:
            self._adjusted[shown] = self._adjust(self._rendered[shown])
        return self._adjusted[shown]

    def _adjust(self, pixels: Pixels) -> Pixels:
        top = float(np.iinfo(pixels.dtype).max)
        levels = np.clip((pixels - top / 2) * self._gain + (0.5 + self._lift_share) * top, 0, top)
        return _sealed(np.rint(levels).astype(pixels.dtype))


def _sealed(pixels: Pixels) -> Pixels:
    pixels.flags.writeable = False
    return pixels
