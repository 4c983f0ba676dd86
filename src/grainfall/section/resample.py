"""A section at another pixel size."""

from __future__ import annotations

import numpy as np


def resample(image: np.ndarray, pixel_size_um: float, target_um: float) -> np.ndarray:
    """Nearest samples of an image or volume, or of an open file, at the centres of pixels of another size."""
    if pixel_size_um == target_um:
        return image
    centres = (np.arange(resampled_edge(n, pixel_size_um, target_um)) + 0.5 for n in image.shape)
    return np.asarray(image)[np.ix_(*((at * target_um / pixel_size_um).astype(int) for at in centres))]


def resampled_edge(n: int, pixel_size_um: float, target_um: float) -> int:
    """Whole pixels of the target size in an edge; the small allowance absorbs rounding in the ratio."""
    return int(n * pixel_size_um / target_um + 1e-9)
