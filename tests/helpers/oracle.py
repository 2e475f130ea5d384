"""rosbags' CDR serializer: another implementation of what `recorders/log/cdr.py` packs by hand."""

from __future__ import annotations

from typing import Any

from mapreplay.recorders.log.schemas import typestore


def to_cdr(message: object, type_name: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))


def from_cdr(data: bytes, type_name: str) -> Any:
    return typestore().deserialize_cdr(data, type_name)
