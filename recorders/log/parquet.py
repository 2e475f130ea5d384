"""Reading Parquet as our tables of steps are written: flat columns, in numpy, and nothing else.

A log is believed no more than its bytes allow, and libraries that read any Parquet file can be made
to panic, to abort the process or to allocate gigabytes by a file whose checksums are right. So this
reads what the writer writes: optional columns of int32, float64 and text, in pages of version 1
that are compressed with zstd, plain or by a dictionary. Every length is compared with what is
there before it is used. Headers are Thrift structs in the compact protocol; here they become dicts
by field id, as named in the format's ``parquet.thrift``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import zstandard

MAGIC: Final = b"PAR1"
_MAX_DEPTH: Final = 8

_SCHEMA, _ROWS, _ROW_GROUPS = 2, 3, 4  # of FileMetaData
_TYPE, _REPETITION, _NAME, _CHILDREN = 1, 3, 4, 5  # of SchemaElement
_COLUMNS = 1  # of RowGroup, beside _ROWS
_FILE, _META_DATA = 1, 3  # of ColumnChunk
_CODEC, _VALUE_COUNT, _PACKED_SIZE, _DATA_PAGE, _DICTIONARY_PAGE = 4, 5, 7, 9, 11
"""Of ColumnMetaData."""
_PAGE, _UNPACKED_PAGE, _PACKED_PAGE, _DATA_HEADER, _DICTIONARY_HEADER = 1, 2, 3, 5, 7
"""Of PageHeader."""
_VALUES, _ENCODING, _LEVELS = 1, 2, 3  # of DataPageHeader; the first two of a dictionary's, too
_OPTIONAL: Final = 1
_ZSTD: Final = 6
_DATA, _DICTIONARY = 0, 2  # types of a page
_PLAIN, _PLAIN_DICTIONARY, _RLE, _RLE_DICTIONARY = 0, 2, 3, 8  # encodings
_INTEGERS: Final = (5, 6, 4)  # kinds of a Thrift field
_LENGTH: Final = struct.Struct("<I")


class UnknownParquetError(ValueError):
    """A file that may be a whole Parquet file, but is not written as ours are."""


class Kind(IntEnum):
    """What is in a column, by the number of its physical type."""

    INT32 = 1
    FLOAT64 = 5
    TEXT = 6


_DTYPES: Final[dict[Kind, np.dtype[Any]]] = {
    Kind.INT32: np.dtype("<i4"),
    Kind.FLOAT64: np.dtype("<f8"),
}

Values = npt.NDArray[Any]
"""int32[n], float64[n] or, of texts, object[n]."""


class Column(NamedTuple):
    """The values of a column, and which of them are there; what stands for the others is 0."""

    values: Values
    """int32[rows], float64[rows] or, of texts, object[rows]."""
    present: npt.NDArray[np.bool_]
    """bool[rows]."""


def read_columns(
    data: bytes, kinds: Mapping[str, Kind], rows: int, limit: int
) -> dict[str, Column]:
    """The columns of a table of `rows` rows that has those of `kinds`, in that order.

    Args:
        data: The file.
        kinds: What is in each column, by its name.
        rows: Of the table.
        limit: Bytes that all pages may unpack to.

    Raises:
        UnknownParquetError: it has other columns, or is compressed or encoded in another way.
        ValueError: it is damaged, has another number of rows, or unpacks to more than `limit`.
    """
    try:
        return _Reader(data, limit).columns(kinds, rows)
    except _DAMAGE as error:
        raise ValueError(f"a damaged Parquet file: {error}") from None


_DAMAGE: Final = (
    AttributeError, LookupError, OverflowError, struct.error, TypeError, UnicodeError,
    zstandard.ZstdError,
)  # fmt: skip
"""What comes of headers whose fields are not of the type that they should be, and of a page that
does not unpack."""


@dataclass(frozen=True, slots=True)
class _Page:
    """A page, unpacked, and its header."""

    kind: int
    head: Mapping[int, Any]
    body: bytes


class _Reader:
    def __init__(self, data: bytes, limit: int) -> None:
        self._data = data
        self._left = limit
        self._zstd = zstandard.ZstdDecompressor()

    def columns(self, kinds: Mapping[str, Kind], rows: int) -> dict[str, Column]:
        footer = _footer(self._data)
        groups = footer[_ROW_GROUPS]
        sizes = [group[_ROWS] for group in groups]
        if footer[_ROWS] != rows or sum(sizes) != rows or any(size < 0 for size in sizes):
            raise ValueError(f"a table that does not have {rows} rows")
        _check_schema(footer[_SCHEMA], kinds)
        parts: list[list[Column]] = [[] for _ in kinds]
        for group, size in zip(groups, sizes, strict=True):
            for part, chunk, kind in zip(parts, group[_COLUMNS], kinds.values(), strict=True):
                part.append(self._chunk(chunk, kind, size))
        return dict(zip(kinds, map(_joined, parts, kinds.values()), strict=True))

    def _chunk(self, chunk: Mapping[int, Any], kind: Kind, rows: int) -> Column:
        """A column of one row group."""
        column = chunk[_META_DATA]
        if _FILE in chunk or column[_TYPE] != kind or column[_CODEC] != _ZSTD:
            raise UnknownParquetError("a Parquet file with a column that is not as we write it")
        if column[_VALUE_COUNT] != rows:
            raise ValueError(f"a column of {column[_VALUE_COUNT]} values in {rows} rows")
        dictionary: Values | None = None
        parts: list[Column] = []
        left = rows
        for page in self._pages(column):
            if page.kind == _DICTIONARY:
                if dictionary is not None or page.head[_ENCODING] not in (
                    _PLAIN,
                    _PLAIN_DICTIONARY,
                ):
                    raise UnknownParquetError("a Parquet file with another kind of dictionary")
                dictionary = _plain(page.body, kind, page.head[_VALUES])
                continue
            count = page.head[_VALUES]
            if not 0 <= count <= left:
                raise ValueError(f"a page of {count} values where {left} rows are left")
            left -= count
            parts.append(_data_page(page, kind, count, dictionary))
        if left:
            raise ValueError(f"a column that lacks {left} of {rows} values")
        return _joined(parts, kind)

    def _pages(self, column: Mapping[int, Any]) -> Iterator[_Page]:
        first = column.get(_DICTIONARY_PAGE) or column[_DATA_PAGE]
        end = first + column[_PACKED_SIZE]
        if not len(MAGIC) <= first <= end <= len(self._data):
            raise ValueError("a column outside of its table")
        reader = _Thrift(self._data, first, end)
        while reader.position < end:
            header = reader.struct()
            packed, unpacked = header[_PACKED_PAGE], header[_UNPACKED_PAGE]
            body = reader.take(packed)
            if not 0 <= unpacked <= self._left:
                raise ValueError(f"a page of {unpacked} bytes; at most {self._left} are allowed")
            self._left -= unpacked
            kind = header[_PAGE]
            head = header.get(_DATA_HEADER if kind == _DATA else _DICTIONARY_HEADER)
            if kind not in (_DATA, _DICTIONARY) or head is None:
                raise UnknownParquetError(f"a Parquet file with a page of kind {kind}")
            yield _Page(kind, head, self._unpacked(body, unpacked))

    def _unpacked(self, body: bytes, size: int) -> bytes:
        # The frame says its size once more, or nothing (-1); memory is allocated for what it says.
        if zstandard.frame_content_size(body) not in (-1, size):
            raise ValueError("a page that unpacks to another size than it says")
        unpacked = self._zstd.decompress(body, max_output_size=size) if size else b""
        if len(unpacked) != size:
            raise ValueError("a page that unpacks to another size than it says")
        return unpacked


def _check_schema(schema: Sequence[Mapping[int, Any]], kinds: Mapping[str, Kind]) -> None:
    """The columns are those of `kinds`.

    Raises:
        UnknownParquetError: they are not.
    """
    root, *columns = schema
    found = [
        (column[_NAME], column.get(_TYPE), column.get(_REPETITION), column.get(_CHILDREN, 0))
        for column in columns
    ]
    wanted = [(name.encode(), kind, _OPTIONAL, 0) for name, kind in kinds.items()]
    if root.get(_CHILDREN) != len(kinds) or found != wanted:
        raise UnknownParquetError("a Parquet file with other columns")


def _joined(parts: Sequence[Column], kind: Kind) -> Column:
    if len(parts) == 1:
        return parts[0]
    dtype = _DTYPES.get(kind, np.dtype(object))
    empty = Column(np.empty(0, dtype), np.empty(0, np.bool_))
    values, present = zip(empty, *parts, strict=True)
    return Column(np.concatenate(values), np.concatenate(present))


def _data_page(page: _Page, kind: Kind, count: int, dictionary: Values | None) -> Column:
    """The `count` values of a page: which are there, and those that are."""
    encoding = page.head[_ENCODING]
    if page.head[_LEVELS] != _RLE:
        raise UnknownParquetError("a Parquet file with other levels")
    (size,) = _LENGTH.unpack_from(page.body)
    start = _LENGTH.size + size
    if start > len(page.body):
        raise ValueError("levels that are longer than their page")
    present = _hybrid(page.body[_LENGTH.size : start], 1, count).astype(np.bool_)
    there, body = int(np.count_nonzero(present)), page.body[start:]
    if encoding == _PLAIN:
        found = _plain(body, kind, there)
    elif encoding in (_PLAIN_DICTIONARY, _RLE_DICTIONARY):
        if dictionary is None:
            raise ValueError("a column without its dictionary")
        indices = _hybrid(body[1:], body[0], there) if there else np.empty(0, np.int64)
        if there and indices.max() >= len(dictionary):
            raise ValueError("a value that is not in its dictionary")
        found = dictionary[indices]
    else:
        raise UnknownParquetError(f"a Parquet file with a column of encoding {encoding}")
    if there == count:
        return Column(found, present)
    values = np.zeros(count, found.dtype)
    values[present] = found
    return Column(values, present)


def _plain(body: bytes, kind: Kind, count: int) -> Values:
    """`count` values, one after the other."""
    if kind is Kind.TEXT:
        return _texts(body, count)
    dtype = _DTYPES[kind]
    if count * dtype.itemsize != len(body):
        raise ValueError(f"{count} values in {len(body)} bytes")
    values: Values = np.frombuffer(body, dtype)
    return values.astype(dtype.newbyteorder("="))


def _texts(body: bytes, count: int) -> Values:
    if not 0 <= count * _LENGTH.size <= len(body):
        raise ValueError(f"{count} texts in {len(body)} bytes")
    texts, position = np.empty(count, object), 0
    for k in range(count):
        (size,) = _LENGTH.unpack_from(body, position)
        position += _LENGTH.size + size
        if position > len(body):
            raise ValueError("a text that is longer than its page")
        texts[k] = body[position - size : position].decode()
    return texts


def _hybrid(data: bytes, width: int, count: int) -> npt.NDArray[np.int64]:
    """int64[count]: numbers of `width` bits as runs and packed groups of eight."""
    if width > 32:
        raise ValueError(f"numbers of {width} bits")
    reader = _Thrift(data, 0, len(data))
    parts: list[npt.NDArray[np.int64]] = []
    left = count
    while left > 0:
        head = reader.unsigned()
        groups = head >> 1
        if head & 1:
            if groups == 0 or groups > -(-left // 8):
                raise ValueError(f"{groups} groups of values where {left} values are left")
            packed = np.frombuffer(reader.take(groups * width), np.uint8)
            bits = np.unpackbits(packed, bitorder="little").reshape(groups * 8, width)
            numbers = (bits @ (1 << np.arange(width, dtype=np.int64)))[:left]
        else:
            if not 0 < groups <= left:
                raise ValueError(f"a run of {groups} values where {left} values are left")
            value = int.from_bytes(reader.take(-(-width // 8)), "little")
            if value >> width:
                raise ValueError(f"a number of more than {width} bits")
            numbers = np.full(groups, value)
        parts.append(numbers)
        left -= len(numbers)
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, np.int64), *parts])


def _footer(data: bytes) -> dict[int, Any]:
    size = int.from_bytes(data[-8:-4], "little")
    start = len(data) - 8 - size
    if data[-4:] != MAGIC or data[: len(MAGIC)] != MAGIC or start < len(MAGIC):
        raise ValueError("not a Parquet file")
    return _Thrift(data, start, len(data) - 8).struct()


class _Thrift:
    """Reads structs of the compact protocol between two places of `data`."""

    def __init__(self, data: bytes, position: int, end: int) -> None:
        self._data = data
        self._end = end
        self.position = position

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """The next struct: values by field id."""
        if depth > _MAX_DEPTH:
            raise ValueError("a Parquet header that is nested too deep")
        fields: dict[int, Any] = {}
        number = 0
        data = self._data
        while (head := data[self.position]) != 0:
            self.position += 1
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            if kind in _INTEGERS and (byte := data[self.position]) < 0x80:  # most of all fields
                self.position += 1
                fields[number] = byte >> 1 ^ -(byte & 1)
            else:
                fields[number] = self._value(kind, depth)
        self.position += 1
        if self.position > self._end:
            raise ValueError("a Parquet header that is cut off")
        return fields

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        if not 0 <= size <= self._end - self.position:
            raise ValueError(f"{size} bytes where {self._end - self.position} are left")
        self.position += size
        return self._data[self.position - size : self.position]

    def unsigned(self) -> int:
        """The next number of seven bits a byte."""
        result = shift = 0
        while (byte := self._byte()) & 0x80:
            result |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise ValueError("a Parquet header with a number of more than 64 bits")
        return result | byte << shift

    def _byte(self) -> int:
        position = self.position
        if position >= self._end:
            raise ValueError("a Parquet header that is cut off")
        self.position = position + 1
        return self._data[position]

    def _signed(self) -> int:
        value = self.unsigned()
        return value >> 1 ^ -(value & 1)

    def _value(self, kind: int, depth: int) -> Any:
        if kind in _INTEGERS:
            return self._signed()
        if kind == 12:
            return self.struct(depth + 1)
        if kind == 8:
            return self.take(self.unsigned())
        if kind in (9, 10):
            return self._list(depth)
        if kind in (1, 2):  # a field that is true or false has no further bytes
            return kind == 1
        if kind == 3:
            return self._byte()
        if kind == 7:
            return self.take(8)
        raise ValueError("a Parquet header of an unknown kind")

    def _list(self, depth: int) -> list[Any]:
        if depth > _MAX_DEPTH:
            raise ValueError("a Parquet header that is nested too deep")
        head = self._byte()
        count, kind = head >> 4, head & 15
        if count == 15:
            count = self.unsigned()
        if count > self._end - self.position:  # an item has at least one byte
            raise ValueError("a Parquet header that is longer than its file")
        if kind in (1, 2):
            return [self._byte() for _ in range(count)]
        return [self._value(kind, depth + 1) for _ in range(count)]
