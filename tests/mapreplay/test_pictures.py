"""Pictures are red, green, blue, in memory and in their files."""

from io import BytesIO

import numpy as np
from PIL import Image

from mapreplay.pictures import png_of

RED, GREEN, WHITE = (255, 0, 0), (0, 255, 0), (255, 255, 255)


def test_a_png_has_the_colours_and_rows_of_its_picture() -> None:
    picture = np.array([[RED, GREEN], [WHITE, RED]], np.uint8)
    assert (np.asarray(Image.open(BytesIO(png_of(picture)))) == picture).all()


def test_greys_become_a_png_of_greys() -> None:
    greys = np.array([[0, 100, 255]], np.uint8)
    image = Image.open(BytesIO(png_of(greys)))
    assert (image.mode, np.asarray(image).tolist()) == ("L", greys.tolist())
