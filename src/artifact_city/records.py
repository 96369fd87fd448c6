"""Records: how the town is handed to compiled code."""

import numpy as np

RGB = ("f8", (3,))


def layout(**fields: object) -> np.dtype:
    """Describe a record: each field's name with its type, or with its type and shape.

    >>> layout(height="f8", wall=RGB).names
    ('height', 'wall')
    """
    return np.dtype(
        [(name, *spec) if isinstance(spec, tuple) else (name, spec) for name, spec in fields.items()], align=True
    )


def records(dtype: np.dtype, columns: dict[str, object]) -> np.ndarray:
    """Make an array of records from one sequence per field.

    >>> made = records(layout(x="f8", wall=RGB), {"x": [1, 2], "wall": [(0, 0, 0), (1, 1, 1)]})
    >>> made["wall"][1].tolist()
    [1.0, 1.0, 1.0]
    """
    if set(columns) != set(dtype.names):
        raise ValueError(f"fields {sorted(columns)} given for a record of {sorted(dtype.names)}")
    count = len(next(iter(columns.values())))
    made = np.zeros(count, dtype=dtype)
    for name, values in columns.items():
        made[name] = np.asarray(values).reshape(count, *dtype[name].shape)
    return made


def record(dtype: np.dtype, values: dict[str, object]) -> np.ndarray:
    """Make an array of one record, which is how compiled code takes a group of plain values."""
    return records(dtype, {name: [value] for name, value in values.items()})
