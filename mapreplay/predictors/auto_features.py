"""Features of kinds of floor plans: the lengths of straight runs of equal cells.

A run is a longest row or column of equal cells. Its kind says what is at its two ends, and with
its length it is a *word*: free space of 12 cells between two walls, a wall of 1 cell with nothing
known behind it. Counted are free and occupied runs, and the unknown ones between two known
cells (the inside of a thick wall). A run that repeats the one in the line before, with the same
ends, is not counted again, so that a room of any size is one word per direction.

The features do not depend on the position of the map in its grid, nor on the grid's size; a map
rotated by 90 degrees or mirrored has the same words.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.grid import UNKNOWN, Grid

LENGTHS: Final = (1, 2, 3, 4, 5, 6, 7, 9, 11, 14, 18, 23, 29, 37)
"""The minimum length of each class of lengths, in cells."""
KINDS: Final = (
    "free, both ends open",
    "free, one end open",
    "free between walls",
    "wall, both ends unseen",
    "wall, one end unseen",
    "wall between free",
    "unknown between free",
    "unknown, free and wall",
    "unknown between walls",
)
"""Of runs; an end is open or unseen where the next cell is unknown."""
WORDS: Final = tuple(f"{kind}, {length}" for kind in KINDS for length in LENGTHS)

_LONGEST: Final = 1 << 15
"""A longer run counts as one of this length."""
_LENGTH_CLASS: Final = (
    np.searchsorted(LENGTHS, np.arange(_LONGEST + 1), side="right").astype(np.int64) - 1
)


def count_words(observed: Grid) -> npt.NDArray[np.int64]:
    """int64[126]: how often each of `WORDS` occurs in int8[H, W] `observed`."""
    known = observed != UNKNOWN
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return np.zeros(len(WORDS), np.int64)
    box = observed[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    count = len(WORDS)
    across: npt.NDArray[np.int64] = np.bincount(_words_of_rows(box), minlength=count)
    return across + np.bincount(_words_of_rows(box.T), minlength=count)


def _words_of_rows(cells: Grid) -> npt.NDArray[np.int64]:
    """int64[n]: the words of all rows of int8[H, W], as indices into `WORDS`."""
    height, width = cells.shape
    pitch = width + 2
    bordered = np.full((height, pitch), UNKNOWN, np.int8)
    bordered[:, 1:-1] = cells
    flat = bordered.ravel()
    cuts = np.flatnonzero(flat[1:] != flat[:-1]) + 1  # a first cell of a run; at least one is known
    first, after = cuts[:-1], cuts[1:]
    length = np.minimum(after - first, _LONGEST)
    state, left, right = flat[first], flat[first - 1], flat[after]
    # An unknown run that holds a cell of the border is not between two cells of its row.
    inside = (state != UNKNOWN) | ((first % pitch != 0) & (first // pitch == after // pitch))
    ends = np.where(state == UNKNOWN, 6 + (left > 0) + (right > 0), (left >= 0) + 0 + (right >= 0))
    kind = ends + 3 * (state > 0)
    first, length, kind = first[inside], length[inside], kind[inside]
    # All of a run in one number; the one right above differs by one pitch. `key` is sorted.
    step = len(KINDS) * (_LONGEST + 1)
    key = first * step + kind * (_LONGEST + 1) + length
    place = np.searchsorted(key, key - pitch * step)
    fresh = key[place] != key - pitch * step
    words: npt.NDArray[np.int64] = kind[fresh] * len(LENGTHS) + _LENGTH_CLASS[length[fresh]]
    return words
