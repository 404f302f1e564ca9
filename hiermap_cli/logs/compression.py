"""Decompression by name, of whole data and of data that a file's end cuts off."""

from __future__ import annotations

import bz2
import zlib
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pathlib import Path

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_STEP = 1 << 12
_LARGEST_MESSAGE = 1 << 30


class _Stream(Protocol):
    def decompress(self, data: bytes) -> bytes: ...


def _errors() -> tuple[type[BaseException], ...]:
    import zstandard

    # lz4 raises RuntimeError.
    return (
        zstandard.ZstdError,
        zlib.error,
        RuntimeError,
        EOFError,
        OSError,
        ValueError,
        MemoryError,
    )


DECOMPRESS_ERRORS: tuple[type[BaseException], ...] = _errors()


def decompress(name: str, data: bytes, size: int, *, cut_off: bool = False) -> bytes:
    """The `size` bytes that `data` holds, or with `cut_off` as many as can be had.

    `name` is "zstd", "lz4", "bz2", or "" and "none" for none. Raises one of DECOMPRESS_ERRORS.
    """
    if name in ("", "none"):
        return data
    if cut_off:
        return _as_far_as_possible(_stream(name), data)
    if name == "zstd":
        import zstandard

        announced = zstandard.frame_content_size(data)
        if announced not in (-1, size):
            raise ValueError(f"{announced} bytes announced where {size} should be")
        out = bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
    elif name == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        out = bytes(lz4.frame.decompress(data))
    elif name == "bz2":
        out = bz2.decompress(data)
    else:
        raise ValueError(f"unknown compression {name!r}")
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes where {size} should be")
    return out


def _stream(name: str) -> _Stream:
    if name == "zstd":
        import zstandard

        stream: _Stream = zstandard.ZstdDecompressor().decompressobj()
        return stream
    if name == "lz4":
        import lz4.frame

        frame: _Stream = lz4.frame.LZ4FrameDecompressor()
        return frame
    if name == "bz2":
        return bz2.BZ2Decompressor()
    raise ValueError(f"unknown compression {name!r}")


def _as_far_as_possible(stream: _Stream, data: bytes) -> bytes:
    out = []
    for at in range(0, len(data), _STEP):
        try:
            out.append(stream.decompress(data[at : at + _STEP]))
        except DECOMPRESS_ERRORS:
            break
    return b"".join(out)


def plain_message(data: bytes) -> bytes:
    """A message, decompressed where the recorder compressed each by itself, as rosbag2 can.

    No serialisation begins with zstd's magic number. Raises ValueError where it is damaged.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    import zstandard

    size = zstandard.frame_content_size(data)
    if not 0 <= size <= _LARGEST_MESSAGE:
        raise ValueError(f"a compressed message of {size} bytes")
    try:
        return bytes(zstandard.ZstdDecompressor().decompress(data))
    except zstandard.ZstdError as error:
        raise ValueError(f"a compressed message is damaged: {error}") from error


def unzstd_file(source: Path, target: Path, losses: list[str]) -> None:
    """Decompresses a file as far as it is intact. Raises OSError."""
    import zstandard

    stream = zstandard.ZstdDecompressor().decompressobj()
    open_frame = False
    with source.open("rb") as file, target.open("wb") as out:
        while data := file.read(1 << 16):
            while data:
                try:
                    out.write(stream.decompress(data))
                except zstandard.ZstdError as error:
                    losses.append(f"{source.name}: damaged before byte {file.tell()}: {error}")
                    return
                open_frame = not stream.eof
                data = stream.unused_data
                if stream.eof:
                    stream = zstandard.ZstdDecompressor().decompressobj()
    if open_frame:
        losses.append(f"{source.name}: the compressed file is cut off")
