"""The whole job on values: scans in, the three levels and the trajectory out."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from hiermap_cli.errors import InputError
from hiermap_cli.mapping.assembly import assemble
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.repeats import Repeats

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.model import MapResult


def map_log(
    blocks: Iterable[ScanBlock], config: Config, progress: Callable[[int], None] | None = None
) -> MapResult:
    """Builds the map of a log's scans, in the order of time.

    Args:
        blocks: scans joined with odometry; gone through once. Repeated scans are left out of the
            map, and have a line of the trajectory each.
        config: of the whole run.
        progress: told the number of scans worked off, after each block, without repeated ones.

    Raises:
        InputError: there is no scan.
    """
    mounts: list[float] = []
    repeats = Repeats()
    distinct = repeats.left_out(_mounted(blocks, mounts))
    mapper, timing = run_filter(distinct, config, progress)
    if not mapper.areas:
        raise InputError("the log holds no scan to map; `hiermap inspect` shows what it holds")
    result = finish(mapper, timing, mounts[0])
    return replace(
        result,
        trajectory=repeats.restored(result.trajectory),
        trajectory_filter=repeats.restored(result.trajectory_filter),
    )


def finish(mapper: Mapper, timing: dict[str, float], laser_x: float) -> MapResult:
    """The map of what the filter has left: loops, refinement and assembly. Once for a mapper.

    Args:
        mapper: at the end of the log, with at least one area.
        timing: seconds of the stages before.
        laser_x: metres, of the laser's mount as the log has it.
    """
    begin = time.process_time()
    levels = by_filter = compose_levels(mapper)
    refined = None
    if mapper.config.refine.enabled:
        # The filter alone does not load it.
        from hiermap_cli.mapping.refinement.refine import refine

        refined = refine(mapper, by_filter)
        mapper.areas[:], levels = refined.areas, refined.levels
        mapper.crossings.places = refined.places
        mapper.events.extend(refined.loops.events)
    timing["refinement"] = time.process_time() - begin
    begin = time.process_time()
    result = assemble(mapper, by_filter, levels, laser_x, refined)
    return replace(result, timing={**timing, "assembly": time.process_time() - begin})


def _mounted(blocks: Iterable[ScanBlock], mounts: list[float]) -> Iterator[ScanBlock]:
    """The blocks as they are; the x of the first one's mount goes into `mounts`."""
    for block in blocks:
        if not mounts:
            mounts.append(block.mount.x)
        yield block
