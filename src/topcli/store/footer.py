"""Footer of a Parquet file that grows by row groups and can be cut off after any of them.

The footer of a Parquet file, at its end, holds the positions of the data: a file whose writer was killed is lost.
Here every row group is therefore appended as a small Parquet file with its own footer, and one last footer lists all
row groups. The offsets in a footer count from the start of its small file; ``merged_footer`` shifts them. It
implements the necessary part of Thrift's compact protocol, in which footers are written, and of ``FileMetaData``
(public formats: apache/parquet-format, ``parquet.thrift``). Readers use the last footer only; the earlier ones, some
hundred bytes for each row group, remain unused between the data. Each of them ends with ``UNFINISHED`` instead of
Parquet's magic number: otherwise a reader would accept the file of a killed process, and apply the footer of its last
row group to the data of the first.

pyarrow alone cannot do this at the same cost. An Arrow IPC stream of the row groups, beside which one Parquet file is
written, takes three times the space and, if every step is recorded, 1.8 times the time (3e6 rows of 12 columns: 3.2 s
instead of 1.7 s). One Parquet file for each row group, or a stream, encoded again at the end delays every stop by the
time of that encoding.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any, BinaryIO

MAGIC = b"PAR1"
UNFINISHED = b"PAR-"

_OFFSETS = frozenset(
    [
        (4, 5),  # row group: file_offset
        (4, 1, 2),  # column chunk: file_offset
        (4, 1, 4),  # offset_index_offset
        (4, 1, 6),  # column_index_offset
        (4, 1, 3, 9),  # column metadata: data_page_offset
        (4, 1, 3, 10),  # index_page_offset
        (4, 1, 3, 11),  # dictionary_page_offset
        (4, 1, 3, 14),  # bloom_filter_offset
    ]
)
"""Fields of ``FileMetaData`` that are positions in the file, as paths of field numbers (4: row groups, 1: columns)."""

_TRUE, _FALSE, _BYTE, _I64, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 1, 2, 3, 6, 7, 8, 9, 10, 12
_VARINTS = (4, 5, 6)


def shifted(data: bytes, shift: int) -> bytes:
    """Copy of a struct in Thrift's compact protocol, with ``shift`` added to every offset in it."""
    source, out = io.BytesIO(data), bytearray()

    def copy(count: int) -> bytes:
        piece = source.read(count)
        out.extend(piece)
        return piece

    def varint(shift: int = 0) -> int:
        value = place = 0
        byte = 0x80
        while byte & 0x80:
            (byte,) = source.read(1)
            value |= (byte & 0x7F) << place
            place += 7
        value += shift if value else 0  # 0: not set
        rest = value
        while rest >= 0x80:
            out.append(rest & 0x7F | 0x80)
            rest >>= 7
        out.append(rest)
        return value

    def value_of(kind: int, path: tuple[int, ...]) -> None:
        if kind in _VARINTS:
            varint(2 * shift if kind == _I64 and path in _OFFSETS else 0)  # zigzag encoding doubles the shift
        elif kind == _STRUCT:
            struct(path)
        elif kind == _BINARY:
            copy(varint())
        elif kind in (_LIST, _SET):
            (head,) = copy(1)
            count, inner = head >> 4, head & 0x0F
            for _ in range(varint() if count == 15 else count):
                value_of(_BYTE if inner in (_TRUE, _FALSE) else inner, path)
        elif kind in (_BYTE, _DOUBLE):
            copy(1 if kind == _BYTE else 8)
        elif kind not in (_TRUE, _FALSE):  # the kind of a boolean field is its value
            raise ValueError(f"a Parquet footer holds a field of the unknown kind {kind}")

    def struct(path: tuple[int, ...]) -> None:
        number = 0
        while head := copy(1)[0]:
            if head >> 4:
                number += head >> 4
            else:
                zigzag = varint()
                number = (zigzag >> 1) ^ -(zigzag & 1)
            value_of(head & 0x0F, (*path, number))

    struct(())
    return bytes(out)


def _metadata(thrift: bytes) -> Any:
    import pyarrow.parquet as pq

    return pq.read_metadata(io.BytesIO(MAGIC + thrift + len(thrift).to_bytes(4, "little") + MAGIC))


def _segments(file: BinaryIO, length: int) -> Iterator[Any]:
    """Metadata of the small files in ``file[:length]``, last to first, with shifted offsets."""
    end = length
    while end:
        file.seek(end - 8)
        tail = file.read(8)
        size = int.from_bytes(tail[:4], "little")
        if tail[4:] != UNFINISHED or size > end - 8:
            raise ValueError(f"no Parquet footer ends at byte {end}")
        file.seek(end - 8 - size)
        thrift = file.read(size)
        group = _metadata(thrift).row_group(0)
        columns = [group.column(i) for i in range(group.num_columns)]
        data_end = max(column.data_page_offset + column.total_compressed_size for column in columns)
        end -= data_end + size + 8
        file.seek(max(end, 0))
        if end < 0 or file.read(4) != MAGIC:
            raise ValueError(f"no Parquet data begin at byte {end}")
        yield _metadata(shifted(thrift, end))


def merged_footer(file: BinaryIO, length: int, last: bytes) -> bytes:
    """Footer that makes one Parquet file of the small ones in ``file[:length]``, to be appended to them.

    ``last`` is a complete Parquet file without rows, whose schema and metadata the result gets.
    Raises ValueError if the file is not such a chain, OSError if it cannot be read.
    """
    import pyarrow.parquet as pq

    merged = pq.read_metadata(io.BytesIO(last))
    for segment in reversed(list(_segments(file, length))):
        merged.append_row_groups(segment)
    out = io.BytesIO()
    merged.write_metadata_file(out)
    return out.getvalue()[len(MAGIC) :]
