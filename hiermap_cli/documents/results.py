"""The files of a run, all of formats.md, into one folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.documents import own_files
from hiermap_cli.documents.model_file import FORMAT as MODEL_FORMAT
from hiermap_cli.documents.model_file import write_model
from hiermap_cli.documents.report_file import FORMAT as REPORT_FORMAT
from hiermap_cli.documents.svg import map_svg
from hiermap_cli.documents.trajectories import write_covariances, write_tum

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.mapping.model import MapResult

MODEL = "model.json"
REPORT = "report.json"
TRAJECTORY = "trajectory.tum"
TRAJECTORY_FILTER = "trajectory_filter.tum"
TRAJECTORY_COVARIANCE = "trajectory_covariance.txt"
PICTURE = "map.svg"

RESULT = own_files.Contents(
    "an earlier result",
    (MODEL, REPORT),
    {
        MODEL: own_files.document(MODEL_FORMAT),
        REPORT: own_files.document(REPORT_FORMAT),
        TRAJECTORY: own_files.TUM,
        TRAJECTORY_FILTER: own_files.TUM,
        TRAJECTORY_COVARIANCE: own_files.COVARIANCES,
        PICTURE: own_files.PICTURE,
        own_files.EVAL: own_files.document(own_files.EVAL_FORMAT),
    },
)


def write_result(folder: Path, result: MapResult) -> None:
    """Everything but the report, which tells how long this took, into an existing folder.

    Raises:
        UnsoundValueError: a value that no document can carry: a fault of the program.
        OSError: the files cannot be written.
    """
    final, by_filter = result.trajectory, result.trajectory_filter
    with (folder / MODEL).open("wb") as model_file:
        write_model(model_file, result.model)
    with (folder / TRAJECTORY).open("w", encoding="ascii", newline="\n") as file:
        write_tum(file, final.stamps_ns, final.poses)
    if by_filter is final:
        (folder / TRAJECTORY_FILTER).write_bytes((folder / TRAJECTORY).read_bytes())
    else:
        with (folder / TRAJECTORY_FILTER).open("w", encoding="ascii", newline="\n") as file:
            write_tum(file, by_filter.stamps_ns, by_filter.poses)
    with (folder / TRAJECTORY_COVARIANCE).open("w", encoding="ascii", newline="\n") as file:
        write_covariances(file, final.stamps_ns, final.covariances)
    picture = map_svg(result.model, final)
    (folder / PICTURE).write_text(picture, encoding="utf-8", newline="\n")
