"""What all messages have in common as CDR: a header, alignment, strings, and arrays.

Plain CDR is four bytes that say so, then the fields in order, little-endian; each number is
aligned to its size, counted from after those four bytes, and a string or a sequence begins with
its length.
"""

from __future__ import annotations

import struct
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

Buffer: TypeAlias = bytes | memoryview

MAP: Final = b"\4\0\0\0map\0"
BASE_LINK: Final = b"\x0a\0\0\0base_link\0"
_CDR: Final = b"\0\1\0\0"
_HEADER: Final = struct.Struct("<4siI8s")
_COUNT: Final = struct.Struct("<I")
_NOTHING: Final = struct.Struct("")
HEADER_SIZE: Final = _HEADER.size
UNFRAMED: Final = HEADER_SIZE - len(MAP)
"""Bytes of a header before its frame."""


def header_at(stamp_ns: int) -> bytes:
    """How a message begins that is stamped with a simulated time, in frame ``map``."""
    return _HEADER.pack(_CDR, *divmod(stamp_ns, 1_000_000_000), MAP)


def fields_of(data: Buffer, layout: struct.Struct, frame: bytes = MAP) -> tuple[Any, ...]:
    """The fields after the header, which are laid out like that.

    Raises:
        ValueError: this is not a message in `frame`, so that its fields lie elsewhere.
        struct.error: the message is too short.
    """
    start = UNFRAMED + len(frame)
    values = layout.unpack_from(data, start)
    if data[:4] != _CDR or data[UNFRAMED:start] != frame:
        raise ValueError(f"a message that is not in the frame {frame[4:-1].decode()}")
    return values


def array_of(data: Buffer, dtype: npt.DTypeLike, count: int, offset: int) -> npt.NDArray[Any]:
    """An array that owns its memory: a view would keep the whole chunk."""
    return np.frombuffer(data, dtype, count, offset).copy()


class Packer:
    """A message with a header whose other fields may begin anywhere."""

    def __init__(self, header: bytes) -> None:
        self.data = bytearray(header)

    def add(self, alignment: int, layout: struct.Struct, *values: Any) -> None:
        """Values of one layout, the first of which is aligned."""
        self.align(alignment)
        self.data += layout.pack(*values)

    def align(self, alignment: int) -> int:
        """Pad; the position then, modulo 8."""
        self.data += bytes(-(len(self.data) - len(_CDR)) % alignment)
        return (len(self.data) - len(_CDR)) % 8

    def count(self, count: int) -> None:
        """The length of a sequence."""
        self.add(4, _COUNT, count)

    def text(self, text: str) -> None:
        """A string: its length with the final NUL, and its bytes."""
        encoded = text.encode() + b"\0"
        self.count(len(encoded))
        self.data += encoded


class Unpacker:
    """The inverse of `Packer`."""

    def __init__(self, data: Buffer, *, framed: bool = True) -> None:
        """Begin after the header in frame ``map``, or, not `framed`, after the stamp.

        Raises:
            ValueError, struct.error: see `fields_of`.
        """
        if framed:
            fields_of(data, _NOTHING)
        self._data = data
        self._position = HEADER_SIZE if framed else UNFRAMED

    def take(self, alignment: int, layout: struct.Struct) -> tuple[Any, ...]:
        """The next values of one layout."""
        self.align(alignment)
        values = layout.unpack_from(self._data, self._position)
        self._position += layout.size
        return values

    def align(self, alignment: int) -> int:
        """Skip padding; the position then, modulo 8."""
        self._position += -(self._position - len(_CDR)) % alignment
        return (self._position - len(_CDR)) % 8

    def count(self) -> int:
        """The length of a sequence."""
        (count,) = self.take(4, _COUNT)
        return int(count)

    def text(self) -> str:
        """The next string."""
        length = self.count()
        encoded = bytes(self._data[self._position : self._position + length])
        if len(encoded) != length or not encoded.endswith(b"\0"):
            raise ValueError("a string without an end")
        self._position += length
        return encoded[:-1].decode()
