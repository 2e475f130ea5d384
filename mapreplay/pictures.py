"""The one type of a picture in memory, and the one encoder of PNG files."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Picture: TypeAlias = npt.NDArray[np.uint8]
"""uint8[h, w, 3]: red, green, blue; row 0 on top."""


def png_of(picture: Picture) -> bytes:
    """The picture, or uint8[h, w] of greys, as a PNG file; the same pixels give the same bytes."""
    # OpenCV wants blue, green, red.
    _, data = cv2.imencode(".png", picture if picture.ndim == 2 else picture[..., ::-1])
    return data.tobytes()
