"""What is true of a simulated log, beside it: truth.tum and reference.json."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pydantic_core

from hiermap_cli.documents.reference import reference_document
from hiermap_cli.documents.trajectories import write_tum

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap

TRUTH = "truth.tum"
REFERENCE = "reference.json"


def write_truth(
    folder: Path,
    stamps_ns: NDArray[np.int64],
    poses: NDArray[np.float64],
    reference: ReferenceMap,
) -> None:
    """The true trajectory, stamps (N,) and poses (N, 3), and the reference map, in one frame.

    Raises:
        UnsoundValueError: a pose is not finite: a fault of the program.
        OSError: the files cannot be written.
    """
    with (folder / TRUTH).open("w", encoding="ascii", newline="\n") as file:
        write_tum(file, stamps_ns, poses)
    document = pydantic_core.to_json(reference_document(reference), indent=1)
    (folder / REFERENCE).write_bytes(document + b"\n")
