"""The refocus page of `lfref view`: one HTML file with pictures of every plane, the views, and a map of disparity.

The page loads nothing from elsewhere. It allows only the program with a given hash, so that a title or a file name
cannot add another program. The pictures of a large page are files in a folder beside it, each loaded when it is needed.
Letters: `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
"""

import base64
import hashlib
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np
import torch
from markupsafe import Markup
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.io import atomic
from lfref.io.disparity_files import Cameras
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocuser import filling
from lfref.report import pictures
from lfref.report.refocused import Refocused
from lfref.viewer import coding
from lfref.viewer.coding import LOSSLESS, Coding, Prediction, ViewQuality

PROGRAMS = ("geometry.js", "pictures.js", "lens.js", "page.js")
MOST_BYTES = 30_000_000
"""Size of the largest page that holds its pictures itself."""
FIRST = "#first"
LEAST_SEEN, MOST_CROPPED = 0.5, 0.15
"""Share of the views that see a pixel which is shown, and largest share of a side that is cropped away for it."""
CENTRAL = 0.35
"""Standard deviation of the distance from the middle of what people look at, as a share of the picture's sides."""
LEAST_MASK = 0.02
"""Weight of samples that have none, as a share of the largest. Where no view sees a pixel, the lens thereby shows what
`_views` fills the views with, which continues the scene, and no black corners."""
BAR_SIZE = 8, 256
DISPARITY_STEPS = 65535
"""Number of steps between the least and the largest disparity."""


def write(path: Path, title: str, facts: Mapping[str, object], content: Mapping[str, Any]) -> list[Path]:
    """Write the page of `page_content`; pictures beyond `MOST_BYTES` go into a folder, returned second."""
    folder = path.with_name(f"{path.stem}_pictures") if len(_json(content)) > MOST_BYTES else None
    first = content["methods"][0]["planes"][content["start"]["plane"]]
    texts: dict[str, str] = {}

    def keep_in_page(text: str) -> str:
        texts[f"text_{len(texts)}"] = text
        return f"#text_{len(texts) - 1}"

    numbers = itertools.count(1)

    def keep_in_folder(uri: str) -> str:
        # A script that hands over the picture: a page that is opened from disk may load no other files.
        address = f"{path.stem}_pictures/{next(numbers):04d}.js"
        atomic.write_text(path.parent / address, f"keep({json.dumps(address)}, {json.dumps(uri)});\n")
        return address

    placed = _placed(content, first, keep_in_page, keep_in_page if folder is None else keep_in_folder)
    program = "".join((Path(__file__).parent / name).read_text(encoding="utf-8") for name in PROGRAMS)
    _render(
        "view.html",
        path,
        title=title,
        facts=facts,
        content=content,
        first=first,
        folder=folder,
        texts=texts,
        program=Markup(program),
        hash=base64.b64encode(hashlib.sha256(program.encode()).digest()).decode(),
        data=Markup(_json(placed)),
    )
    return [path] if folder is None else [path, folder]


def _placed(
    content: Mapping[str, Any], first: str, keep_text: Callable[[str], str], keep_picture: Callable[[str], str]
) -> Any:
    """The content with addresses of its long texts and pictures, since browsers are slow to show long elements."""
    texts = {name: keep_text(content["depth"][name]) for name in ("disparity", "confidence")}

    def placed(part: Any) -> Any:
        if isinstance(part, dict):
            return {name: value if name == "bar" else placed(value) for name, value in part.items()}
        if isinstance(part, list):
            return [placed(value) for value in part]
        is_picture = isinstance(part, str) and part.startswith("data:image")
        return (FIRST if part is first else keep_picture(part)) if is_picture else part

    return placed({**content, "depth": {**content["depth"], **texts}})


class GalleryEntry(NamedTuple):
    """A page in a gallery: its address from there, and its first picture, a data URI."""

    title: str
    place: str
    picture: str


def write_gallery(path: Path, title: str, entries: Sequence[GalleryEntry]) -> None:
    """Write a page with the first picture of each of some pages, which open at a click."""
    _render("gallery.html", path, title=title, entries=entries)


def _render(template: str, path: Path, **values: object) -> None:
    loader, strict = jinja2.PackageLoader("lfref.viewer", "."), jinja2.StrictUndefined
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=strict
    )
    atomic.write_text(path, environment.get_template(template).render(values).lstrip() + "\n")


def _json(content: Mapping[str, Any]) -> str:
    """JSON that cannot end the element around it."""
    text = json.dumps(content, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def page_content(
    methods: Mapping[str, Refocused], aperture: Tensor | None = None, quality: ViewQuality | None = None
) -> dict[str, Any]:
    """Content of the page as plain containers.

    Args:
        methods: Method -> the light field refocused to the same planes; the first method is the first on the page.
        aperture: Weight of each view, >= 0, by which the methods refocus, [V, U]; None: all alike.
        quality: Of the views of the lens; None: that of a page to send by mail.

    Returns:
        `size` [H, W]; `crop`, what is shown: left, top, right, bottom as shares of the sides; `quantity` and `unit` of
        the planes' numbers, usually slopes; `slopes` (these numbers) and `titles` of the planes, from the least to the
        largest; `near`, 1 if larger numbers are nearer and -1 if smaller ones are; `dioptres`, 1 / distance in 1 /
        metres at slope 0 and its growth per slope, or None; `start` with `slope` and `plane`, the focus at first;
        `shape` of the aperture at first, as in `geometry.js`, and `aperture`, the weights of the shape `own` or None;
        `methods`, each with `name` and `planes` (pictures, without loss if there are several); `depth` with `low`,
        `high`, `disparity`, `confidence`, and `least_confidence`, that of a known disparity; `sharp` and `map`
        (pictures); `scale` of the map's colours with `low`, `high` and `bar` (a picture of them); `views` with `size`,
        `cameras` (x, y from the middle, in view steps), `reference` (index of the view that predicts the others, or
        None), `pictures` (of the views, or of their differences from what is predicted), and `masks` (pictures of the
        samples' weights, or None).
    """
    first = next(iter(methods.values()))
    slopes, confidence = (values.detach().double().cpu().numpy() for values in first.slope_and_confidence)
    near = first.near_sign
    values = [first.planes.values[plane] for plane in first.by_slope]
    looked_at = float(slopes.ravel()[int(_interest(first, near * slopes, confidence).argmax())])
    focus = min(max(looked_at, values[0]), values[-1])
    cameras = Cameras.from_metadata(first.field.metadata)
    at_zero, growth = (0.0, 0.0) if cameras is None else cameras.dioptres(first.field.size)
    middle = first.field.views[tuple(length // 2 for length in first.field.grid)]
    small = coding.smallest(first.encoded(middle)).coding
    encode = small.uri if len(methods) == 1 else LOSSLESS.uri
    ends = pictures.colour_ends(slopes, first.planes.values)
    bar = np.tile(np.linspace(*ends, BAR_SIZE[1]), (BAR_SIZE[0], 1))
    low, high = float(slopes.min()), float(slopes.max())
    steps = np.rint((slopes - low) / max(high - low, 1e-9) * DISPARITY_STEPS).astype("<u2")
    return {
        "size": list(first.field.size),
        "quantity": first.planes.quantity,
        "unit": first.planes.unit,
        "crop": _crop(first.field),
        "slopes": values,
        "near": near,
        "dioptres": None if cameras is None else [at_zero, near * growth],
        "shape": "square" if aperture is None else "own",
        "aperture": None if aperture is None else (aperture / aperture.max()).double().round(decimals=4).tolist(),
        "titles": [first.planes.titles[plane] for plane in first.by_slope],
        "methods": [
            {"name": name, "planes": [encode(refocused.encoded(refocused.shown[plane])) for plane in first.by_slope]}
            for name, refocused in methods.items()
        ],
        "start": {"slope": round(focus, 4), "plane": int(np.abs(np.asarray(values) - focus).argmin())},
        "depth": {
            "low": low,
            "high": high,
            "disparity": base64.b64encode(steps.tobytes()).decode("ascii"),
            "confidence": base64.b64encode(np.rint(255 * confidence.clip(0, 1)).astype(np.uint8)).decode("ascii"),
            "least_confidence": round(255 * pictures.LEAST_CONFIDENCE),
        },
        "sharp": small.uri(first.encoded(first.sharp)),
        "map": small.uri(first.disparity_picture),
        "scale": {"low": ends[0], "high": ends[1], "bar": LOSSLESS.uri(pictures.coloured(bar, *ends))},
        "views": _views(first, slopes, small, quality or ViewQuality()),
    }


def _interest(refocused: Refocused, nearness: NDArray[np.floating], confidence: NDArray[np.floating]) -> Tensor:
    """How much each pixel is what people look at, [H, W]: central, near, and of known disparity, hence textured."""
    height, width = refocused.field.size
    y, x = (torch.linspace(-0.5, 0.5, length, dtype=torch.float64) for length in (height, width))
    central = torch.exp(-(y[:, None].square() + x.square()) / (2 * CENTRAL**2))
    low, high = np.quantile(nearness, (0.02, 0.98))
    near = torch.from_numpy(((nearness - low) / max(high - low, 1e-9)).clip(0, 1))
    return central * (0.5 + near) * torch.from_numpy(confidence)


def _crop(field: LightField) -> list[float]:
    """Left, top, right and bottom of the largest part, in the middle, whose corners are seen by most views."""
    whole = [0.0, 0.0, 1.0, 1.0]
    if field.weight is None or filling.view_weights(field.weight) is not None:
        return whole
    is_seen = filling.trusted(field.weight).double().mean((0, 1, 2)) >= LEAST_SEEN
    height, width = field.size
    for percent in range(int(100 * MOST_CROPPED) + 1):
        top, left = round(percent / 100 * height), round(percent / 100 * width)
        if bool(is_seen[[top, top, -1 - top, -1 - top], [left, -1 - left, left, -1 - left]].all()):
            return [left / width, top / height, 1 - left / width, 1 - top / height]
    return whole


def _views(
    refocused: Refocused, disparity: NDArray[np.floating], first: Coding, quality: ViewQuality
) -> dict[str, Any]:
    field = refocused.field
    views = field.views.flatten(0, 1)
    scale = min(1.0, math.sqrt(quality.most_pixels / (len(views) * math.prod(field.size))))
    size = [max(1, int(scale * length)) for length in field.size] if scale < 1 else list(field.size)

    def smaller(image: Tensor) -> Tensor:
        return F.interpolate(image[None], size, mode="bilinear", antialias=True)[0] if scale < 1 else image

    positions = batches.even(field.grid) if field.positions is None else field.positions
    # Views without any weight are missing.
    weights = torch.ones(len(views)) if field.weight is None else field.weight.flatten(0, 1).flatten(1).amax(1)
    kept = weights.nonzero()[:, 0].tolist()
    has_masks = field.weight is not None and filling.view_weights(field.weight) is None
    places = [[round(x, 4), round(y, 4)] for y, x in positions.flatten(0, 1)[kept].tolist()]

    # One view at a time: all of them may be larger than all else of the page.
    def shown(k: int) -> NDArray[np.float32]:
        view = views[kept[k]]
        if field.weight is not None and has_masks:
            # Samples without weight would darken those beside them.
            share = (field.weight.flatten(0, 1)[kept[k]] / weights[kept[k]]).to(view).clamp(0, 1)
            view = torch.lerp(refocused.mean, view, share)
        return refocused.encoded(smaller(view))

    def mask(n: int) -> str:
        assert field.weight is not None
        share = smaller(field.weight.flatten(0, 1)[n] / weights.amax()).clamp(min=LEAST_MASK)
        return LOSSLESS.uri(share.permute(1, 2, 0).float().numpy())

    reference, coded = _coded_views(places, shown, disparity, first, quality.least_db)
    return {
        "size": size,
        "pictures": coded,
        "reference": reference,
        "masks": [mask(n) for n in kept] if has_masks else None,
        "cameras": places,
    }


def _coded_views(
    cameras: Sequence[Sequence[float]],
    shown: Callable[[int], NDArray[np.float32]],
    disparity: NDArray[np.floating],
    first: Coding,
    least_db: float | None,
) -> tuple[int | None, list[str]]:
    """The view that predicts the others, None where that saves nothing, and the pictures that are kept of all views."""
    if least_db is None:
        return None, [LOSSLESS.uri(shown(k)) for k in range(len(cameras))]
    distances = [math.hypot(*camera) for camera in cameras]
    reference, far = (int(choose(distances)) for choose in (np.argmin, np.argmax))
    whole = coding.at_least(least_db + coding.BETTER_DB, shown(reference), first)
    prediction = Prediction(whole.shown, cameras[reference], disparity)
    plain = coding.at_least(least_db, shown(far), first)
    least = coding.smallest(shown(far), prediction.view(cameras[far]), least_db)
    if far == reference or len(least.file) >= len(plain.file):
        return None, [coding.at_least(least_db, shown(k), first).uri for k in range(len(cameras))]
    coded = [
        coding.at_least(least_db, shown(k), least.coding, prediction.view(camera)).uri
        for k, camera in enumerate(cameras)
    ]
    coded[reference] = whole.uri
    return reference, coded
