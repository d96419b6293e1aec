"""The site: every page is led to, every package described, nothing else published, and no other host asked.

That links lead somewhere is checked by the strict build, `make site`.
"""

import importlib.util
import logging
import re
import tomllib

import griffe
import pytest
from mkdocs.config import load_config
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import lfref
from tests.conftest import ROOT
from tests.test_docs import PAGES

HOOKS = ROOT / "site" / "website.py"


@pytest.fixture(scope="module")
def website():
    """The module of mkdocs' hooks."""
    found = importlib.util.spec_from_file_location("website", HOOKS)
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@pytest.fixture
def config(monkeypatch) -> MkDocsConfig:
    """What mkdocs.yml says."""
    monkeypatch.chdir(ROOT)
    return load_config("mkdocs.yml")


def led_to(entries) -> list[str]:
    """Pages of a part of the navigation."""
    if isinstance(entries, str):
        return [entries]
    return [page for entry in (entries.values() if isinstance(entries, dict) else entries) for page in led_to(entry)]


def test_every_page_has_one_line_in_the_navigation(config):
    written = [path.relative_to(ROOT).as_posix() for path in (*PAGES, ROOT / "CHANGELOG.md")]
    assert sorted(led_to(config.nav)) == sorted(written)


def test_every_floor_but_the_commands_has_a_page_that_is_led_to(config, website):
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    floors = {name for layer in contracts[0]["layers"] for name in layer.split(" | ")} - {"cli"}
    website.on_config(config)
    described = {name.split(".")[1] for name in re.findall(r"reference/(lfref\..*)\.md", "\n".join(led_to(config.nav)))}
    assert described == floors


def test_pages_describe_all_modules_but_private_ones(website, tmp_path, monkeypatch):
    for name in ("lfref/io/read.py", "lfref/io/_hidden.py", "lfref/cli/main.py", "lfref/errors.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.touch()
    monkeypatch.setattr(website, "ROOT", tmp_path)
    assert website.described() == ["lfref.errors", "lfref.io"]
    assert re.findall("::: (.*)", website.description("lfref.io")) == ["lfref.io", "lfref.io.read"]
    assert re.findall("::: (.*)", website.description("lfref.errors")) == ["lfref.errors"]


@pytest.mark.slow  # simulates the scene that opens the site, unless `make site` has
def test_pages_and_pictures_are_published_where_they_lie_and_scripts_are_not(config):
    published = {file.src_uri for file in config.plugins.on_files(Files([]), config=config)}
    assert {"README.md", "docs/quickstart.md", "docs/pictures/causes.png", "reference/lfref.io.md"} <= published
    assert {"living.html", "card.jpg"} <= published
    assert not [name for name in published if name.endswith(".py")]


def test_public_names_come_with_their_first_line(website):
    page = website.public_names()
    assert all(f"[`lfref.{name}`]" in page for name in lfref.__all__ if name != "__version__")
    assert "[lfref.refocus.shift.shift_and_sum.shift_and_sum]: Refocus light fields at the given slopes.\n" in page


def test_an_example_is_read_as_code(website, tmp_path):
    text = '"""Adds.\n\n    Example:\n        >>> 1 + 1\n        2\n    """'
    (tmp_path / "adding.py").write_text(f"def two():\n    {text}\n")
    read = griffe.load("adding", search_paths=[tmp_path], extensions=griffe.load_extensions(website.OneExample))
    assert [section.kind.value for section in read["two"].docstring.parse("google")] == ["text", "examples"]


@pytest.mark.parametrize(
    ("asked", "warnings"),
    [
        ('<script src="https://unpkg.com/a.js"></script>', 1),
        ('<link rel="stylesheet" href="//fonts.example/css?family=A">', 1),
        ('<a href="https://deepinv.github.io">deepinv</a>', 0),
        ('<link rel="stylesheet" href="assets/a.css"><script src="../a.js"></script>', 0),
    ],
)
def test_a_page_that_asks_another_host_is_warned_of(website, config, caplog, asked, warnings):
    page = Page("a page", File("a.md", None, config.site_dir, False), config)
    with caplog.at_level(logging.WARNING, "mkdocs"):
        website.on_post_page(asked, page, config)
    assert len(caplog.records) == warnings


@pytest.mark.parametrize(
    ("environment", "address"),
    [
        ({}, None),
        ({"LFREF_SITE": "https://lfref.example"}, "https://lfref.example/"),
        ({"GITHUB_REPOSITORY": "owner/name"}, "https://owner.github.io/name/"),
    ],
)
def test_the_site_has_the_address_that_the_environment_gives(website, config, monkeypatch, environment, address):
    for name in ("LFREF_SITE", "GITHUB_REPOSITORY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    website.on_config(config)
    assert config.site_url == address


def test_the_front_must_have_the_picture_that_the_site_replaces(website, config, caplog):
    page = Page("lfref", File("README.md", None, config.site_dir, False), config)
    text = "# lfref\n\n![A page](docs/pictures/page.webp)\n"
    with caplog.at_level(logging.WARNING, "mkdocs"):
        shown = website.on_page_markdown(text, page, config, Files([]))
        assert not caplog.records
        website.on_page_markdown("# lfref\n", page, config, Files([]))
    assert '<iframe class="living" src="living.html#embed" title=' in shown
    assert "page.webp" not in shown
    assert len(caplog.records) == 1
