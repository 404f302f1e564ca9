"""A model over its reference, one picture: what is right, what is false, what is missed."""

from __future__ import annotations

import base64
import io
import math
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.documents.occupancy import OccupancyGrid
    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.evaluation.against import MapFindings
    from hiermap_cli.evaluation.placed import PlacedModel

    Array = NDArray[np.float64]

_SIZE, _MARGIN, _FOOT = 1500.0, 40.0, 56.0  # pixels
_LEAST_WIDTH = 820.0  # pixels that scale bar and legend take
_RIGHT, _FALSE, _MISSED, _MODEL, _TRUE = "#15803d", "#dc2626", "#d97706", "#1d4ed8", "#6b7280"
_FAR = 0.5  # metres from every wall of the reference: drawn as false
_STYLE = f"""<style>
.t{{fill:#e5e7eb;stroke:{_TRUE};stroke-width:1}}
.tm{{fill:#fde68a;stroke:{_MISSED};stroke-width:2}}
.tw{{fill:none;stroke:{_TRUE};stroke-width:2.6;stroke-opacity:.7}}
.mr{{fill:{_RIGHT};fill-opacity:.10;stroke:{_RIGHT};stroke-width:1.6}}
.mf{{fill:{_FALSE};fill-opacity:.12;stroke:{_FALSE};stroke-width:1.6}}
.mw{{fill:none;stroke:{_MODEL};stroke-width:1.6}}
.fw{{fill:none;stroke:{_FALSE};stroke-width:2}}
.d{{fill:none;stroke-width:5;stroke-linecap:round}}
.r{{stroke:{_RIGHT}}} .f{{stroke:{_FALSE}}} .m{{stroke:{_MISSED}}} .u{{stroke:{_TRUE}}}
text{{text-anchor:middle;font-size:13px}}
.foot{{text-anchor:start}}
.bar{{fill:none;stroke:#222222;stroke-width:2}}
</style>"""


class _Canvas:
    """From metres in the reference's frame to pixels, y turned downwards."""

    def __init__(self, points: Array) -> None:
        self.low, self.high = points.min(axis=0), points.max(axis=0)
        self.scale = float(_SIZE / max(*(self.high - self.low), 1.0))
        size = (self.high - self.low) * self.scale + 2.0 * _MARGIN
        self.width, self.height = max(float(size[0]), _LEAST_WIDTH), float(size[1]) + _FOOT
        self._left = _MARGIN + 0.5 * (self.width - float(size[0]))

    def pixels(self, points: Array) -> Array:
        """Points (..., 2) in pixels."""
        x = (points[..., 0] - self.low[0]) * self.scale + self._left
        y = (self.high[1] - points[..., 1]) * self.scale + _MARGIN
        return np.stack((x, y), axis=-1)

    def lines(self, segments: Array, kind: str) -> str:
        """Segments (s, 2, 2) as one path."""
        rows = self.pixels(segments).reshape(-1, 4).tolist()
        path = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in rows)
        return f'<path class="{kind}" d="{path}"/>' if rows else ""

    def polygon(self, corners: Array, kind: str) -> str:
        """A polygon (m, 2)."""
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.pixels(corners).tolist())
        return f'<polygon class="{kind}" points="{text}"/>' if len(corners) > 2 else ""

    def dots(self, points: Array, colour: str, *, filled: bool) -> list[str]:
        """Small circles at points (n, 2)."""
        fill = colour if filled else "#ffffff"
        return [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" fill="{fill}" stroke="{colour}" '
            'stroke-width="1.4"/>'
            for x, y in self.pixels(points).reshape(-1, 2).tolist()
        ]

    def text(self, at: Array, text: str, colour: str, down: float = 0.0) -> str:
        """A text centred at a point (2,)."""
        x, y = self.pixels(at).tolist()
        return f'<text x="{x:.1f}" y="{y + down:.1f}" fill="{colour}">{escape(text)}</text>'


def overlay_svg(
    placed: PlacedModel,
    findings: MapFindings,
    reference: ReferenceMap | None,
    grid: OccupancyGrid | None = None,
) -> str:
    """The picture as SVG text; the model lies in the reference's frame."""
    canvas = _Canvas(np.concatenate([np.zeros((0, 2)), *_extent(placed, reference, grid)]))
    parts = [_head(canvas), *_of_grid(canvas, grid)]
    labels: list[str] = []
    parts += _areas(canvas, placed, findings, reference, labels)
    parts += _walls(canvas, placed, findings, reference)
    parts += _corners(canvas, placed, findings)
    parts += _doors(canvas, placed, findings, reference, labels)
    return "\n".join(part for part in (*parts, *labels, *_foot(canvas)) if part) + "\n</svg>\n"


def _extent(
    placed: PlacedModel, reference: ReferenceMap | None, grid: OccupancyGrid | None
) -> Iterable[Array]:
    yield placed.segments.reshape(-1, 2)
    yield from (area.polygon for area in placed.areas)
    if reference is not None:
        yield from (area.polygon for area in reference.areas or ())
        if reference.walls is not None:
            yield reference.walls.reshape(-1, 2)
    if grid is not None:
        yield grid.centres(grid.occupied)


def _head(canvas: _Canvas) -> str:
    width, height = canvas.width, canvas.height
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="Helvetica, Arial, sans-serif">\n'
        f'{_STYLE}\n<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>'
    )


def _of_grid(canvas: _Canvas, grid: OccupancyGrid | None) -> list[str]:
    """The cells as a picture in the picture: occupied dark, free white, unknown grey."""
    if grid is None:
        return []
    from PIL import Image

    grey = np.where(grid.occupied, 120, np.where(grid.free, 255, 225)).astype(np.uint8)
    data = io.BytesIO()
    Image.fromarray(grey[::-1]).save(data, "PNG", optimize=True)
    text = base64.b64encode(data.getvalue()).decode("ascii")
    height, width = grid.occupied.shape
    x, y = canvas.pixels(grid.origin[:2]).tolist()
    size = grid.resolution * canvas.scale
    turn = -math.degrees(grid.origin[2])
    image = (
        f'<image x="{x:.2f}" y="{y - height * size:.2f}" width="{width * size:.2f}" '
        f'height="{height * size:.2f}" transform="rotate({turn:.4f} {x:.2f} {y:.2f})" '
        f'style="image-rendering:pixelated" href="data:image/png;base64,{text}"/>'
    )
    return [image]


def _areas(
    canvas: _Canvas,
    placed: PlacedModel,
    findings: MapFindings,
    reference: ReferenceMap | None,
    labels: list[str],
) -> list[str]:
    areas = findings.areas
    matches = {} if areas is None else {match.model: match for match in areas.matches}
    hit = {match.reference for match in matches.values()}
    parts = []
    for true in (reference.areas if reference is not None else None) or ():
        lost = true.visited and true.id not in hit and areas is not None
        parts.append(canvas.polygon(true.polygon, "tm" if lost else "t"))
        colour = _MISSED if lost else _TRUE
        labels.append(canvas.text(true.polygon.mean(axis=0), true.id, colour, 16.0))
    for area in placed.areas:
        if len(area.polygon) < 3:
            continue
        right = area.id in matches or areas is None
        parts.append(canvas.polygon(area.polygon, "mr" if right else "mf"))
        labels.append(canvas.text(area.polygon.mean(axis=0), area.id, _RIGHT if right else _FALSE))
    return parts


def _walls(
    canvas: _Canvas, placed: PlacedModel, findings: MapFindings, reference: ReferenceMap | None
) -> list[str]:
    known = () if reference is None else (reference.walls, reference.furniture)
    parts = [canvas.lines(s.reshape(-1, 2, 2), "tw") for s in known if s is not None]
    far = np.zeros(len(placed.segments), dtype=bool)
    if findings.walls is not None:
        far |= (findings.walls.distances > _FAR).any(axis=1)
    if findings.occupancy is not None:
        far |= findings.occupancy.by_segment < 0.5
    return [
        *parts,
        canvas.lines(placed.segments[~far], "mw"),
        canvas.lines(placed.segments[far], "fw"),
    ]


def _corners(canvas: _Canvas, placed: PlacedModel, findings: MapFindings) -> list[str]:
    corners = findings.corners
    if corners is None:
        return []
    right = np.zeros(len(placed.corners.points), dtype=bool)
    right[corners.pairs[:, 0]] = True
    return [
        *canvas.dots(placed.corners.points[right], _RIGHT, filled=True),
        *canvas.dots(placed.corners.points[~right], _FALSE, filled=True),
        *canvas.dots(corners.true[list(corners.missed)], _MISSED, filled=False),
    ]


def _doors(
    canvas: _Canvas,
    placed: PlacedModel,
    findings: MapFindings,
    reference: ReferenceMap | None,
    labels: list[str],
) -> list[str]:
    doors = findings.doors
    missed = set() if doors is None else set(doors.missed)
    false = set() if doors is None else set(doors.false)
    parts = []
    for true in (reference.doors if reference is not None else None) or ():
        kind = "d m" if true.id in missed else "d u"
        parts.append(canvas.lines(np.array([[true.p1, true.p2]]), kind))
        if true.id in missed:
            labels.append(canvas.text(0.5 * (true.p1 + true.p2), true.id, _MISSED, -8.0))
    for door in placed.doors:
        if not door.crossed:
            continue
        colour = _FALSE if door.id in false else _RIGHT
        parts += canvas.dots(door.centre[None], colour, filled=True)
        labels.append(canvas.text(door.centre, door.id, colour, -7.0))
    return parts


def _foot(canvas: _Canvas) -> list[str]:
    """Scale bar and legend."""
    metres = 10.0 ** math.floor(math.log10(0.25 * canvas.width / canvas.scale))
    y, x = canvas.height - 24.0, _MARGIN + metres * canvas.scale
    parts = [
        f'<path class="bar" d="M{_MARGIN:.1f} {y - 6:.1f}v6H{x:.1f}v-6"/>',
        f'<text class="foot" x="{x + 8:.1f}" y="{y + 3:.1f}">{metres:g} m</text>',
    ]
    x += 70.0
    for colour, name in (
        (_TRUE, "reference"),
        (_MODEL, "walls"),
        (_RIGHT, "right"),
        (_FALSE, "false"),
        (_MISSED, "missed"),
    ):
        parts.append(f'<rect x="{x:.1f}" y="{y - 9:.1f}" width="14" height="14" fill="{colour}"/>')
        parts.append(f'<text class="foot" x="{x + 20:.1f}" y="{y + 3:.1f}">{name}</text>')
        x += 100.0
    return parts
