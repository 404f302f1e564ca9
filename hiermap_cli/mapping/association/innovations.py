"""What the filter's innovations say of its covariances, kept as it runs.

A wall that is matched gives two rows (its distance and its heading), an end one. Each has an
innovation and its covariance S, and the normalised square of a single wall's or end's rows has
as its mean the number of rows where S is true, whatever the other rows of the scan are. Kept are
sums for every wall and end of every area of the filter, so that later any group of them, a
landmark or all landmarks of a kind, can be asked.

Whiteness: in a consistent filter the innovations of one wall at successive key scans are
uncorrelated; what walls have in common with themselves from scan to scan (they are no lines) or
a noise that is set too large or too small shows as a correlation of lag one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hiermap_cli.mapping.association.sighting import Matches

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

_EVERY = 128  # key scans that are summed up at one stroke
MATCHES, DEGREES, SQUARES, PAIRS, PRODUCTS = range(5)


class Innovation(NamedTuple):
    """The rows of one update, walls' (y, theta) first, then ends' x, and their covariances.

    nu: (k,) innovations. diagonal: (k,) of S. beside: (k - 1,) of S next to it.
    """

    nu: Array
    diagonal: Array
    beside: Array


class Sums(NamedTuple):
    """Sums over some walls and ends.

    matches: times that one was matched. degrees: rows. squares: normalised squares, whose mean a
    row is one where the covariances are true. pairs: of successive rows of one wall or end;
    products: sum of theirs, normalised, whose mean is zero where innovations are white.
    """

    matches: float = 0.0
    degrees: float = 0.0
    squares: float = 0.0
    pairs: float = 0.0
    products: float = 0.0

    def plus(self, other: Iterable[float]) -> Sums:
        """Both together."""
        return Sums(*(a + float(b) for a, b in zip(self, other, strict=True)))

    @property
    def nis(self) -> float:
        """Normalised innovation squared a degree of freedom; nan where there was none."""
        return self.squares / self.degrees if self.degrees else float("nan")

    @property
    def lag1(self) -> float:
        """Correlation of successive innovations; nan where there was no pair."""
        return self.products / self.pairs / self.nis if self.pairs and self.squares else np.nan


@dataclass(slots=True)
class InnovationLog:
    """Takes the innovations of each update; `sums` tells of each wall and end of an area."""

    _waiting: list[tuple[int, int, Index, Matches, Innovation]] = field(default_factory=list)
    _sums: dict[int, dict[int, Array]] = field(default_factory=dict)  # by area and uid

    def add(self, key: int, area: int, uid: Index, matches: Matches, rows: Innovation) -> None:
        """The update of key scan `key` in an area; `uid` (n,) of the area's objects before it."""
        self._waiting.append((key, area, uid, matches, rows))
        if len(self._waiting) >= _EVERY:
            self._sum_up()

    def sums(self, area: int) -> dict[int, Sums]:
        """By uid, of the walls and ends of an area that were ever matched."""
        self._sum_up()
        return {uid: Sums(*row.tolist()) for uid, row in self._sums.get(area, {}).items()}

    def _sum_up(self) -> None:
        if not self._waiting:
            return
        rows = _normalised(self._waiting)
        self._waiting.clear()
        rows = rows[np.lexsort((rows[:, 0], rows[:, 2], rows[:, 1]))]
        key, who = rows[:, 0], rows[:, 1:3]
        same = np.zeros(len(rows), dtype=bool)
        same[1:] = (who[1:] == who[:-1]).all(axis=1) & (key[1:] == key[:-1] + 1)
        new = np.ones(len(rows), dtype=bool)
        new[1:] = (who[1:] != who[:-1]).any(axis=1)
        before = np.roll(rows, 1, axis=0)
        table = np.zeros((len(rows), 5))
        table[:, MATCHES], table[:, DEGREES], table[:, SQUARES] = 1.0, rows[:, 3], rows[:, 4]
        table[:, PAIRS] = np.where(same, rows[:, 3], 0.0)
        table[:, PRODUCTS] = np.where(same, (rows[:, 5:7] * before[:, 5:7]).sum(axis=1), 0.0)
        first = np.flatnonzero(new)
        for (area, uid), total in zip(
            who[first].astype(int).tolist(), np.add.reduceat(table, first), strict=True
        ):
            sums = self._sums.setdefault(area, {})
            sums[uid] = sums[uid] + total if uid in sums else total


def _normalised(updates: list[tuple[int, int, Index, Matches, Innovation]]) -> Array:
    """A row for each wall and end matched in some updates, first all walls, (a + b, 7).

    That is key scan, area, uid, degrees, normalised square, and both innovations over their
    deviations, the second of a wall given the first, so that the two are independent.
    """
    walls = [2 * len(matches.wall) for _, _, _, matches, _ in updates]
    rows = [innovation for *_, innovation in updates]
    nu = np.concatenate([one.nu[:k] for one, k in zip(rows, walls, strict=True)])
    S = np.concatenate([one.diagonal[:k] for one, k in zip(rows, walls, strict=True)])
    S_yt = np.concatenate([one.beside[:k:2] for one, k in zip(rows, walls, strict=True)])
    x = np.concatenate([one.nu[k:] for one, k in zip(rows, walls, strict=True)])
    S_xx = np.concatenate([one.diagonal[k:] for one, k in zip(rows, walls, strict=True)])
    a = len(nu) // 2
    out = np.zeros((a + len(x), 7))
    seen = [(matches.wall, matches.end) for _, _, _, matches, _ in updates]
    for part, begin in ((0, 0), (1, a)):
        counts = [len(objects[part]) for objects in seen]
        end = begin + sum(counts)
        out[begin:end, 0] = np.repeat([key for key, *_ in updates], counts)
        out[begin:end, 1] = np.repeat([area for _, area, *_ in updates], counts)
        uids = [uid[o[part]] for (_, _, uid, _, _), o in zip(updates, seen, strict=True)]
        out[begin:end, 2] = np.concatenate(uids)
    y, t, S_yy, S_tt = nu[0::2], nu[1::2], S[0::2], S[1::2]
    out[:a, 3], out[a:, 3] = 2.0, 1.0
    out[:a, 5] = y / np.sqrt(S_yy)
    out[:a, 6] = (t - S_yt / S_yy * y) / np.sqrt(S_tt - S_yt**2 / S_yy)
    out[a:, 5] = x / np.sqrt(S_xx)
    out[:, 4] = out[:, 5] ** 2 + out[:, 6] ** 2
    return out
