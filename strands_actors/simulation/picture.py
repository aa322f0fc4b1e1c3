"""The picture that ``render()`` returns: an array that a notebook shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .png import encode_png


class RenderedPicture(np.ndarray[Any, np.dtype[np.uint8]]):
    """A picture as an array of shape (height, width, 3): red, green, blue, the first row on top.

    It is an ordinary array. A notebook shows it as a picture, if it is the last value of a cell.
    """

    @classmethod
    def of(cls, rgb: bytes, width: int, height: int) -> RenderedPicture:
        """Return the picture of these bytes: three for each pixel, row by row."""
        picture: NDArray[np.uint8] = np.frombuffer(rgb, np.uint8).reshape(height, width, 3).copy()
        return picture.view(cls)

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Return the result of a computation as an ordinary array or number."""
        plain = np.asarray(array)
        return plain[()] if return_scalar or plain.ndim == 0 else plain

    def _repr_png_(self) -> bytes | None:
        """Return the picture as a PNG file, for a notebook. None for an array that is no picture any more."""
        if self.dtype != np.uint8 or self.ndim != 3 or self.shape[2] != 3 or not self.size:
            return None
        return encode_png(self)
