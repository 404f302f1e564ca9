"""From a map_server map and a room segmentation to reference.json: `hiermap reference`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pydantic_core

from hiermap_cli.documents.folder import check_files, output_file
from hiermap_cli.documents.occupancy import read_map_server
from hiermap_cli.documents.own_files import Output, document
from hiermap_cli.documents.reference import reference_document
from hiermap_cli.documents.rooms_image import read_rooms
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.errors import UsageError
from hiermap_cli.evaluation.judge import with_visits
from hiermap_cli.evaluation.rooms import reference_of_grid

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.documents.reference import ReferenceMap


def make_reference(
    map_file: Path,
    output: Path,
    *,
    rooms: Path | None = None,
    trajectory: Path | None = None,
    force: bool = False,
) -> ReferenceMap:
    """Writes the reference map of a map_server map, and gives it back.

    Raises:
        InputError: the map, the image or the trajectory cannot be used.
        UsageError: `output` exists and `force` is not given, is an input or no reference map,
            or cannot be written.
    """
    inputs = [path for path in (map_file, rooms, trajectory) if path is not None]
    check_files([Output("-o", output, document("hiermap-reference"))], inputs)
    if output.exists() and not force:
        raise UsageError(f"{output}: exists already; --force replaces it")
    grid = read_map_server(map_file)
    made = reference_of_grid(grid, None if rooms is None else read_rooms(rooms, grid))
    if trajectory is not None:
        made = with_visits(made, read_tum(trajectory).poses)
    data = pydantic_core.to_json(reference_document(made), indent=1) + b"\n"
    with output_file(output) as temporary:
        temporary.write_bytes(data)
    return made
