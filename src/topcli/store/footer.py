"""Footer of a Parquet file that grows row group by row group and can be cut off after any of them.

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


class _Mover:
    """Copy data in Thrift's compact protocol, adding ``shift`` to every offset."""

    def __init__(self, data: bytes, shift: int) -> None:
        self._data, self._at, self._shift = data, 0, shift
        self.out = bytearray()

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _varint(self) -> int:
        value = place = 0
        while True:
            byte = self._byte()
            value |= (byte & 0x7F) << place
            place += 7
            if byte < 0x80:
                return value

    def _put_varint(self, value: int) -> None:
        while value >= 0x80:
            self.out.append(value & 0x7F | 0x80)
            value >>= 7
        self.out.append(value)

    def _copy(self, count: int) -> None:
        self.out += self._data[self._at : self._at + count]
        self._at += count

    def _value(self, kind: int, path: tuple[int, ...]) -> None:
        if kind in _VARINTS:
            value = self._varint()
            if kind == _I64 and path in _OFFSETS and value:  # 0: not set; zigzag encoding doubles the shift
                value += 2 * self._shift
            self._put_varint(value)
        elif kind == _STRUCT:
            self.struct(path)
        elif kind == _BINARY:
            length = self._varint()
            self._put_varint(length)
            self._copy(length)
        elif kind in (_LIST, _SET):
            head = self._byte()
            self.out.append(head)
            count, inner = head >> 4, head & 0x0F
            if count == 15:
                count = self._varint()
                self._put_varint(count)
            for _ in range(count):
                self._value(_BYTE if inner in (_TRUE, _FALSE) else inner, path)
        elif kind in (_BYTE, _DOUBLE):
            self._copy(1 if kind == _BYTE else 8)
        elif kind not in (_TRUE, _FALSE):  # the kind of a boolean field is its value
            raise ValueError(f"a Parquet footer holds a field of the unknown kind {kind}")

    def struct(self, path: tuple[int, ...] = ()) -> None:
        """Copy one struct; the paths of its fields begin with ``path``."""
        number = 0
        while True:
            head = self._byte()
            self.out.append(head)
            if not head:
                return
            if head >> 4:
                number += head >> 4
            else:
                zigzag = self._varint()
                self._put_varint(zigzag)
                number = (zigzag >> 1) ^ -(zigzag & 1)
            self._value(head & 0x0F, (*path, number))


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
        mover = _Mover(thrift, end)
        mover.struct()
        yield _metadata(bytes(mover.out))


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
