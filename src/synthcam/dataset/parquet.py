"""Encode tables as Parquet files: the bytes that pandas writes, without pandas, which takes .2 s to load."""

import json
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray


def encode_table(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Encode columns (n,) of numbers, truth values or text as the table that `pandas.DataFrame(columns)` is."""
    kinds = {name: "U" if column.dtype.kind == "U" else column.dtype.name for name, column in columns.items()}
    schema = _make_schema(tuple(kinds.items()))
    arrays = [build_array(column, field.type) for column, field in zip(columns.values(), schema, strict=True)]
    out = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), out)
    return bytes(out.getvalue())


def build_array(column: NDArray[Any], kind: pa.DataType, *, nan_is_null: bool = True) -> pa.Array:
    """Build the array of Arrow of a column (n,), as `pyarrow.array` does, which loads pandas."""
    valid = None
    if column.dtype.kind == "U":
        texts = [text.encode() for text in column.tolist()]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int64 if kind == pa.large_string() else np.int32)
        parts: list[Any] = [ends, b"".join(texts)]
    elif column.dtype.kind == "b":
        parts = [_pack(column)]
    else:
        parts = [np.ascontiguousarray(column)]
        if nan_is_null and column.dtype.kind == "f" and (missing := np.isnan(column)).any():
            valid = pa.py_buffer(_pack(~missing))
    return pa.Array.from_buffers(kind, len(column), [valid, *map(pa.py_buffer, parts)])


def _pack(truths: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.packbits(truths, bitorder="little")


@lru_cache(maxsize=32)
def _make_schema(kinds: tuple[tuple[str, str], ...]) -> pa.Schema:
    """Make the schema of columns by their names and types in numpy, "U" for text, with the notes of pandas in it."""
    columns, fields = [], []
    for name, kind in kinds:
        text = kind == "U"
        fields.append((name, pa.large_string() if text else pa.from_numpy_dtype(kind)))
        noted = {"pandas_type": "object" if text else kind, "numpy_type": "str" if text else kind}
        columns.append({"name": name, "field_name": name, **noted, "metadata": None})
    notes: dict[str, Any] = {"index_columns": [], "column_indexes": [], "columns": columns, "attributes": {}}
    notes |= {"creator": {"library": "pyarrow", "version": pa.__version__}, "pandas_version": version("pandas")}
    return pa.schema(fields, metadata={"pandas": json.dumps(notes)})
