"""Frames to an MP4 file that plays in browsers, or to a GIF; a picture to a PNG file."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.disk import in_place

QUALITY = 7
"""imageio's scale, 0 to 10; 7 is libx264's constant rate factor 15."""
PALETTE = (
    "split[a][b];[a]palettegen=max_colors=192:stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4"
)
"""A palette made for the film, in place of GIF's own 216 colours."""
GIF_FPS = 50.0
"""1/s; browsers slow down GIFs with less than 2 hundredths of a second between frames."""
VIDEOS: dict[str, dict[str, Any]] = {
    ".mp4": {"codec": "libx264", "quality": QUALITY, "output_params": ["-movflags", "+faststart"]},
    ".gif": {"codec": "gif", "pix_fmt_out": "pal8", "output_params": ["-vf", PALETTE, "-loop", "0"]},
}
"""Options of the encoder, by the ending of the file."""
PICTURES: dict[str, dict[str, Any]] = {
    ".png": {"codec": "png", "pix_fmt_out": "rgb24", "output_params": ["-frames:v", "1", "-update", "1"]}
}


class NoEncoderError(RuntimeError):
    """The packages that encode video are not installed."""


def write_video(path: str | os.PathLike[str], frames: Iterable[np.ndarray], fps: float) -> Path:
    """Encodes frames as H.264, 4:2:0, or as a GIF, and puts the finished file in place in one move.

    An error or an interrupt leaves the path as it was. Frames are read one at a time, so a generator
    needs memory for one frame. Odd sizes lose their last row or column: 4:2:0 needs even ones.

    Args:
        path: file to write, ending in ``.mp4`` or ``.gif``; its folder must exist. An older file is replaced.
        frames: images, uint8, shape ``(height, width, 3)``, all of one shape.
        fps: frames per second [1/s]; a GIF has 50 at most, and shows every frame.

    Returns:
        The path.

    Raises:
        NoEncoderError: imageio-ffmpeg is missing.
        ValueError: the name, the rate or a frame is unusable, or there are no frames.
        OSError: the file cannot be written there.
    """
    path = Path(path)
    if path.suffix.lower() not in VIDEOS:
        raise ValueError(f"write_video needs a path that ends in {' or '.join(VIDEOS)}, got '{path}'")
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"write_video needs fps > 0, got {fps}")
    if path.suffix.lower() == ".gif":
        fps = min(fps, GIF_FPS)
    return _write(path, frames, fps, VIDEOS[path.suffix.lower()])


def write_picture(path: str | os.PathLike[str], picture: np.ndarray) -> Path:
    """Writes a picture to a PNG file, in place in one move.

    Args:
        path: file to write, ending in ``.png``; its folder must exist.
        picture: image, uint8, shape ``(height, width, 3)``.

    Raises:
        NoEncoderError: imageio-ffmpeg is missing.
        ValueError: the name or the picture is unusable.
        OSError: the file cannot be written there.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise ValueError(f"write_picture needs a path that ends in {' or '.join(PICTURES)}, got '{path}'")
    return _write(path, [picture], 1.0, PICTURES[path.suffix.lower()])


def _write(path: Path, frames: Iterable[np.ndarray], fps: float, options: dict[str, Any]) -> Path:
    """Encodes beside the path, then moves; a wrong path fails before any drawing."""
    with in_place(path) as scratch:
        _encode(scratch, frames, fps, options)
    return path


def _encode(part: Path, frames: Iterable[np.ndarray], fps: float, options: dict[str, Any]) -> None:
    """Writes frames to a file that is not in place yet, and counts what arrived in it."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise NoEncoderError(
            f"write_video needs imageio-ffmpeg, got '{error}'; install it with `pip install imageio-ffmpeg`"
        ) from error
    writer, shape, count = None, None, 0
    try:
        for count, frame in enumerate(frames, start=1):
            shape = shape or frame.shape
            _check_frame(frame, shape, count - 1)
            even = frame if options["codec"] != "libx264" else frame[: shape[0] // 2 * 2, : shape[1] // 2 * 2]
            if writer is None:
                writer = imageio_ffmpeg.write_frames(
                    part,
                    (even.shape[1], even.shape[0]),
                    fps=float(fps),
                    macro_block_size=1,
                    ffmpeg_log_level="error",  # of its warnings, a reader can act on none
                    **options,
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(even))
    except OSError as error:  # the encoder ended
        raise OSError(f"write_video needs room for '{part.parent}', got no more from ffmpeg") from error
    finally:
        if writer is not None:
            writer.close()
    if not count:
        raise ValueError("write_video needs at least one frame, got none")
    # The encoder's exit status is not reported, so a disk that filled up at the end shows only here.
    try:
        written = imageio_ffmpeg.count_frames_and_secs(part)[0]
    except RuntimeError as error:
        raise OSError(
            f"write_video needs room for '{part.parent}', got an unreadable file from ffmpeg"
        ) from error
    if written != count:
        raise OSError(
            f"write_video needs room for '{part.parent}', got {written} of {count} frames into the file"
        )


def _check_frame(frame: np.ndarray, shape: tuple[int, ...], index: int) -> None:
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or frame.shape != shape:
        raise ValueError(
            "write_video needs uint8 frames of one shape (height, width, 3), got "
            f"{frame.dtype} {frame.shape} at index {index}, first {shape}"
        )
