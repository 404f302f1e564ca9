"""Errors shown, not only counted: each landmark, area, door and edge by its name."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.documents.relations import Relations
    from hiermap_cli.evaluation.against import MapFindings
    from hiermap_cli.evaluation.consistency import Nees
    from hiermap_cli.evaluation.placed import PlacedModel
    from hiermap_cli.evaluation.relations import RelationErrors
    from hiermap_cli.mapping.model import HierarchicalModel

    Array = NDArray[np.float64]

_WORST = 10  # relations and poses that are listed


def listed_errors(
    model: HierarchicalModel,
    placed: PlacedModel,
    findings: MapFindings,
    nees: Sequence[Nees] = (),
) -> dict[str, list[dict[str, Any]]]:
    """Lists `landmarks`, `areas`, `doors` and `edges` of the key `errors`.

    `status` is "matched", "false" (in the model alone) or "missed" (in the reference alone); a
    landmark of a kind that is not looked for in the reference is "unmatched".
    """
    values = {
        id_: float(value)
        for one in nees
        for id_, value in zip(one.ids, one.values, strict=True)
        if not math.isnan(value)
    }
    return {
        "landmarks": _landmarks(model, placed, findings, values),
        "areas": _areas(findings, values),
        "doors": _doors(findings),
        "edges": _edges(findings),
    }


def _landmarks(
    model: HierarchicalModel,
    placed: PlacedModel,
    findings: MapFindings,
    nees: dict[str, float],
) -> list[dict[str, Any]]:
    corners = findings.corners
    matched: dict[str, Array] = {}
    where = dict(zip(placed.corners.ids, placed.corners.points, strict=True))
    if corners is not None:
        matched = {placed.corners.ids[i]: corners.true[j] for i, j in corners.pairs.tolist()}
    walls = _by_owner(placed, None if findings.walls is None else findings.walls.distances)
    borne_out = _by_owner(
        placed, None if findings.occupancy is None else findings.occupancy.by_segment[:, None]
    )
    out: list[dict[str, Any]] = []
    for landmark in model.landmarks:
        id_ = landmark.id
        entry: dict[str, Any] = {"id": id_, "area": landmark.area, "kind": landmark.kind}
        if id_ in matched:
            entry |= {
                "status": "matched",
                "at": where[id_].tolist(),
                "true": matched[id_].tolist(),
                "error": float(np.hypot(*(where[id_] - matched[id_]))),
            }
        elif corners is not None and id_ in where:
            entry |= {"status": "false", "at": where[id_].tolist()}
        else:
            entry["status"] = "unmatched"
        if id_ in walls:
            entry["wall_distance_max"] = float(walls[id_].max())
        if id_ in borne_out:
            entry["occupancy_agreement"] = float(borne_out[id_].mean())
        if id_ in nees:
            entry["nees"] = nees[id_]
        out.append(entry)
    if corners is not None:
        out += [{"status": "missed", "true": corners.true[j].tolist()} for j in corners.missed]
    return out


def _by_owner(placed: PlacedModel, values: Array | None) -> dict[str, Array]:
    """Values (s, k) of segments by the landmark that they belong to."""
    if values is None:
        return {}
    by_owner: dict[str, list[Array]] = {}
    for owner, row in zip(placed.owners, values, strict=True):
        by_owner.setdefault(owner, []).append(row)
    return {owner: np.array(rows) for owner, rows in by_owner.items()}


def _areas(findings: MapFindings, nees: dict[str, float]) -> list[dict[str, Any]]:
    free = dict(findings.occupancy.by_area) if findings.occupancy is not None else {}
    out: list[dict[str, Any]] = []
    areas = findings.areas
    if areas is None:
        out = [{"id": id_, "status": "unmatched", "free_agreement": f} for id_, f in free.items()]
    else:
        matches = {match.model: match for match in areas.matches}
        recalled = {one.area: one for one in areas.recalled}
        for one in areas.covered:
            entry: dict[str, Any] = {
                "id": one.area,
                "status": "matched" if one.area in matches else "false",
                "overlaps": one.other,
                "inside": one.share,
            }
            if one.area in matches:
                match = matches[one.area]
                entry |= {"reference": match.reference, "iou": match.iou}
            if one.area in free:
                entry["free_agreement"] = free[one.area]
            out.append(entry)
        hit = {match.reference for match in areas.matches}
        out += [
            {
                "reference": one.area,
                "status": "matched" if one.area in hit else "missed",
                "overlaps": one.other,
                "recalled": one.share,
            }
            for one in recalled.values()
        ]
    for entry in out:
        if entry.get("id") in nees:
            entry["nees"] = nees[entry["id"]]
    return out


def _doors(findings: MapFindings) -> list[dict[str, Any]]:
    doors = findings.doors
    if doors is None:
        return []
    return [
        *(
            {"id": m.model, "status": "matched", "reference": m.reference, "error": m.error}
            for m in doors.matches
        ),
        *({"id": id_, "status": "false"} for id_ in doors.false),
        *({"reference": id_, "status": "missed"} for id_ in doors.missed),
    ]


def _edges(findings: MapFindings) -> list[dict[str, Any]]:
    topology = findings.topology
    if topology is None:
        return []
    same = topology.same
    return [
        *(
            {"areas": list(edge), "status": status, "reference": [same.get(a) for a in edge]}
            for status, edges in (("matched", topology.right), ("false", topology.false))
            for edge in edges
        ),
        *({"reference": list(edge), "status": "missed"} for edge in topology.missed),
    ]


def worst_relations(relations: Relations, errors: RelationErrors) -> list[dict[str, Any]]:
    """The relations that are farthest off, by stamps in seconds."""
    order = np.argsort(np.where(errors.used, -errors.trans, np.inf), kind="stable")[:_WORST]
    return [
        {
            "t1": float(relations.stamps1_ns[i]) / 1e9,
            "t2": float(relations.stamps2_ns[i]) / 1e9,
            "translation": float(errors.trans[i]),
            "rotation": float(errors.rot[i]),
        }
        for i in order[errors.used[order]].tolist()
    ]
