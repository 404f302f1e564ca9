"""Maps of ROS map_server: a YAML file that names an image of occupied, free and unknown cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from hiermap_cli.configfile import read_yaml
from hiermap_cli.documents.shapes import Finite, Shape
from hiermap_cli.errors import ConfigurationError, InputError
from hiermap_cli.geometry.se2 import rotation

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

# What map_saver writes for unknown; many maps come with a free_thresh by which it would be free.
_UNKNOWN = 205 / 255
MAX_PIXELS = 200_000_000


class MapServerShape(Shape):
    """The YAML file of a map_server map; further keys are left alone."""

    image: str
    resolution: Annotated[Finite, Field(gt=0)]
    origin: Annotated[list[Finite], Field(min_length=2, max_length=3)]
    negate: bool | int = 0
    occupied_thresh: Annotated[Finite, Field(ge=0, le=1)] = 0.65
    free_thresh: Annotated[Finite, Field(ge=0, le=1)] = 0.25
    mode: Literal["trinary", "scale", "raw"] = "trinary"


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """Cells in rows from below to above (y) and columns from left to right (x).

    occupied, free: (H, W); a cell that is neither is unknown. resolution: metres a cell.
    origin: (3,) pose of the lower left corner of cell [0, 0] in the map's frame.
    """

    occupied: Mask
    free: Mask
    resolution: float
    origin: Array

    def centres(self, cells: Mask) -> Array:
        """Centres (n, 2) in the map's frame of the cells where (H, W) `cells` is True."""
        rows, columns = np.nonzero(cells)
        inside = (np.column_stack((columns, rows)) + 0.5) * self.resolution
        return np.asarray(inside @ rotation(self.origin[2]).T + self.origin[:2])

    def to_map(self, corners: Array) -> Array:
        """Points (..., 2) given in cells, x first, in the map's frame."""
        moved = corners * self.resolution @ rotation(self.origin[2]).T + self.origin[:2]
        return np.asarray(moved)

    def cells(self, points: Array) -> tuple[NDArray[np.int64], Mask]:
        """Cells (n, 2) as row and column of points (n, 2) in the map's frame, and which exist."""
        inside = (points - self.origin[:2]) @ rotation(self.origin[2]) / self.resolution
        at = np.floor(inside[:, ::-1]).astype(np.int64)
        return at, np.asarray(((at >= 0) & (at < self.occupied.shape)).all(axis=1))


def read_map_server(path: Path) -> OccupancyGrid:
    """The map of a map_server YAML file and its image.

    Raises:
        InputError: the file or its image cannot be read, or does not hold together.
    """
    try:
        said = read_yaml(path, MapServerShape)
    except ConfigurationError as error:
        raise InputError(f"{path}: no map of map_server: {'; '.join(error.faults)}") from None
    if said.free_thresh >= said.occupied_thresh and said.mode != "scale":
        raise InputError(
            f"{path}: free_thresh ({said.free_thresh:g}) is not below occupied_thresh "
            f"({said.occupied_thresh:g})"
        )
    grey = read_grey(path.parent / said.image)
    if said.mode == "raw":
        percent = np.round(grey * 255.0)
        share, known = percent / 100.0, percent <= 100.0
    else:
        share, known = (grey if said.negate else 1.0 - grey), grey != _UNKNOWN
    occupied = known & (share > said.occupied_thresh)
    free = known & (share < said.free_thresh)
    if not occupied.any():
        raise InputError(f"{path}: {said.image} has no occupied cell; check negate and thresholds")
    origin = np.array([*said.origin, 0.0][:3])
    return OccupancyGrid(occupied, free, said.resolution, origin)


def read_grey(path: Path) -> Array:
    """An image as grey values from 0 to 1, (H, W), its rows from below to above.

    Raises:
        InputError: it cannot be read.
    """
    pixels = read_pixels(path).astype(float)
    most = 65535.0 if pixels.max(initial=0.0) > 255.0 else 255.0
    grey = pixels[..., : 3 if pixels.shape[2] > 2 else 1].mean(axis=2) / most
    return np.asarray(grey)


def read_pixels(path: Path) -> NDArray[np.int64]:
    """The pixels of an image, (H, W, channels), its rows from below to above.

    Raises:
        InputError: it cannot be read.
    """
    import warnings

    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # the limit below is ours, and no warning
    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("ignore")
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise InputError(f"{path}: has {width} x {height} pixels; too large for a map")
            plain = image.convert("RGB") if image.mode in ("P", "PA", "CMYK", "1") else image
            pixels = np.asarray(plain).astype(np.int64)
    except FileNotFoundError:
        raise InputError(f"{path}: no such image") from None
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from None
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    return np.ascontiguousarray(pixels[::-1])
