import re

import pytest
from typer.testing import CliRunner

from rpod.__main__ import app
from rpod.campaign.command import campaign_command
from rpod_campaign.catalogue import BUILT_IN, RENAMED, find, names, options_of


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("lidar-acquisition", {"ranges": "20,-3"}, "--ranges: "),
        ("lidar-acquisition", {"ranges": ""}, "--ranges: "),
        ("lidar-acquisition", {"ranges": "5y"}, "--ranges: "),
        ("pmd-acquisition", {"target": "hubble"}, "--target: "),
        ("population", {"returns": "30"}, "--returns: "),
        ("population", {"target": "hubble"}, "--target: "),
        ("population", {"population": "mine"}, "--population: "),
        ("lidar-acquisition", {"steps": "1"}, "--steps: "),
        ("lidar-acquisition", {"trials": "0"}, "--trials: is '0'; it must be greater than 0\n"),
        ("lidar-acquisition", {"trials": "abc"}, "--trials: is 'abc'; it must be a whole number\n"),
        ("lidar-acquisition", {"seed": "-1"}, "--seed: "),
        ("lidar-acquisition", {"eq4": "mine"}, "--eq4: "),
        ("lidar-acquisition", {"method": "magic"}, "--method: needs template-matching"),
        ("lidar-acquisition", {"target": "hubble"}, "--target: "),
        ("lidar-trajectory", {"ranges": "20"}, "--ranges: has no meaning for lidar-trajectory"),
        ("lidar-trajectory", {"trials": "242"}, "--trials: is 242; lidar-trajectory has 241 at most"),
    ],
)
def test_a_wrong_value_is_one_line_that_names_the_option(name, options, says, tmp_path, capsys):
    assert campaign_command(name, options=options, jobs=1, out=tmp_path, as_json=True) == 2
    said = capsys.readouterr()
    assert not said.out
    (line,) = said.err.splitlines(keepends=True)
    assert line.startswith(f"rpod campaign: {says}")
    assert not list(tmp_path.iterdir())


def test_no_process_is_one_too_few(tmp_path, capsys):
    assert campaign_command("lidar-acquisition", options={}, jobs=0, out=tmp_path, as_json=True) == 2
    assert capsys.readouterr().err == "rpod campaign: --jobs: is 0; it must be at least 1\n"


def test_an_unknown_campaign_is_answered_with_those_that_there_are(tmp_path, capsys):
    assert campaign_command("lidar-magic", options={}, jobs=1, out=tmp_path, as_json=True) == 2
    said = capsys.readouterr().err
    assert said.startswith("rpod campaign: campaign 'lidar-magic' is unknown; known are lidar-acquisition, ")
    assert "pmd-acceptance" in said


def test_a_misspelt_campaign_is_answered_with_the_nearest_name():
    told = CliRunner().invoke(app, ["campaign", "lidar-aquisition"]).output
    assert "Did you mean 'lidar-acquisition'?" in told


def test_the_help_lists_every_campaign_with_its_title():
    told = CliRunner().invoke(app, ["campaign", "--help"], env={"COLUMNS": "100"}).output
    for name in names():
        assert re.search(rf"^  {name} +{re.escape(find(name).title)}\.$", told, re.MULTILINE), (name, told)


def test_a_campaign_that_was_renamed_is_found_by_its_old_name_and_says_so_in_one_line():
    for old, new in RENAMED.items():
        told = CliRunner().invoke(app, ["campaign", old, "--help"])
        assert told.stderr == f"{old} is called {new} now\n"
        assert f"{find(new).title}." in told.stdout


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_help_of_a_campaign_has_its_options_and_no_others(name):
    told = CliRunner().invoke(app, ["campaign", name, "--help"], env={"COLUMNS": "100"}).output
    model = options_of(name)
    fields = {option: field for option, field in model.model_fields.items() if option != "scenarios"}
    shown = set(re.findall(r"^  --([a-z0-9-]+)", told, re.MULTILINE))
    assert shown == {option.replace("_", "-") for option in fields} | {
        "out",
        "jobs",
        "cluster",
        "json",
        "help",
    }
    for option, field in fields.items():
        assert field.description, option
        assert field.description.endswith("."), option
        assert field.description.split()[0] in told


def test_an_option_of_another_campaign_is_refused_by_the_command_line(tmp_path):
    done = CliRunner().invoke(app, ["campaign", "lidar-trajectory", "--ranges", "20", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert "No such option: --ranges" in done.output


def test_jobs_have_no_meaning_on_a_cluster(tmp_path, capsys):
    told = {"options": {}, "out": tmp_path, "as_json": True, "cluster": "local:2"}
    assert campaign_command("lidar-acquisition", jobs=2, **told) == 2
    assert "--jobs: has no meaning with --cluster" in capsys.readouterr().err
