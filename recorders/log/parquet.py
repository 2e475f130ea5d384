"""What a Parquet file claims to unpack to, from its headers alone.

Polars believes the headers: a file of 100 kB can ask it for gigabytes. Headers are Thrift
structs in the compact protocol; here they become dicts by field id, as named in the format's
``parquet.thrift``.
"""

from __future__ import annotations

from typing import Any, Final

MAGIC: Final = b"PAR1"
_MAX_DEPTH: Final = 8

_ROWS, _ROW_GROUPS = 3, 4  # of FileMetaData
_COLUMNS = 1  # of RowGroup
_META_DATA = 3  # of ColumnChunk
_PACKED_SIZE, _DATA_PAGE, _DICTIONARY_PAGE = 7, 9, 11  # of ColumnMetaData
_UNPACKED_PAGE, _PACKED_PAGE = 2, 3  # of PageHeader
_DATA_HEADERS = (5, 8)
_VALUES = 1  # of DataPageHeader and DataPageHeaderV2


def check_pages(data: bytes, rows: int, limit: int) -> None:
    """Refuse a Parquet file that does not have `rows` rows, or unpacks to more than `limit`.

    Raises:
        ValueError, LookupError, TypeError: so it is, or it is damaged.
    """
    footer = _footer(data)
    groups = footer[_ROW_GROUPS]
    if footer[_ROWS] != rows or sum(group[_ROWS] for group in groups) != rows:
        raise ValueError(f"a table that does not have {rows} rows")
    unpacked = 0
    for group in groups:
        for chunk in group[_COLUMNS]:
            column = chunk[_META_DATA]
            first = column.get(_DICTIONARY_PAGE) or column[_DATA_PAGE]
            end, values = first + column[_PACKED_SIZE], 0
            if not len(MAGIC) <= first <= end <= len(data):
                raise ValueError("a column outside of its table")
            reader = _Thrift(data, first)
            while reader.position < end:
                page = reader.struct()
                if page[_PACKED_PAGE] < 0 or page[_UNPACKED_PAGE] < 0:
                    raise ValueError("a page of negative size")
                reader.position += page[_PACKED_PAGE]
                unpacked += page[_UNPACKED_PAGE]
                values += sum(page[k][_VALUES] for k in _DATA_HEADERS if k in page)
            if values > group[_ROWS]:
                raise ValueError(f"a column of {values} values in a table of {rows} rows")
    if unpacked > limit:
        raise ValueError(f"a table that unpacks to {unpacked} bytes; at most {limit} are allowed")


def _footer(data: bytes) -> dict[int, Any]:
    size = int.from_bytes(data[-8:-4], "little")
    start = len(data) - 8 - size
    if data[-4:] != MAGIC or start < len(MAGIC):
        raise ValueError("not a Parquet file")
    return _Thrift(data, start).struct()


class _Thrift:
    """Reads structs of the compact protocol."""

    def __init__(self, data: bytes, position: int) -> None:
        self._data = data
        self.position = position

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """The next struct: values by field id."""
        if depth > _MAX_DEPTH:
            raise ValueError("a Parquet header that is nested too deep")
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._signed()
            fields[number] = self._value(head & 15, depth)
        return fields

    def _byte(self) -> int:
        self.position += 1
        return self._data[self.position - 1]

    def _unsigned(self) -> int:
        result = shift = 0
        while (byte := self._byte()) & 0x80:
            result |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise ValueError("a Parquet header with a number of more than 64 bits")
        return result | byte << shift

    def _signed(self) -> int:
        value = self._unsigned()
        return value >> 1 ^ -(value & 1)

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (1, 2):  # a field that is true or false has no further bytes
            return kind == 1
        if kind == 3:
            return self._byte()
        if kind in (4, 5, 6):
            return self._signed()
        if kind == 7:
            self.position += 8
            return None
        if kind == 8:
            size = self._unsigned()
            self.position += size
            return None
        if kind in (9, 10):
            return self._list(depth)
        if kind == 12:
            return self.struct(depth + 1)
        raise ValueError("a Parquet header of an unknown kind")

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        count, kind = head >> 4, head & 15
        if count == 15:
            count = self._unsigned()
        if count > len(self._data) - self.position:  # an item has at least one byte
            raise ValueError("a Parquet header that is longer than its file")
        if kind in (1, 2):
            return [self._byte() for _ in range(count)]
        return [self._value(kind, depth) for _ in range(count)]
