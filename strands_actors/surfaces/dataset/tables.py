"""Read parquet files that any program may have written or damaged.

Any defect of a file raises ``DatasetError`` with a message of one line.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO, Any, TypeVar

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from strands_actors.contract.lfs import pointer_reason

from .errors import DatasetError

Decoded = TypeVar("Decoded")
JSON_DAMAGE = (msgspec.MsgspecError, ValueError, RecursionError)


class Rows(msgspec.Struct, frozen=True):
    """A small parquet table: its rows as Python objects, and the metadata of its schema."""

    rows: list[dict[str, Any]]
    metadata: dict[bytes, bytes]


@contextlib.contextmanager
def refuse_damage(path: Path) -> Iterator[None]:
    """Turn the errors that pyarrow raises for a damaged file into a ``DatasetError``."""
    try:
        yield
    except FileNotFoundError as missing:
        raise DatasetError(f"{path} is missing") from missing
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, OverflowError, MemoryError) as damage:
        raise DatasetError(unreadable(path, damage)) from damage


def unreadable(path: Path, damage: BaseException) -> str:
    """Return why a file cannot be read, as one line."""
    with contextlib.suppress(OSError):
        if pointer := pointer_reason(path):
            return pointer
    return f"{path} cannot be read: {' '.join(str(damage).split())[:200].rstrip('.')}"


def read_table(path: Path, without: Collection[str] = ()) -> pa.Table:
    """Read a table, and verify the pages that have a checksum.

    Args:
        path: The parquet file.
        without: Columns that are left out, for example large pictures.

    Raises:
        DatasetError: The file is missing or damaged.
    """
    table, unread = read_groups(path, without)
    if unread:
        raise DatasetError(unread)
    return table


def read_groups(path: Path, without: Collection[str] = ()) -> tuple[pa.Table, str]:
    """Read the row groups of a parquet file that are not damaged. A copied dataset has one group for each
    episode.

    Args:
        path: The parquet file.
        without: Columns that are left out, for example large pictures.

    Returns:
        The readable rows, and the reason why other rows cannot be read. The reason is empty if all were read.

    Raises:
        DatasetError: The file is missing, or its footer is not readable.
    """
    unread = ""
    tables = []
    with refuse_damage(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        names = [name for name in file.schema_arrow.names if name not in without]
        for group in range(file.num_row_groups):
            try:
                with refuse_damage(path):
                    tables.append(_read_group(file, group, names))
            except DatasetError as damage:
                unread = unread or str(damage)
        schema = file.schema_arrow
        tables = tables or [schema.empty_table().select(names)]
        table = pa.concat_tables(tables)
        if not unread and table.num_rows != file.metadata.num_rows:
            raise ValueError(f"it has {table.num_rows} rows, but its footer states {file.metadata.num_rows}")
        return table, unread


def read_schema(path: Path) -> pa.Schema:
    """Return the columns of a parquet file. Raise ``DatasetError`` if the file is missing or damaged."""
    with refuse_damage(path), pq.ParquetFile(path) as file:
        return file.schema_arrow


def _read_group(file: pq.ParquetFile, group: int, names: list[str]) -> pa.Table:
    table = file.read_row_group(group, columns=names)
    table.validate(full=True)
    if table.num_rows != file.metadata.row_group(group).num_rows:
        raise ValueError(
            f"it has {table.num_rows} rows, but its footer states {file.metadata.row_group(group).num_rows}"
        )
    return table


def read_rows(path: Path) -> Rows:
    """Read a whole parquet file. Raise ``DatasetError`` if the file is missing or damaged."""
    table = read_table(path)
    with refuse_damage(path):
        return Rows(table.to_pylist(), dict(table.schema.metadata or {}))


def integers(table: pa.Table, name: str) -> NDArray[np.int64]:
    """Return a column of whole numbers, with -1 for a missing value. If the column is damaged, pyarrow raises
    its exceptions."""
    return np.asarray(table[name].cast(pa.int64()).fill_null(-1).to_numpy(), dtype=np.int64)


class Numbers(msgspec.Struct, frozen=True):
    """Counts for each row of a column: ``elements`` is the number of elements, ``valid`` the number of elements
    that are not null."""

    elements: NDArray[np.int64]
    valid: NDArray[np.int64]


def numbers_in(column: pa.ChunkedArray) -> Numbers | None:
    """Count the numbers in each row of a column, even in nested lists. Return None if the column does not hold
    numbers."""
    rows, row = len(column), np.arange(len(column))
    while is_list(column.type):
        row = row[pc.list_parent_indices(column).to_numpy()]
        column = pc.list_flatten(column)
    value_type = column.type
    if not (pa.types.is_integer(value_type) or pa.types.is_floating(value_type) or pa.types.is_boolean(value_type)):
        return None
    valid = pc.is_valid(column).to_numpy()
    return Numbers(np.bincount(row, minlength=rows), np.bincount(row[valid], minlength=rows))


def is_list(data_type: pa.DataType) -> bool:
    return bool(
        pa.types.is_list(data_type) or pa.types.is_large_list(data_type) or pa.types.is_fixed_size_list(data_type)
    )


def is_same(first: pa.Table, second: pa.Table) -> bool:
    """Return True if two tables have the same values. Two NaN count as equal."""
    return first.schema.equals(second.schema) and all(map(_is_same, first.columns, second.columns))


def _is_same(first: pa.ChunkedArray, second: pa.ChunkedArray) -> bool:
    if first.equals(second):
        return True
    while is_list(first.type):
        if not pc.list_value_length(first).equals(pc.list_value_length(second)):
            return False
        first, second = pc.list_flatten(first), pc.list_flatten(second)
    if not pa.types.is_floating(first.type) or not pc.is_valid(first).equals(pc.is_valid(second)):
        return False
    return np.array_equal(first.to_numpy(), second.to_numpy(), equal_nan=True)


def decode_json(data: bytes, expected: type[Decoded]) -> Decoded:
    """Decode JSON that may contain NaN and Infinity, as Python's ``json`` writes them. Raise one of
    ``JSON_DAMAGE`` for damaged data."""
    try:
        return msgspec.json.decode(data, type=expected)
    except msgspec.ValidationError:
        raise
    except msgspec.DecodeError:
        return msgspec.convert(json.loads(data), expected)


def parquet(*tables: pa.Table) -> Callable[[IO[bytes]], object]:
    """Return a function that writes tables of one schema into an open file.

    Each table becomes one row group, and each page gets a checksum. So damage of the file affects only one
    table.
    """

    def write(file: IO[bytes]) -> None:
        with pq.ParquetWriter(file, tables[0].schema, compression="snappy", write_page_checksum=True) as writer:
            for table in tables:
                writer.write_table(table.cast(tables[0].schema), row_group_size=max(1, table.num_rows))

    return write
