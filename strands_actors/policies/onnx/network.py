"""A network in the ONNX format: one vector in, one array out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

MOST_BYTES = 1 << 30
"""Largest network that is read, as its file is read into memory."""
FLOAT = "tensor(float)"
FATAL = 4
"""The level of onnxruntime's log at which it writes almost nothing."""


class Network:
    """Load a network and check that it fits the manifest.

    The file is read here and given to onnxruntime as bytes. A network with weights in other files is refused.

    Args:
        path: The ``.onnx`` file.
        inputs: Number of values that it reads, by the manifest.
        rows: Number of rows that it writes.
        columns: Number of values in each row.

    Raises:
        ValueError: It cannot be read, or its inputs or outputs are not those of the manifest.
    """

    def __init__(self, path: Path, inputs: int, rows: int, columns: int) -> None:
        import numpy
        import onnxruntime

        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"onnx: {path} has more than {MOST_BYTES} bytes. Use a smaller network")
        options = onnxruntime.SessionOptions()
        # The robot's own processes need the other processors.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = FATAL  # The exception has the text of an error.
        try:
            session = onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
        # onnxruntime raises several classes, of which only ``Exception`` is a common base.
        except Exception as failure:
            raise ValueError(f"onnx: {path} is no network that onnxruntime can load: {failure}") from failure
        self._numpy, self._session, self._path = numpy, session, path
        self._shape, self._name = _input(session, path, inputs)
        self._rows, self._columns = rows, columns
        # The first computation is the slowest. It also shows the true size of the output.
        self.compute([0.0] * inputs)

    def compute(self, values: Sequence[float]) -> list[list[float]]:
        """Return the rows that the network writes for a vector.

        Raises:
            ValueError: The output has another size than the manifest states.
        """
        vector = self._numpy.asarray(values, dtype=self._numpy.float32).reshape(self._shape)
        (output,) = self._session.run(None, {self._name: vector})
        array = self._numpy.asarray(output)
        sizes = [size for size in array.shape if size != 1]
        expected = [size for size in (self._rows, self._columns) if size != 1]
        if sizes not in (expected, [self._rows * self._columns]) or array.dtype.kind != "f":
            raise ValueError(
                f"onnx: {self._path} writes {array.dtype} of shape {list(array.shape)}, and the manifest has "
                f"{self._rows} rows of {self._columns} joints. Correct the manifest"
            )
        rows: list[list[float]] = array.reshape(self._rows, self._columns).tolist()
        return rows


def _input(session: Any, path: Path, inputs: int) -> tuple[list[int], str]:
    """Return the shape and the name of the network's only input. Raise ``ValueError`` if it does not fit."""
    named, outputs = session.get_inputs(), session.get_outputs()
    if (len(named), len(outputs)) != (1, 1):
        names = ", ".join(each.name for each in (*named, *outputs))[:200]
        raise ValueError(
            f"onnx: {path} has {len(named)} inputs and {len(outputs)} outputs ({names}). Use a network with one of "
            "each; a recurrent network cannot run here"
        )
    given = named[0]
    fixed = [size for size in given.shape if isinstance(size, int) and size != 1]
    free = [size for size in given.shape if not isinstance(size, int)]
    fits = fixed == [inputs] if fixed else bool(free) or inputs == 1
    if given.type != FLOAT or not given.shape or not fits:
        raise ValueError(
            f"onnx: {path} reads {given.type} of shape {given.shape}, and the observation of the manifest has "
            f"{inputs} numbers. Correct the manifest"
        )
    return [1] * (len(given.shape) - 1) + [inputs], given.name


__all__ = ["Network"]
