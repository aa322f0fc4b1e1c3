"""Read parquet files that any program may have written or damaged.

Any defect of a file raises a ``DatasetError`` with a message of one line.
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
    """A small table as Python objects, with the metadata of its schema."""

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
        DatasetError: It is missing or damaged.
    """
    table, unread = read_groups(path, without)
    if unread:
        raise DatasetError(unread)
    return table


def read_groups(path: Path, without: Collection[str] = ()) -> tuple[pa.Table, str]:
    """Read the undamaged groups of rows. A copied dataset has one group for each episode.

    Args:
        path: The parquet file.
        without: Columns that are left out, for example large pictures.

    Returns:
        The rows, and why others cannot be read; empty if all were read.

    Raises:
        DatasetError: It is missing, or it has no readable footer.
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
            raise ValueError(f"{table.num_rows} rows, its footer counts {file.metadata.num_rows}")
        return table, unread


def read_schema(path: Path) -> pa.Schema:
    """Return the columns of a table. Raise ``DatasetError`` if it is missing or damaged."""
    with refuse_damage(path), pq.ParquetFile(path) as file:
        return file.schema_arrow


def _read_group(file: pq.ParquetFile, group: int, names: list[str]) -> pa.Table:
    table = file.read_row_group(group, columns=names)
    table.validate(full=True)
    if table.num_rows != file.metadata.row_group(group).num_rows:
        raise ValueError(f"{table.num_rows} rows, its footer counts {file.metadata.row_group(group).num_rows}")
    return table


def read_rows(path: Path) -> Rows:
    """Read a whole table. Raise ``DatasetError`` if it is missing or damaged."""
    table = read_table(path)
    with refuse_damage(path):
        return Rows(table.to_pylist(), dict(table.schema.metadata or {}))


def integers(table: pa.Table, name: str) -> NDArray[np.int64]:
    """Return a column of whole numbers, with -1 for a missing value. A damaged column raises pyarrow's
    errors."""
    return np.asarray(table[name].cast(pa.int64()).fill_null(-1).to_numpy(), dtype=np.int64)


class Numbers(msgspec.Struct, frozen=True):
    """For each row of a column, the count of its numbers and of those that are not null."""

    counted: NDArray[np.int64]
    valid: NDArray[np.int64]


def numbers_in(column: pa.ChunkedArray) -> Numbers | None:
    """Count the numbers of each row, in lists of any depth. Return None if the column holds no numbers."""
    rows, row = len(column), np.arange(len(column))
    while is_list(column.type):
        row = row[pc.list_parent_indices(column).to_numpy()]
        column = pc.list_flatten(column)
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        return None
    valid = pc.is_valid(column).to_numpy()
    return Numbers(np.bincount(row, minlength=rows), np.bincount(row[valid], minlength=rows))


def is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def is_same(one: pa.Table, other: pa.Table) -> bool:
    """Return True if two tables have the same values. Two NaN count as equal."""
    return one.schema.equals(other.schema) and all(map(_is_same, one.columns, other.columns))


def _is_same(one: pa.ChunkedArray, other: pa.ChunkedArray) -> bool:
    if one.equals(other):
        return True
    while is_list(one.type):
        if not pc.list_value_length(one).equals(pc.list_value_length(other)):
            return False
        one, other = pc.list_flatten(one), pc.list_flatten(other)
    if not pa.types.is_floating(one.type) or not pc.is_valid(one).equals(pc.is_valid(other)):
        return False
    return np.array_equal(one.to_numpy(), other.to_numpy(), equal_nan=True)


def decode_json(data: bytes, kind: type[Decoded]) -> Decoded:
    """Decode JSON as Python's ``json`` writes it, with NaN and Infinity. Raise one of ``JSON_DAMAGE``."""
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError:
        raise
    except msgspec.DecodeError:
        return msgspec.convert(json.loads(data), kind)


def parquet(*tables: pa.Table) -> Callable[[IO[bytes]], object]:
    """Return a function that writes tables of one schema into an open file.

    Each table becomes one group of rows, and each page has a checksum. Damage then costs one table only.
    """

    def write(file: IO[bytes]) -> None:
        with pq.ParquetWriter(file, tables[0].schema, compression="snappy", write_page_checksum=True) as writer:
            for table in tables:
                writer.write_table(table.cast(tables[0].schema), row_group_size=max(1, table.num_rows))

    return write
