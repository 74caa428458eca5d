"""The site's own steps: what they write from the code, and what they refuse."""

import re

import pytest
from playground import ROOT
from pydantic import Field

from rpod_schemas.config.base import Config, Positive
from rpod_site import api, command_line, configuration, navigation, offline
from rpod_site.documents import links
from rpod_site.field_types import bounds, type_text


class Example(Config):
    """A model that no document has."""

    sizes_m: tuple[Positive, ...] = Field(default=(1.0,), min_length=1)
    """A sentence."""


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Text of each page of the configuration reference, by the name of its file."""
    folder = tmp_path_factory.mktemp("reference")
    configuration.write(folder)
    return {file.name: file.read_text("utf-8") for file in folder.glob("*.md")}


def test_every_configuration_field_has_a_type_a_sentence_and_a_row(reference):
    rows = [line for text in reference.values() for line in text.splitlines() if line.startswith("| `")]
    fields = [name for model in configuration.models() for name in model.model_fields]
    assert len(rows) == len(fields) > 0
    configured = [model for model in configuration.models() if ".config." in model.__module__]
    assert [
        (model, name) for model in configured for name in model.model_fields if not _meaning(model, name)
    ] == []


def test_the_reference_calls_required_what_a_scenario_must_have(reference):
    rows = [row.split(" | ") for row in reference["scenario.md"].splitlines()]
    defaults = {row[0].removeprefix("| "): row[2] for row in rows if len(row) > 2}
    assert {name for name, default in defaults.items() if default == "required"} == {
        "`name`", "`title`", "`target`", "`duration_s`", "`motion`", "`sensors`"
    }  # fmt: skip
    assert [row[2] for row in rows if row[0] == "| `sensors`"] == ["see meaning", "required"]


def _meaning(model, name):
    return configuration.meaning(name, model.model_fields[name])


def test_types_and_bounds_are_said_in_words():
    field = Example.model_fields["sizes_m"]
    assert type_text(field.annotation, {}) == "list of numbers"
    assert bounds(field) == "length ≥ 1, each > 0"


def test_the_api_has_a_page_for_each_package(tmp_path):
    api.write(ROOT, tmp_path)
    assert {"rpod_driver.md", "rpod_pose.md", "rpod_schemas.config.md"} <= {
        file.name for file in tmp_path.iterdir()
    }
    assert "::: rpod_driver.ports" in (tmp_path / "rpod_driver.md").read_text("utf-8")


def test_the_command_line_has_every_verb(tmp_path):
    command_line.write(tmp_path / "command-line.md")
    text = (tmp_path / "command-line.md").read_text("utf-8")
    assert {"run", "report", "replay", "campaign"} <= set(re.findall(r"^## `rpod (\w+)`", text, re.MULTILINE))


def test_a_pattern_without_a_page_is_refused(tmp_path):
    (tmp_path / "mkdocs.yml").write_text("nav: [nothing/*.md]", "utf-8")
    with pytest.raises(navigation.UnknownPageError, match="nothing"):
        navigation.write(tmp_path / "mkdocs.yml", tmp_path / "written.yml", tmp_path)


@pytest.mark.parametrize(
    "loads",
    [
        '<script src="https://example.org/a.js"></script>',
        '<link rel="stylesheet" href="//example.org/a.css">',
        '<img alt="" src=https://example.org/a.png>',
        '<script type="application/json">{"shim": "https://unpkg.com/iframe-worker@2/shim"}</script>',
    ],
)
def test_a_page_that_loads_from_a_network_is_named(tmp_path, loads):
    (tmp_path / "assets" / "javascripts").mkdir(parents=True)
    shim = tmp_path / "shim.js"
    shim.write_text("", "utf-8")
    (tmp_path / "good.html").write_text('<a href="https://example.org">a link is no load</a>', "utf-8")
    (tmp_path / "bad.html").write_text(loads, "utf-8")
    assert [page.name for page, _ in offline.make(tmp_path, shim)] == ["bad.html"]


def test_a_site_without_an_index_for_pages_from_a_disk_cannot_be_searched(tmp_path):
    (tmp_path / "search").mkdir()
    (tmp_path / "search" / "search_index.json").write_text("{}", "utf-8")
    assert not offline.is_searchable(tmp_path)
    (tmp_path / "search" / "search_index.js").write_text("var __index = {}", "utf-8")
    assert offline.is_searchable(tmp_path)


def test_the_shim_of_the_search_is_taken_from_beside_the_pages(tmp_path):
    (tmp_path / "assets" / "javascripts").mkdir(parents=True)
    shim, page = tmp_path / "shim.js", tmp_path / "page.html"
    shim.write_text("", "utf-8")
    page.write_text('<script>["https://unpkg.com/iframe-worker/shim"]</script>', "utf-8")
    assert offline.make(tmp_path, shim) == []
    assert '["assets/javascripts/shim.js"]' in page.read_text("utf-8")


def test_links_to_files_are_found_without_anchors_and_addresses():
    text = "[a](b.md#c) [d](https://example.org) ![e](f.png) [g](#h)\n\n| x |\n|---|\n| [i](j/) |\n"
    assert sorted(links(text)) == ["b.md", "f.png", "j/"]
