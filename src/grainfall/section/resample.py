"""A section or a volume at another pixel size."""

from __future__ import annotations

import numpy as np


def resample(image: np.ndarray, pixel_size_um: float, target_um: float) -> np.ndarray | Resampled:
    """Nearest samples of an image or volume at the centres of pixels of another size.

    Parameters
    ----------
    image : ndarray or open volume
        Of what is no array in memory nothing is read before the result is indexed.
    pixel_size_um, target_um : float
        Edges of a pixel, as it is and as it is to be.
    """
    if pixel_size_um == target_um:
        return image
    resampled = Resampled(image, pixel_size_um, target_um)
    return resampled[()] if isinstance(image, np.ndarray) else resampled


def resampled_edge(n: int, pixel_size_um: float, target_um: float) -> int:
    """Whole pixels of the target size in an edge; the small allowance absorbs rounding in the ratio."""
    return int(n * pixel_size_um / target_um + 1e-9)


class Resampled:
    """A volume seen at another voxel size; what is indexed (by whole numbers and slices) is read."""

    def __init__(self, volume, pixel_size_um: float, target_um: float):
        self._volume = volume
        self.shape = tuple(resampled_edge(n, pixel_size_um, target_um) for n in volume.shape)
        # Where the ratio is even, centres lie between two pixels: always take the upper one.
        self._at = [
            np.minimum(((np.arange(edge) + 0.5) * target_um / pixel_size_um + 1e-9).astype(int), n - 1)
            for edge, n in zip(self.shape, volume.shape, strict=True)
        ]
        self.ndim = len(self.shape)

    def __getitem__(self, index) -> np.ndarray:
        index = index if isinstance(index, tuple) else (index,)
        index += (slice(None),) * (self.ndim - len(index))
        taken = [np.atleast_1d(at[one]) for at, one in zip(self._at, index, strict=True)]
        if not all(len(at) for at in taken):
            return np.empty([len(at) for at in taken], self._volume.dtype)
        read = self._volume[tuple(slice(at[0], at[-1] + 1) for at in taken)]
        found = read[np.ix_(*(at - at[0] for at in taken))]
        kept = [n for n, one in zip(found.shape, index, strict=True) if isinstance(one, slice)]
        return found.reshape(kept)
