"""map.svg: a plain picture of a model, for a person.

Areas in colour with their names, the segments of all landmarks, doors, the trajectory, a scale
bar. Drawn in pixels with y upwards turned into SVG's downwards; everything is placed from the
levels of the model, so that the picture shows what the documents hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.documents.checks import sound_array
from hiermap_cli.geometry.se2 import compose, rotation
from hiermap_cli.mapping.model import SegmentFeature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import DoorModel, HierarchicalModel, Trajectory

    Array = NDArray[np.float64]

# Soft fills that keep dark lines readable on them; neighbours in the list differ in hue.
_FILLS = (
    "#cfe3f5",
    "#f9dcc4",
    "#d3ecd0",
    "#ecd5ee",
    "#f7efb8",
    "#cdebe8",
    "#f5cfd4",
    "#dcdcf7",
    "#e5ddcb",
    "#d9f0b9",
    "#f3d9ec",
    "#c9dfd9",
)
_WALL = "#222222"
_DOOR = "#c2410c"
_TRACK = "#2563eb"
_FONT_SIZES = {"area": 15, "doorname": 11}
_SIZE = 1500.0  # pixels of the longer side, about
_MARGIN = 40.0
_FOOT = 50.0  # pixels below the map for scale bar and legend
_LEAST_WIDTH = 680.0  # pixels that scale bar and legend take


@dataclass(frozen=True, slots=True)
class _Canvas:
    """From metres in g to pixels: `low` (2,) is the corner of least x and y."""

    low: Array
    high: Array
    scale: float

    @property
    def width(self) -> float:
        return max(self._map_width + 2 * _MARGIN, _LEAST_WIDTH)

    @property
    def _map_width(self) -> float:
        return float(self.high[0] - self.low[0]) * self.scale

    @property
    def height(self) -> float:
        return float(self.high[1] - self.low[1]) * self.scale + 2 * _MARGIN + _FOOT

    def pixels(self, points: Array) -> Array:
        """Points (..., 2) in pixels."""
        left = 0.5 * (self.width - self._map_width)
        x = (points[..., 0] - self.low[0]) * self.scale + left
        y = (self.high[1] - points[..., 1]) * self.scale + _MARGIN
        return np.stack((x, y), axis=-1)


class _Labels:
    """Texts on the map, each with a halo; one that would lie on another moves down."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self._boxes: list[tuple[float, float, float, float]] = []

    def add(self, at: Array, text: str, kind: str) -> None:
        """`text` centred at `at`, pixels."""
        size = _FONT_SIZES[kind]
        (x, y), half = at.tolist(), 0.32 * size * len(text)
        while any(
            x - half < right and left < x + half and y - size < low and high < y
            for left, right, high, low in self._boxes
        ):
            y += 0.5 * size
        self._boxes.append((x - half, x + half, y - size, y))
        place = f'x="{x:.1f}" y="{y:.1f}">{_escaped(text)}</text>'
        # Two texts and no paint-order, which not every program that shows SVG knows.
        self.parts.append(f'<text class="{kind} halo" {place}\n<text class="{kind}" {place}')


def _escaped(text: str) -> str:
    """Text for XML; the standard library's function would load its HTTP client."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def map_svg(model: HierarchicalModel, trajectory: Trajectory) -> str:
    """The picture as SVG text.

    Raises:
        UnsoundValueError: a coordinate is not finite.
    """
    frames = {id_: sound_array(one.mean, f"area {id_}") for id_, one in model.environment.areas}
    extents = {
        area.id: _moved(frames[area.id], sound_array(area.extent, area.id).reshape(-1, 2))
        for area in model.areas
    }
    walls = _landmark_segments(model, frames)
    doors = np.array([_door_line(door) for door in model.environment.doors]).reshape(-1, 2, 2)
    track = sound_array(trajectory.poses, "the trajectory").reshape(-1, 3)[:, :2]
    canvas = _canvas([*extents.values(), walls.reshape(-1, 2), doors.reshape(-1, 2), track])
    kinds = {area.id: area.kind for area in model.areas}
    labels = _Labels()
    parts = [_head(canvas)]
    fills = _fills(extents)
    for id_ in sorted(extents, key=lambda id_: (-_size(extents[id_]), id_)):
        if len(extents[id_]) < 3:
            continue
        parts.append(_polygon(canvas.pixels(extents[id_]), fills[id_]))
        name = id_ if kinds[id_] == "unknown" else f"{id_} {kinds[id_]}"
        labels.add(canvas.pixels(_inner_point(extents[id_])), name, "area")
    parts.append(_lines(canvas.pixels(walls), "wall"))
    parts.append(_track(canvas.pixels(track)))
    parts.append(_lines(canvas.pixels(doors), "door"))
    for door, line in zip(model.environment.doors, canvas.pixels(doors), strict=True):
        labels.add(line.mean(axis=0) - (0.0, 7.0), door.id, "doorname")
    parts += labels.parts
    parts += _foot(canvas)
    return "\n".join(part for part in parts if part) + "\n</svg>\n"


def _moved(R_g_a: Array, points_a: Array) -> Array:
    """Points (m, 2) of frame a in g."""
    moved: Array = points_a @ rotation(R_g_a[2]).T + R_g_a[:2]
    return moved


def _fills(extents: dict[str, Array]) -> dict[str, str]:
    """A colour for each area: of those used before, the one whose areas are farthest away."""
    boxes: dict[str, list[Array]] = {fill: [] for fill in _FILLS}
    fills: dict[str, str] = {}
    for id_, extent in extents.items():
        if not len(extent):
            continue
        box = np.concatenate((extent.min(axis=0), -extent.max(axis=0)))

        def gap(fill: str, box: Array = box) -> float:
            if not boxes[fill]:
                return np.inf
            # Along x and y: how far one box begins behind the end of the other.
            behind = box + np.array(boxes[fill])[:, [2, 3, 0, 1]]
            apart = np.maximum(np.maximum(behind[:, :2], behind[:, 2:]), 0.0)
            return float(np.hypot(apart[:, 0], apart[:, 1]).min())

        fills[id_] = max(_FILLS, key=gap)
        boxes[fills[id_]].append(box)
    return fills


def _landmark_segments(model: HierarchicalModel, frames: dict[str, Array]) -> Array:
    """Segments of all landmarks in g, (S, 2, 2): composed from area in g and landmark in area."""
    places = {
        id_: compose(frames[area.id], estimate.mean)
        for area in model.areas
        for id_, estimate in area.landmarks
    }
    segments = [
        _moved(places[landmark.id], sound_array(feature.endpoints, landmark.id))
        for landmark in model.landmarks
        for feature in landmark.features
        if isinstance(feature, SegmentFeature)
    ]
    return np.array(segments, dtype=float).reshape(-1, 2, 2)


def _door_line(door: DoorModel) -> Array:
    """From jamb to jamb along the door frame's X axis, (2, 2)."""
    half = 0.5 * door.width
    return _moved(sound_array(door.estimate.mean, door.id), np.array([[-half, 0.0], [half, 0.0]]))


def _canvas(parts: Iterable[Array]) -> _Canvas:
    points = np.concatenate([np.zeros((1, 2)), *parts])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1.0)
    low, high = middle - half, middle + half
    return _Canvas(low, high, float(np.clip(_SIZE / (high - low).max(), 1e-3, 120.0)))


def _head(canvas: _Canvas) -> str:
    width, height = canvas.width, canvas.height
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="Helvetica, Arial, sans-serif">\n'
        "<style>\n"
        ".extent{fill-opacity:.75;stroke:#888888;stroke-width:.6}\n"
        f".wall{{fill:none;stroke:{_WALL};stroke-width:1.6;stroke-linecap:round}}\n"
        f".door{{fill:none;stroke:{_DOOR};stroke-width:5;stroke-linecap:round}}\n"
        f".track{{fill:none;stroke:{_TRACK};stroke-width:1;stroke-opacity:.65;"
        "stroke-linejoin:round}\n"
        ".bar{fill:none;stroke:#222222;stroke-width:2}\n"
        "text{text-anchor:middle}\n"
        f".area{{font-size:{_FONT_SIZES['area']}px;font-weight:bold;fill:#333333}}\n"
        f".doorname{{font-size:{_FONT_SIZES['doorname']}px;fill:{_DOOR}}}\n"
        ".halo{fill:none;stroke:#ffffff;stroke-width:3;stroke-linejoin:round;"
        "stroke-opacity:.8}\n"
        ".foot{font-size:13px;fill:#222222;text-anchor:start}\n"
        "</style>\n"
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>'
    )


def _polygon(points: Array, fill: str) -> str:
    return f'<polygon class="extent" fill="{fill}" points="{_text(points)}"/>'


def _text(points: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())


def _lines(segments: Array, kind: str) -> str:
    """All segments (S, 2, 2) as one path."""
    if not len(segments):
        return ""
    rows = segments.reshape(-1, 4).tolist()
    path = "".join(f"M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" for x1, y1, x2, y2 in rows)
    return f'<path class="{kind}" d="{path}"/>'


def _track(points: Array) -> str:
    """The trajectory, a ring at its start and a dot at its end.

    Points that no eye tells apart are left out.
    """
    if not len(points):
        return ""
    cells = np.round(points / 1.5)
    moved = np.flatnonzero((np.diff(cells, axis=0) != 0.0).any(axis=1)) + 1
    kept = points[np.unique(np.concatenate(([0], moved, [len(points) - 1])))]
    (x1, y1), (x2, y2) = points[0].tolist(), points[-1].tolist()
    return (
        f'<polyline class="track" points="{_text(kept)}"/>\n'
        f'<circle cx="{x1:.1f}" cy="{y1:.1f}" r="5" fill="#ffffff" stroke="{_TRACK}" '
        'stroke-width="2"/>\n'
        f'<circle cx="{x2:.1f}" cy="{y2:.1f}" r="4" fill="{_TRACK}"/>'
    )


def _size(polygon: Array) -> float:
    """Area of a polygon (m, 2), by the shoelace formula."""
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def _inner_point(polygon: Array) -> Array:
    """The point of a grid inside the polygon that is farthest from its edges: a label's place."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    steps = (np.arange(24) + 0.5) / 24
    x, y = np.meshgrid(low[0] + steps * (high[0] - low[0]), low[1] + steps * (high[1] - low[1]))
    grid = np.column_stack((x.ravel(), y.ravel()))
    # Rows are the edges from a to b, columns the points of the grid.
    (ax, ay), (bx, by) = polygon.T[..., None], np.roll(polygon, -1, axis=0).T[..., None]
    (x, y), dx, dy = grid.T, bx - ax, by - ay
    crossing = ax + (y - ay) * dx / np.where(dy == 0.0, 1.0, dy)
    left_of = ((ay > y) != (by > y)) & (x < crossing)
    inside = np.count_nonzero(left_of, axis=0) % 2 == 1
    if not inside.any():
        middle: Array = polygon.mean(axis=0)
        return middle
    along = ((x - ax) * dx + (y - ay) * dy) / np.maximum(dx * dx + dy * dy, 1e-12)
    along = along.clip(0.0, 1.0)
    nearest = np.hypot(x - ax - along * dx, y - ay - along * dy).min(axis=0)
    best: Array = grid[int(np.argmax(np.where(inside, nearest, -1.0)))]
    return best


def _foot(canvas: _Canvas) -> list[str]:
    """Scale bar and legend."""
    metres = _round_length(0.2 * canvas.width / canvas.scale)
    y = canvas.height - 0.5 * _FOOT
    right = _MARGIN + metres * canvas.scale
    parts = [
        f'<path class="bar" d="M{_MARGIN:.1f} {y - 6:.1f}v6H{right:.1f}v-6"/>',
        f'<text class="foot" x="{right + 8:.1f}" y="{y + 3:.1f}">{metres:g} m</text>',
    ]
    x = right + 90.0
    for kind, name in (("wall", "landmarks"), ("door", "doors"), ("track", "trajectory")):
        parts.append(f'<path class="{kind}" d="M{x:.1f} {y - 1:.1f}h24"/>')
        parts.append(f'<text class="foot" x="{x + 31:.1f}" y="{y + 3:.1f}">{name}</text>')
        x += 130.0
    return parts


def _round_length(metres: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(metres))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres))
