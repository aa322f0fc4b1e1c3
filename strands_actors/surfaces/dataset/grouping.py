"""Divide episodes into files, and find the columns that all files can have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa

from strands_actors.contract.shown import shown

from .errors import DatasetError
from .layout import FileSlot
from .tables import read_schema, refuse_damage

MB = 1_000_000


def common_schema(paths: Sequence[Path]) -> pa.Schema:
    """Return the columns that all data files have, each with a type that can hold the values of every file.

    Raises:
        DatasetError: A file has other columns than the first file, or the types of a column do not fit
            together.
    """
    common = pa.schema([])
    for path in dict.fromkeys(paths):
        schema = read_schema(path)
        column = schema.get_field_index("index")
        number = pa.field("index", pa.int64())
        schema = schema.set(column, number) if column >= 0 else schema.append(number)
        if strange := sorted(set(schema.names) ^ set(common.names)) if common.names else []:
            verb = "has" if strange[0] in schema.names else "lacks"
            raise DatasetError(
                f"{path} {verb} the column {shown(strange[0])}, "
                f"unlike {paths[0]}. Give all data files the same columns"
            )
        with refuse_damage(path):
            common = pa.unify_schemas([common, schema], promote_options="permissive") if common.names else schema
    return common


def groups_of(sizes: Sequence[int], most_mb: float, kinds: Sequence[bytes] = ()) -> Iterator[list[int]]:
    """Divide a sequence of items into groups. Yield the indexes of each group.

    The items of a group follow each other, fit into one file together, and are of the same kind.
    """
    group: list[int] = []
    size = 0
    for number, more in enumerate(sizes):
        is_other = bool(kinds) and bool(group) and kinds[number] != kinds[group[0]]
        if group and (is_other or size + more > most_mb * MB):
            yield group
            group, size = [], 0
        group.append(number)
        size += more
    if group:
        yield group


def slotted(groups: Iterator[list[int]]) -> Iterator[tuple[FileSlot, list[int]]]:
    slot = FileSlot(0, 0)
    for group in groups:
        yield slot, group
        slot = slot.next
