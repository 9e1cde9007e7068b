"""Videos for the tracker's tests, encoded by FFmpeg."""

from fractions import Fraction

import av
import numpy as np


def encode(path, movie, codec="libx264", fmt="yuv420p", rate=25, options=None, times=None, full=None):
    """Writes grey (h, w) or Y'CbCr (3 planes stacked as FFmpeg's yuv444p) frames, codes as given, at times in ticks of
    1/rate s."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options or {})
        stream.height, stream.width = movie[0].shape[-2:]
        stream.pix_fmt = fmt
        if full is not None:
            stream.codec_context.color_range = 2 if full else 1
        for k, picture in enumerate(movie):
            frame = av.VideoFrame(stream.width, stream.height, fmt)
            for plane, counts in zip(frame.planes, planes(picture, fmt), strict=True):
                rows = np.zeros((plane.height, plane.line_size // counts.itemsize), counts.dtype)
                rows[:, : plane.width] = counts
                plane.update(rows.tobytes())
            frame.pts = k if times is None else times[k]
            frame.time_base = Fraction(1, rate)
            if full is not None:
                frame.color_range = 2 if full else 1
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def planes(picture, fmt):
    """The planes of a picture: chroma of a grey one is neutral."""
    if picture.ndim == 3:
        return list(picture)
    middle = 128 * (1 if picture.dtype == np.uint8 else 2 ** (int(fmt[-4:-2]) - 8))
    halves = {"yuv420p": (2, 2), "yuvj420p": (2, 2), "yuv422p": (1, 2), "yuvj422p": (1, 2), "yuv444p": (1, 1)}
    down, across = halves.get(fmt.removesuffix("10le"), (0, 0))
    if not down:
        return [picture]
    size = -(-picture.shape[0] // down), -(-picture.shape[1] // across)
    return [picture, *[np.full(size, middle, picture.dtype)] * 2]
