"""Pictures as data URIs. The same picture gives the same bytes."""

from __future__ import annotations

import base64
import io

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wibam_core.geometry.pixels import shrunk_image

#: Dots per inch of figures that are stored as pixels: sharp in print at their size in the report.
RASTER_DPI = 170
#: Camera images are not stored wider than this.
EXAMPLE_WIDTH_PX = 760


def svg_uri(figure: Figure) -> str:
    """A figure as SVG; its text becomes outlines, so that it looks the same everywhere."""
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "wibam", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _uri("image/svg+xml", buffer.getvalue())


def webp_uri(figure: Figure, *, quality: int = 82) -> str:
    """A figure as WebP: for figures with photographs or very many marks."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="webp", dpi=RASTER_DPI, pil_kwargs={"quality": quality, "method": 4})
    return _uri("image/webp", buffer.getvalue())


def jpeg_uri(image: NDArray[np.uint8], *, max_width_px: int = EXAMPLE_WIDTH_PX, quality: int = 84) -> str:
    """An image (H, W, 3), BGR, as JPEG, shrunk to ``max_width_px`` if it is wider."""
    done, data = cv2.imencode(".jpg", shrunk_image(image, max_width_px), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done, "OpenCV refused to encode a JPEG"
    return _uri("image/jpeg", data.tobytes())


def _uri(media_type: str, data: bytes) -> str:
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"
