"""The areas of the result, each of one or several of the filter's, with all that belongs to them.

That is the joined map, the free space and its kind, and the landmarks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import AreaMap
from hiermap_cli.mapping.areas.doors import door_drafts, door_sides, passages
from hiermap_cli.mapping.areas.duplicates import Placed, duplicates, place_draft
from hiermap_cli.mapping.areas.extents import Extent, extents
from hiermap_cli.mapping.areas.joining import JoinedArea, join
from hiermap_cli.mapping.areas.landmarks import Draft, find_landmarks, joint_covariance
from hiermap_cli.mapping.areas.walls import at_vertices, wall_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.mapping.areas.rooms import Rooms
    from hiermap_cli.mapping.levels import Levels
    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.refinement.refine import Refined

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class AreaDrafts(NamedTuple):
    """An area with the landmarks that it shows; `doors`: which of them is a portal's.

    walls: uid of the wall behind each line.
    """

    area: JoinedArea
    extent: Extent
    drafts: list[Draft]
    doors: dict[int, int]
    dropped: int
    walls: Index


class FoundArea(NamedTuple):
    """An area of the result with its landmarks.

    doors: which draft is the landmark of a portal. covariance: joint, additive, of the robot and
    the drafts. first: number of its first landmark. dropped: landmarks that were not kept. walls:
    uid of the wall behind each line that drafts are made of.
    """

    area: JoinedArea
    extent: Extent
    drafts: tuple[Draft, ...]
    doors: dict[int, int]
    covariance: Array
    first: int
    dropped: int
    walls: Index

    def id(self, draft: int) -> str:
        """The id of a landmark."""
        return f"L{self.first + draft}"

    def block(self, draft: int) -> Array:
        """Covariance (3, 3) of a landmark's pose in the area."""
        at = 3 + 3 * draft
        return self.covariance[at : at + 3, at : at + 3]


def find_areas(
    mapper: Mapper, levels: Levels, rooms: Rooms, refined: Refined | None = None
) -> list[FoundArea]:
    """The areas in the order of `rooms.parts`; landmarks are numbered through them from 1.

    refined: the solution of the whole log, of which the levels are.
    """
    every = _all_drafts(mapper, levels, rooms, refined)
    found: list[FoundArea] = []
    first = 1
    for one, twice in zip(every, _twice(levels, every, mapper.config.landmarks), strict=True):
        kept = [k for k in range(len(one.drafts)) if k not in twice]
        drafts = [one.drafts[k] for k in kept]
        found.append(
            FoundArea(
                area=one.area,
                extent=one.extent,
                drafts=tuple(drafts),
                doors={portal: kept.index(k) for portal, k in one.doors.items()},
                covariance=joint_covariance(one.area.map.V, drafts),
                first=first,
                dropped=one.dropped + len(twice),
                walls=one.walls,
            )
        )
        first += len(kept)
    return found


def _joined(
    mapper: Mapper, levels: Levels, rooms: Rooms, refined: Refined | None
) -> list[JoinedArea]:
    """The areas of `rooms`: out of the solution, or what the filter left of each put together."""
    if refined is not None:
        from hiermap_cli.mapping.areas.rejoin import joined_area

        keyscans, least = mapper.keyscans.taken(), mapper.config.landmarks.least_seen
        return [joined_area(refined, parts, keyscans, least) for parts in rooms.parts]
    maps = [
        AreaMap(V, area.features, area.next_uid)
        for V, area in zip(levels.maps, mapper.areas, strict=True)
    ]
    last_seen = {area: k for k, area in enumerate(mapper.trail.area)}
    last_seen[mapper.current] = len(mapper.trail.area)
    return [
        join(maps, rooms.portals, members, max(members, key=lambda p: last_seen.get(p, -1)))
        for members in rooms.parts
    ]


def _all_drafts(
    mapper: Mapper, levels: Levels, rooms: Rooms, refined: Refined | None
) -> list[AreaDrafts]:
    """Each area with all landmarks that it shows."""
    config = mapper.config.landmarks
    joined = _joined(mapper, levels, rooms, refined)
    where = extents(
        rooms,
        [se2.compose(a.R_0_p, se2.invert(levels.shifts[list(a.parts)])) for a in joined],
        levels.frames[[area.parts[0] for area in joined]],
        mapper.areas,
        mapper.crossings.places,
        mapper.config.areas,
        None if refined is None else rooms.bars,
    )
    every = []
    for area, extent in zip(joined, where, strict=True):
        sides = door_sides(area, rooms.portals)
        walls = wall_lines(area.map.V, area.map.features, config, passages(area, sides))
        walls = at_vertices(walls, config)
        choice = find_landmarks(walls, config)
        drafts, doors = door_drafts(area, walls, sides, choice.kept, config)
        behind = area.map.features.uid[walls.wall]
        every.append(AreaDrafts(area, extent, drafts, doors, choice.dropped, behind))
    return every


def _twice(levels: Levels, every: Sequence[AreaDrafts], config: LandmarkConfig) -> list[set[int]]:
    """Of each area the landmarks that are there once more, and better."""
    placed: list[Placed] = []
    index: list[tuple[int, int]] = []
    for i, one in enumerate(every):
        root = one.area.parts[0]
        frame = levels.frames[root]
        J = se2.additive_D_invariant(frame)
        C_frame = J @ levels.frame_covariance(root) @ J.T
        C = joint_covariance(one.area.map.V, one.drafts)
        for k, draft in enumerate(one.drafts):
            at = slice(3 + 3 * k, 6 + 3 * k)
            fixed = k in one.doors.values()
            placed.append(
                place_draft(i, draft, frame, C_frame, C[at, at], one.extent.polygon, fixed=fixed)
            )
            index.append((i, k))
    twice: list[set[int]] = [set() for _ in every]
    for j in duplicates(placed, config):
        i, k = index[j]
        twice[i].add(k)
    return twice
