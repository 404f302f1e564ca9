"""Room segmentation images: regions of one colour each, lying on a map of map_server."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.occupancy import read_pixels
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid


def read_rooms(path: Path, grid: OccupancyGrid) -> NDArray[np.int64]:
    """Which region each cell of the map belongs to, (H, W): 0 none, else numbered from 1.

    A region is all cells of one colour that hang together. Black parts rooms from each other, and
    what the map does not call free belongs to none.

    Raises:
        InputError: it cannot be read, is not of the map's size, or shows no region.
    """
    from scipy.ndimage import label

    pixels = read_pixels(path)[..., :3]
    if pixels.shape[:2] != grid.free.shape:
        height, width = grid.free.shape
        raise InputError(
            f"{path}: has {pixels.shape[1]} x {pixels.shape[0]} pixels, the map {width} x "
            f"{height}; a segmentation must lie on the map cell by cell"
        )
    codes = np.zeros(pixels.shape[:2], dtype=np.int64)
    for channel in range(pixels.shape[2]):
        codes = codes * 65536 + pixels[..., channel]
    codes[~grid.free] = 0
    regions = np.zeros(codes.shape, dtype=np.int64)
    count = 0
    for colour in np.unique(codes[codes > 0]).tolist():
        labels, n = label(codes == colour)
        regions[labels > 0] = labels[labels > 0] + count
        count += n
    if not count:
        raise InputError(f"{path}: shows no coloured region on free ground of the map")
    return regions
