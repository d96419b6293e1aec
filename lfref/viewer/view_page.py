"""The refocus page of `lfref view`: one HTML file with pictures of every plane, the views, and a map of disparity.

The page loads nothing from elsewhere. It allows only the program with a given hash, so that a title or a file name
cannot add another program. Letters: `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
This module stands apart from the command, since the page is a program of its own.
"""

import base64
import hashlib
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import torch
from markupsafe import Markup
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.io import atomic, images
from lfref.report import disparity_colours
from lfref.report.refocused import Refocused

PROGRAMS = ("pictures.js", "lens.js", "controls.js")
"""Files of the page's program, in the order of execution."""
MOST_VIEW_PIXELS = 12_000_000
"""Most pixels of all views together. Larger views are made smaller, so that the page can be sent by mail."""
JPEG_QUALITY = 88
BAR_SIZE = 8, 256
"""Height and width of the colour bar in pixels."""
DISPARITY_STEPS = 65535
"""Number of steps between the least and the largest disparity."""


def write(path: Path, title: str, facts: Mapping[str, object], content: Mapping[str, Any]) -> None:
    """Write the page, all or nothing.

    Args:
        path: HTML file to write.
        title: Heading of the page.
        facts: Name -> value, shown below the picture.
        content: Content that `page_content` returns.

    Raises:
        FileError: The file cannot be written.
    """
    loaders = {"report": jinja2.PackageLoader("lfref.report", "."), "viewer": jinja2.PackageLoader("lfref.viewer", ".")}
    pages = jinja2.Environment(
        loader=jinja2.PrefixLoader(loaders),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    program = "".join((Path(__file__).parent / name).read_text(encoding="utf-8") for name in PROGRAMS)
    text = pages.get_template("viewer/view.html").render(
        title=title,
        facts=facts,
        content=content,
        program=Markup(program),
        hash=base64.b64encode(hashlib.sha256(program.encode()).digest()).decode(),
        data=Markup(_escaped(json.dumps(content, separators=(",", ":")))),
    )
    atomic.write_text(path, text.lstrip() + "\n")


def _escaped(text: str) -> str:
    """JSON that cannot end the element around it."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def page_content(methods: Mapping[str, Refocused]) -> dict[str, Any]:
    """Content of the page as plain containers.

    Args:
        methods: Method -> the light field refocused to the same planes; the first method is the first on the page.

    Returns:
        `size` [H, W]; `quantity` and `unit` of the planes' numbers, usually slopes; `slopes` (these numbers) and
        `titles` of the planes, from the least to the largest; `start`, the first plane on the page; `methods`, each
        with `name` and `planes` (pictures); `depth` with `low`, `high`, `disparity`, `confidence`, and
        `least_confidence`, that of a known disparity; `sharp` and `map` (pictures); `scale` of the map's colours with
        `low`, `high` and `bar` (a picture of them); `views` with `size`, `pictures` and `cameras` (x, y from the
        middle, in view steps).

    Raises:
        InputError: There is no method, or the methods have different planes.
    """
    if not methods:
        raise InputError("the page must show at least one method", got="none")
    first = next(iter(methods.values()))
    if any(refocused.planes != first.planes for refocused in methods.values()):
        raise InputError("all methods must be refocused to the same planes", got="others")
    slopes, confidence = (values.detach().double().cpu().numpy() for values in first.slope_and_confidence)
    ends = disparity_colours.ends(slopes, first.planes.values)
    return {
        "size": list(first.field.size),
        "quantity": first.planes.quantity,
        "unit": first.planes.unit,
        "slopes": [first.planes.values[plane] for plane in first.by_slope],
        "titles": [first.planes.titles[plane] for plane in first.by_slope],
        "methods": [
            {"name": name, "planes": [picture(refocused.encoded(refocused.shown[plane])) for plane in first.by_slope]}
            for name, refocused in methods.items()
        ],
        "start": _start([first.planes.values[plane] for plane in first.by_slope], slopes, confidence),
        "depth": _depth(slopes, confidence),
        "sharp": picture(first.encoded(first.sharp)),
        "map": picture(first.disparity_picture),
        "scale": {"low": ends[0], "high": ends[1], "bar": picture(disparity_colours.coloured(_bar(*ends), *ends))},
        "views": _views(first),
    }


def picture(image: NDArray[np.floating]) -> str:
    """An encoded image [H, W, 3] in [0, 1] as a JPEG in a data URI."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.jpg")
        images.write_parts(path, [images.Part(image)], 8, JPEG_QUALITY)
        return f"data:image/jpeg;base64,{_base64(path.read_bytes())}"


def _start(planes: Sequence[float], slopes: NDArray[np.floating], confidence: NDArray[np.floating]) -> int:
    """The plane nearest to the median slope, weighted by confidence."""
    order = slopes.ravel().argsort()
    weight = confidence.ravel()[order].cumsum()
    middle = slopes.ravel()[order][int(np.searchsorted(weight, weight[-1] / 2))]
    return int(np.abs(np.asarray(planes) - middle).argmin())


def _depth(slopes: NDArray[np.floating], confidence: NDArray[np.floating]) -> dict[str, Any]:
    low, high = float(slopes.min()), float(slopes.max())
    steps = np.rint((slopes - low) / max(high - low, 1e-9) * DISPARITY_STEPS).astype("<u2")
    return {
        "low": low,
        "high": high,
        "disparity": _base64(steps.tobytes()),
        "confidence": _base64(np.rint(255 * confidence.clip(0, 1)).astype(np.uint8).tobytes()),
        "least_confidence": round(255 * disparity_colours.LEAST_CONFIDENCE),
    }


def _bar(low: float, high: float) -> NDArray[np.float64]:
    return np.tile(np.linspace(low, high, BAR_SIZE[1]), (BAR_SIZE[0], 1))


def _views(refocused: Refocused) -> dict[str, Any]:
    field = refocused.field
    images = field.views.flatten(0, 1)
    scale = min(1.0, math.sqrt(MOST_VIEW_PIXELS / (len(images) * math.prod(field.size))))
    size = [max(1, int(scale * length)) for length in field.size] if scale < 1 else list(field.size)

    def shown(view: Tensor) -> str:
        # One view at a time: all of them may be larger than all else of the page.
        small = F.interpolate(view[None], size, mode="bilinear", antialias=True)[0] if scale < 1 else view
        return picture(refocused.encoded(small))

    positions = field.positions
    if positions is None:
        offsets = [geometry.angular_offsets(n_views) for n_views in field.grid]
        positions = torch.stack(torch.meshgrid(*offsets, indexing="ij"), -1)
    # Views without any weight are missing.
    weights = torch.ones(len(images)) if field.weight is None else field.weight.flatten(0, 1).flatten(1).amax(1)
    kept = weights.nonzero()[:, 0].tolist()
    cameras = positions.flatten(0, 1)[kept].tolist()
    return {
        "size": size,
        "pictures": [shown(images[n]) for n in kept],
        "cameras": [[round(x, 4), round(y, 4)] for y, x in cameras],
    }


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
