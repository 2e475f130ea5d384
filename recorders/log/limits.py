"""What a log may ask of the machine that reads it; what is beyond is refused with a clear line.

A size is compared with its limit before anything of that size is read or unpacked, so that
memory is bounded by a few times the largest limit, whatever a file claims.
"""

from __future__ import annotations

from typing import Final

MAX_CHUNK_BYTES: Final = 512 << 20
"""Of a chunk, unpacked, and of any record: 32 bytes for each cell of the largest map (4096 x
4096). A step of it has 7 in its maps with a float32 prediction; the writer refuses a step that
needs more, such as one with 16 million frontier cells."""

MAX_OPEN_BYTES: Final = MAX_CHUNK_BYTES + (256 << 20)
"""Of chunks that are in memory together, because steps are spread over them: other tools may
order messages as they like."""

MAX_LOOSE_BYTES: Final = 1 << 20
"""Of messages without a chunk that are read in one go; a longer message alone is one, too."""

MAX_STEP_BYTES: Final = MAX_CHUNK_BYTES - (16 << 20)
"""Of the messages of a step: a chunk that is nearly full ends with it."""

MAX_MESSAGES_A_CHUNK: Final = 250_000
"""A chunk of ours has at most some 300; other tools may put more of them together."""

MAX_METADATA_BYTES: Final = 1 << 20
"""Of a metadata record; ours have some 2000."""

MAX_INDEX_BYTES: Final = 64 << 20
"""Of the index at the end of a finished log: room for 200,000 chunks and more."""

MAX_NAMES: Final = 1000
"""Channels, types, metadata records and attachments, each, that a log may have."""

MAX_STEPS: Final = 2_000_000
"""Of an episode; the writer refuses more."""

MAX_BUDGET: Final = 100_000_000
"""Steps that an episode might have taken: more than 4 for each cell of the largest map."""

MAX_ROW_BYTES: Final = 512
"""Of a row of the table of steps, unpacked; ours have some 250. With `TABLE_BYTES` and
`MAX_STEPS` that is 1 GB for the longest log."""

TABLE_BYTES: Final = 1 << 20
"""Of that table beside its rows."""


def check_size(what: str, size: int, limit: int) -> None:
    """Refuse `size` bytes of something.

    Raises:
        ValueError: they are more than `limit`.
    """
    if size > limit:
        raise ValueError(f"{what} of {size} bytes; at most {limit} are allowed")


def check_count(what: str, count: int, limit: int) -> None:
    """Refuse `count` of something.

    Raises:
        ValueError: they are more than `limit`.
    """
    if count > limit:
        raise ValueError(f"{count} {what}; at most {limit} are allowed")
