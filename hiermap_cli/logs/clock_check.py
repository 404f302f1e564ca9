"""Whether the clock of the headers agrees with the recorder's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BATCH = 4096
_APART = 1.0  # seconds between the two clocks that are worth a word
_SPREAD = 0.5  # seconds by which their difference may vary


class ClockCheck:
    """Watches (header - recorder) of the scans, in constant memory."""

    def __init__(self, *, one_epoch: bool) -> None:
        """`one_epoch`: the format's two stamps are meant to be of one clock."""
        self._one_epoch = one_epoch
        self._batch: list[int] = []
        self._bounds: tuple[int, int] | None = None
        self._first: int | None = None

    def add(self, header_ns: int, log_ns: int) -> None:
        """The next scan."""
        self._batch.append(header_ns - log_ns)
        if len(self._batch) >= _BATCH:
            self._flush()

    def _flush(self) -> None:
        if not self._batch:
            return
        late: NDArray[np.int64] = np.array(self._batch, dtype=np.int64)
        self._batch = []
        if self._first is None:
            self._first = int(np.median(late[:64]))
        # Single stamps that are nonsense are another matter: the bulk is looked at.
        low, high = (int(value) for value in np.percentile(late, (2.0, 98.0)))
        if self._bounds is not None:
            low, high = min(low, self._bounds[0]), max(high, self._bounds[1])
        self._bounds = low, high

    def warnings(self) -> list[str]:
        """What a person should know."""
        self._flush()
        if self._first is None or self._bounds is None:
            return []
        out = []
        apart = 1e-9 * abs(self._first)
        if self._one_epoch and apart > _APART:
            side = "behind" if self._first < 0 else "ahead of"
            out.append(f"header stamps are {apart:.1f} s {side} the recorder's clock")
        spread = 1e-9 * (self._bounds[1] - self._bounds[0])
        if spread > _SPREAD:
            out.append(
                f"header stamps and the recorder's clock drift apart by {spread:.1f} s in the log"
            )
        return out
