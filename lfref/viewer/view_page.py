"""What the page on which people refocus holds: pictures of every plane, the views, and how far away each pixel is.

Letters: `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
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
from matplotlib import colormaps
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.io import atomic, images
from lfref.report import drawing
from lfref.report.refocused import Refocused

# PART page
# Writing the page: style, programs and pictures in one file, which asks nobody for anything.
#
# What may run in it is named by its hash, so that a title or a file name can bring in no program of its own.

PROGRAMS = ("pictures.js", "lens.js", "controls.js")
"""In the order in which they are run."""


def write(path: Path, title: str, facts: Mapping[str, object], held: Mapping[str, Any]) -> None:
    """Write the page, all or nothing.

    Args:
        path: HTML file to write.
        title: Its heading.
        facts: What the reader should know, by name.
        held: Of `content`.

    Raises:
        FileError: The disk refuses.
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
        held=held,
        program=Markup(program),
        hash=base64.b64encode(hashlib.sha256(program.encode()).digest()).decode(),
        data=Markup(_harmless(json.dumps(held, separators=(",", ":")))),
    )
    atomic.write_text(path, text.lstrip() + "\n")


def _harmless(text: str) -> str:
    """JSON that ends no element that it stands in."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


MOST_VIEW_PIXELS = 12_000_000
"""Of all views together; larger ones are made smaller, so that the page can be sent."""
QUALITY = 88
"""Of its pictures, as JPEG."""
BAR_SIZE = 8, 256
"""Height and width of the bar of a map's colours, in pixels."""
SURE, GREY = 0.1, 0.5
"""Confidence from which a click is believed and the map shows colour alone; below, it fades to this grey."""
STEPS = 65535
"""Of disparities between the least and the largest."""


def content(shown: Mapping[str, Refocused]) -> dict[str, Any]:
    """All that the page is made of, as plain containers.

    Args:
        shown: By method, the light field refocused to the same planes; the first is shown first.

    Returns:
        `size` [H, W]; `slopes` and `titles` of the planes, from the least slope to the largest; `start`, the plane that
        is shown first; `methods`, each with `name` and `planes` (pictures); `depth` with `low`, `high`, `disparity`,
        `confidence`, and `sure`, the least confidence that is believed; `sharp` and `map` (pictures); `scale` of the
        map's colours with `low`, `high` and `bar` (a picture of them); `views` with `size`, `pictures` and
        `cameras` (x, y from the middle, in view steps).

    Raises:
        InputError: There is no method, or they have other planes.
    """
    if not shown:
        raise InputError("the page must show at least one method", got="none")
    first = next(iter(shown.values()))
    if any(each.planes != first.planes for each in shown.values()):
        raise InputError("all methods must be refocused to the same planes", got="others")
    slopes, confidence = (each.detach().double().cpu().numpy() for each in first.slope_and_confidence)
    ends = _ends(slopes, first.planes.values)
    return {
        "size": list(first.field.size),
        "slopes": [first.planes.values[plane] for plane in first.by_slope],
        "titles": [first.planes.titles[plane] for plane in first.by_slope],
        "methods": [
            {"name": name, "planes": [picture(each.encoded(each.stack[plane])) for plane in first.by_slope]}
            for name, each in shown.items()
        ],
        "start": _start([first.planes.values[plane] for plane in first.by_slope], slopes, confidence),
        "depth": _depth(slopes, confidence),
        "sharp": picture(first.encoded(first.sharp)),
        "map": picture(_greyed(_coloured(slopes, *ends), confidence)),
        "scale": {"low": ends[0], "high": ends[1], "bar": picture(_coloured(_bar(*ends), *ends))},
        "views": _views(first),
    }


def picture(image: NDArray[np.floating]) -> str:
    """A picture as part of a page.

    Args:
        image: As it is shown, [H, W, 3] in [0, 1].
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.jpg")
        images.write_parts(path, [images.Part(image)], 8, QUALITY)
        return f"data:image/jpeg;base64,{_text(path.read_bytes())}"


def _start(planes: Sequence[float], slopes: NDArray[np.floating], confidence: NDArray[np.floating]) -> int:
    """The plane that is nearest to what lies in the middle of all that can be told apart."""
    order = slopes.ravel().argsort()
    say = confidence.ravel()[order].cumsum()
    middle = slopes.ravel()[order][int(np.searchsorted(say, say[-1] / 2))]
    return int(np.abs(np.asarray(planes) - middle).argmin())


def _depth(slopes: NDArray[np.floating], confidence: NDArray[np.floating]) -> dict[str, Any]:
    low, high = float(slopes.min()), float(slopes.max())
    steps = np.rint((slopes - low) / max(high - low, 1e-9) * STEPS).astype("<u2")
    sure = np.rint(255 * confidence.clip(0, 1)).astype(np.uint8)
    least = round(255 * SURE)
    return {
        "low": low,
        "high": high,
        "disparity": _text(steps.tobytes()),
        "confidence": _text(sure.tobytes()),
        "sure": least,
    }


def _ends(slopes: NDArray[np.floating], planes: Sequence[float]) -> tuple[float, float]:
    """The slopes that a map shows: the range of the planes, where slopes lie in it."""
    least, largest = float(slopes.min()), float(slopes.max())
    low, high = max(min(planes), least), min(max(planes), largest)
    return (low, high) if low < high else (least, largest)


def _coloured(slopes: NDArray[np.floating], low: float, high: float) -> NDArray[np.float64]:
    """Slopes in colour."""
    places = (slopes - low) / max(high - low, 1e-9)
    colours: NDArray[np.float64] = colormaps[drawing.MAP](places.clip(0, 1))[..., :3]
    return colours


def _greyed(colours: NDArray[np.float64], confidence: NDArray[np.floating]) -> NDArray[np.float64]:
    """Colours that fade to grey where nobody can tell."""
    share = (confidence / SURE).clip(0, 1)[..., None]
    greyed: NDArray[np.float64] = share * colours + (1 - share) * GREY
    return greyed


def _bar(low: float, high: float) -> NDArray[np.float64]:
    return np.tile(np.linspace(low, high, BAR_SIZE[1]), (BAR_SIZE[0], 1))


def _views(refocused: Refocused) -> dict[str, Any]:
    field = refocused.field
    images = field.views.flatten(0, 1)
    scale = min(1.0, math.sqrt(MOST_VIEW_PIXELS / (len(images) * math.prod(field.size))))
    if scale < 1:
        size = [max(1, int(scale * length)) for length in field.size]
        images = F.interpolate(images, size, mode="bilinear", antialias=True)
    is_there = _is_there(refocused).tolist()
    cameras = _cameras(refocused).flatten(0, 1).tolist()
    kept = [place for place, there in enumerate(is_there) if there]
    return {
        "size": list(images.shape[-2:]),
        "pictures": [picture(refocused.encoded(images[place])) for place in kept],
        "cameras": [[round(x, 4), round(y, 4)] for y, x in (cameras[place] for place in kept)],
    }


def _is_there(refocused: Refocused) -> Tensor:
    field = refocused.field
    if field.weight is None:
        return torch.ones(math.prod(field.grid), dtype=torch.bool)
    return field.weight.flatten(0, 1).flatten(1).amax(1) > 0


def _cameras(refocused: Refocused) -> Tensor:
    """(v, u) of each camera from the angular centre, in view steps, [V, U, 2]."""
    field = refocused.field
    if field.positions is not None:
        return field.positions
    rows, columns = (geometry.angular_offsets(n_views) for n_views in field.grid)
    return torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1)


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
