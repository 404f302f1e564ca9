"""What must hold of every number that is written or read: finite, symmetric, semidefinite.

Semidefiniteness is judged on the correlation matrix, so that one tolerance serves metres,
radians and the large variances of components that nothing binds. A variance of zero asks for
a row of zeros: that component is exactly known (design: never factor C(V) itself).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

SYMMETRY_TOLERANCE = 1e-9  # of the geometric mean of the two variances
EIGENVALUE_TOLERANCE = 1e-8  # a correlation matrix may have an eigenvalue as low as minus this


class UnsoundValueError(ValueError):
    """A value that no document can carry: a fault of the program, never of its input."""


def covariance_fault(C: Array) -> str | None:
    """What is wrong with a covariance (n, n), or None.

    Symmetric and positive semidefinite within the tolerances above; zero rows are allowed.
    """
    C = np.asarray(C, dtype=float)
    if C.ndim != 2 or C.shape[0] != C.shape[1]:
        return f"has shape {C.shape}, which is not square"
    if not np.isfinite(C).all():
        return "has an entry that is not finite"
    variances = np.diagonal(C)
    if (variances < 0.0).any():
        return f"has the negative variance {variances.min():.3g}"
    deviations = np.sqrt(variances)
    zero = deviations == 0.0
    if C[zero].any() or C[:, zero].any():
        return "has a covariance beside a variance of zero"
    scale = np.where(zero, 1.0, deviations)
    correlations = C / scale / scale[:, None]
    asymmetry = np.abs(correlations - correlations.T).max(initial=0.0)
    if asymmetry > SYMMETRY_TOLERANCE:
        return f"is not symmetric (correlations differ by {asymmetry:.3g})"
    if not _is_definite(correlations):
        lowest = float(np.linalg.eigvalsh(0.5 * (correlations + correlations.T))[0])
        if lowest < -EIGENVALUE_TOLERANCE:
            return f"is not positive semidefinite (correlation eigenvalue {lowest:.3g})"
    return None


def first_bad_covariance(C: Array) -> tuple[int, str] | None:
    """Index and fault of the first unsound one of covariances (N, n, n), or None."""
    C = np.asarray(C, dtype=float)
    if np.isfinite(C).all():
        variances = np.diagonal(C, axis1=-2, axis2=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / np.sqrt(variances)
            scale[~np.isfinite(scale)] = 0.0
        correlations = C * scale[:, None, :] * scale[:, :, None]
        symmetric = np.abs(correlations - np.swapaxes(correlations, -1, -2)) <= SYMMETRY_TOLERANCE
        zero = scale == 0.0
        beside = (C != 0.0) & (zero[:, :, None] | zero[:, None, :])
        if symmetric.all() and not beside.any() and _is_definite(correlations):
            return None
    for index, one in enumerate(C):
        fault = covariance_fault(one)
        if fault is not None:
            return index, fault
    return None


def _is_definite(correlations: Array) -> bool:
    """Whether no eigenvalue of any of (..., n, n) lies below the tolerance, by factoring."""
    n = correlations.shape[-1]
    try:
        np.linalg.cholesky(correlations + EIGENVALUE_TOLERANCE * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


def sound_covariance(C: Array, what: str) -> Array:
    """C made exactly symmetric, for writing.

    Raises:
        UnsoundValueError: C is not a covariance; the message names it by `what`.
    """
    fault = covariance_fault(C)
    if fault is not None:
        raise UnsoundValueError(f"the covariance of {what} {fault}")
    return 0.5 * (C + C.T)


def sound_array(values: ArrayLike, what: str) -> Array:
    """The values as an array, for writing.

    Raises:
        UnsoundValueError: one of them is not finite.
    """
    array = np.asarray(values, dtype=float)
    if not np.isfinite(array).all():
        raise UnsoundValueError(f"{what} is not finite: {array.ravel()[:6].tolist()}")
    return array


def plain(value: Any, what: str) -> Any:
    """A JSON value made of plain Python ones: numpy scalars and arrays are unpacked.

    Raises:
        UnsoundValueError: a number is not finite, or a value has no JSON form.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), what)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise UnsoundValueError(f"{what} is {value}, which no JSON document can carry")
        return float(value)
    if isinstance(value, dict):
        return {str(key): plain(item, f"{what}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, f"{what}[{index}]") for index, item in enumerate(value)]
    raise UnsoundValueError(f"{what} has the type {type(value).__name__}, which JSON does not know")
