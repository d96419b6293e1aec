"""The pages keep their word: pictures and pages that they link exist, code runs as written, pictures can be drawn."""

import json
import re
import shlex
import subprocess
import sys

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from PIL import Image

from lfref.cli import config, main
from tests.conftest import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = re.compile(r"^```.*?^```$|^ {4,}.*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!\.\./\.\./actions/)([^)#:]*)(?:#([^)]*))?\)")  # not those to pages of GitHub
REFOCUSING, SIMULATOR = (ROOT / "docs" / f"{name}.md" for name in ("refocusing", "simulator"))
LARGEST, LARGEST_FILM = 120_000, 2_000_000  # bytes of a picture, of the README's film
PLOTS = {"accuracy_time.png": "bench", "causes.png": "causes", "stability.png": "stability"}
"""What is drawn from tables that runs have left."""
GALLERY = {path.name for path in (ROOT / "docs" / "pictures").glob("gallery_*.jpg")}
OF_OTHERS = {"refnet_capture.jpg", "page.jpg", "page.webp", "paper_scatter.png"} | GALLERY
"""What other scripts draw, of a capture, a browser or trained networks."""


def anchors(text: str) -> set[str]:
    """Names by which the headings of a page can be linked, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_what_a_page_links_exists(page):
    text = page.read_text("utf-8")
    for path, anchor in LINK.findall(CODE.sub("", text)):
        target = page.parent / path if path else page
        assert target.exists(), path
        assert not anchor or anchor in anchors(target.read_text("utf-8")), anchor


def test_pictures_are_small_and_each_is_shown():
    pictures = [path for path in (ROOT / "docs" / "pictures").iterdir() if path.suffix in (".png", ".jpg")]
    shown = "".join(page.read_text("utf-8") for page in PAGES)
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size <= LARGEST, picture.name
        assert f"pictures/{picture.name})" in shown, picture.name


def test_the_first_picture_of_the_readme_is_a_short_film():
    first = re.findall(r"!\[[^\]]+\]\((docs/[^)]+)\)", (ROOT / "README.md").read_text("utf-8"))[0]
    with Image.open(ROOT / first) as film:
        assert film.is_animated
        film.seek(film.n_frames - 1)
        assert film.n_frames >= 8
    assert (ROOT / first).stat().st_size <= LARGEST_FILM


def test_the_code_of_the_page_on_refocusing_runs_as_written():
    blocks = re.findall(r"^```python\n(.*?)^```$", REFOCUSING.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    names = {"views": torch.rand(7, 7, 3, 30, 36)}
    for block in blocks:
        exec(block, names)
        for name in ("stack", "back"):
            assert name not in names or bool(names[name].isfinite().all()), block
    assert names["stack"].dtype == torch.float32
    assert names["fine"].shape == (1, 3, 60, 72)
    assert names["gradient"].shape == (30, 36)
    assert names["back"].shape == names["views"].shape


def test_the_code_of_the_page_on_the_simulator_runs_as_written():
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```$", SIMULATOR.read_text("utf-8"), re.MULTILINE | re.DOTALL):
        exec(block, names)
        assert names["result"].views.shape == (7, 7, 3, 96, 144)
    assert names["result"].truth.shape == (3, 3, 96, 144)


@pytest.mark.slow
def test_all_pictures_of_the_pages_are_drawn(tmp_path):
    subprocess.run(
        [sys.executable, ROOT / "benchmarks" / "pictures.py", "--output", tmp_path], check=True, cwd=tmp_path
    )
    drawn = {path.name for path in tmp_path.iterdir()}
    linked = {name for page in PAGES for name in re.findall(r"pictures/([\w.]+)\)", page.read_text("utf-8"))}
    missing = {plot for plot, run in PLOTS.items() if not (ROOT / "runs" / "figures" / run).exists()}
    assert drawn == linked - OF_OTHERS - missing
    assert all((tmp_path / name).stat().st_size <= LARGEST for name in drawn)


def commands() -> list[str]:
    """Lines of the pages that run a command of lfref: in blocks of code, and in tables."""
    lines = []
    for page in PAGES:
        text = page.read_text("utf-8").replace("\\\n", " ")
        names = "|".join(main.COMMANDS)
        lines += re.findall(rf"^(?:srun |\$ )?(lfref (?:{names})\b[^\n]*)$", text, re.MULTILINE)
        lines += re.findall(rf"\| `(lfref (?:{names})\b[^`\n]*)` \|$", text, re.MULTILINE)
    return sorted(set(lines))


ELSEWHERE = "--config-dir", "net._target_=", "CONTRIBUTING"
"""What `tests/cli/test_experiments.py` and others run: parts of your own."""


@pytest.mark.parametrize("line", [line for line in commands() if not any(word in line for word in ELSEWHERE)])
def test_every_command_of_the_pages_is_composed(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "RUN").mkdir()
    for name, text in {"overrides": "[]", "config": "{}"}.items():
        (tmp_path / "RUN" / f"{name}.yaml").write_text(text)
    name, *words = shlex.split(line.replace(" ...", ""), comments=True)[1:]
    words = [word for word in main.rewritten(name, words) if not word.startswith("--")]
    # Of a sweep its first job.
    first = [word.split(",")[0] if parsed.is_sweep_override() else word for word, parsed in parsed_words(words)]
    with initialize_config_dir(str(config.directory()), version_base="1.3"):
        composed = compose(name, overrides=[*first, "output=out"])
    assert composed.output == "out"


def parsed_words(words):
    return zip(words, OverridesParser.create().parse_overrides(words), strict=True)


@pytest.mark.slow
def test_the_code_of_the_tour_runs_as_written(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {}
    for cell in json.loads((ROOT / "docs" / "tour.ipynb").read_text("utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert names["explained"] > 0.9
    assert names["scores"]["shift_and_sum"] > names["scores"]["mean of the views"] + 10
