"""Logs that lie elsewhere: `s3://`, `https://` and what else fsspec knows. An extra.

A log is fetched into the worker's own folder and removed with it; nothing is kept between jobs.
Addresses may carry secrets, as user names or as a signed query: they are never shown.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

EXTRA = "pip install 'hiermap[remote]'"
_CHUNK = 1 << 20
_MISSING = (404, 410)
_HEAD_LIMIT = 30.0  # seconds
# What servers call a file's state. Each is enough, but a date, which wants the size beside it.
_TAGS = ("ETag", "etag", "checksum", "md5Hash", "content_md5", "VersionId")
_DATES = ("LastModified", "last_modified", "mtime", "updated", "created")


def is_url(log: str) -> bool:
    """Whether a log is named by an address and not by a path."""
    return "://" in log


def split_url(url: str) -> tuple[str, str]:
    """An address as `scheme://host` without secrets, and its path without the query."""
    parts = urlsplit(url)
    host = parts.netloc.rpartition("@")[2]
    return f"{parts.scheme}://{host}", unquote(parts.path).strip("/")


def shown(url: str) -> str:
    """An address for messages, without secrets."""
    head, path = split_url(url)
    return f"{head}/{path}"


def check_url(url: str) -> None:
    """Whether addresses of this kind can be read here.

    Raises:
        ValueError: they cannot; the message says what is missing.
    """
    protocol = url.partition("://")[0]
    try:
        import fsspec

        fsspec.get_filesystem_class(protocol)
    except ImportError as error:
        raise ValueError(f"{shown(url)}: {protocol}:// cannot be read: {error}; {EXTRA}") from None
    except ValueError:
        raise ValueError(f"{shown(url)}: {protocol}:// is not known; {EXTRA}") from None


def expand_url(pattern: str) -> list[str]:
    """The addresses that fit a pattern, sorted.

    Raises:
        ValueError: the place cannot be listed.
    """
    check_url(pattern)
    import fsspec

    try:
        files, path = fsspec.core.url_to_fs(pattern)
        return sorted(files.unstrip_protocol(one) for one in files.glob(path))
    except Exception as error:  # noqa: BLE001 - each service has errors of its own family
        raise ValueError(f"{shown(pattern)}: cannot be listed ({_reason(error)})") from None


def remote_state(url: str) -> dict[str, Any] | None:
    """What the server says of the file's content without sending it; None where it says nothing.

    Raises:
        InputError: the server has no such file, or cannot be asked.
    """
    with _errors(url):
        import fsspec

        files, path = fsspec.core.url_to_fs(url)
        about = files.info(path)
    size = about.get("size")
    for key in _TAGS:
        if about.get(key):
            return {"size": size, "tag": str(about[key])}
    date = next((about[key] for key in _DATES if about.get(key)), None)
    if date is None and url.startswith("http"):
        date = _last_modified(url)
    return {"size": size, "date": str(date)} if date and size is not None else None


def _last_modified(url: str) -> str | None:
    """The header of that name, which fsspec leaves out."""
    import urllib.request

    request = urllib.request.Request(url, method="HEAD")  # noqa: S310 - http or https
    try:
        with urllib.request.urlopen(request, timeout=_HEAD_LIMIT) as answer:  # noqa: S310
            date: str | None = answer.headers.get("Last-Modified")
    except (OSError, ValueError):
        return None  # it is fetched, then, and looked at
    return date


def fetch(url: str, folder: Path) -> Path:
    """The file, or all files of a folder, copied below `folder`.

    Raises:
        InputError: it cannot be fetched.
        OSError: the disk is full.
    """
    name = Path(split_url(url)[1]).name or "log"
    target = folder / name
    with _errors(url):
        import fsspec

        files, path = fsspec.core.url_to_fs(url)
        if not url.startswith("http") and files.isdir(path):
            files.get(path, str(target), recursive=True)
            return target
        source = files.open(path, "rb")
    with source:
        chunks = _chunks(url, source)
        with target.open("wb") as file:
            for chunk in chunks:
                file.write(chunk)
    return target


def _chunks(url: str, source: Any) -> Iterator[bytes]:
    """The file piece by piece; errors of the network are told from those of the disk."""
    while True:
        with _errors(url):
            chunk: bytes = source.read(_CHUNK)
        if not chunk:
            return
        yield chunk


def remove(path: Path) -> None:
    """Takes away what was fetched."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


class _errors:  # noqa: N801 - reads as a word of the language
    """Turns whatever a service raises into an InputError."""

    def __init__(self, url: str) -> None:
        self._url = url

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        cause = error.__cause__ if error is not None else None
        missing = getattr(cause, "status", None) in _MISSING
        if isinstance(error, FileNotFoundError) and isinstance(cause, Exception) and not missing:
            error = cause  # of a server that cannot be reached, fsspec says that no file is there
        if isinstance(error, FileNotFoundError):
            raise InputError(f"{shown(self._url)}: no such file") from None
        if isinstance(error, ImportError):
            raise InputError(f"{shown(self._url)}: cannot be read: {error}; {EXTRA}") from None
        if isinstance(error, Exception):
            raise InputError(f"{shown(self._url)}: cannot be fetched ({_reason(error)})") from None


def _reason(error: Exception) -> str:
    """An error in a few words, cut before an address: it may carry secrets."""
    text = " ".join(str(error).split()).partition("http")[0].strip(" (:,'\"")
    return f"{type(error).__name__}: {text[:120]}" if text else type(error).__name__
