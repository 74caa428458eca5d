"""The help of the command line, as a terminal of 80 columns shows it."""

import re

import pytest
from typer.testing import CliRunner

from rpod.__main__ import app

GROUPS = ("", "target", "calibrate", "campaign", "driver", "pki")


@pytest.fixture(scope="module")
def shown() -> dict[str, str]:
    """The help of each group of verbs; click leaves two of the terminal's columns free."""
    runner = CliRunner()
    return {
        group: runner.invoke(app, [*group.split(), "--help"], terminal_width=78).output for group in GROUPS
    }


@pytest.mark.parametrize("group", GROUPS)
def test_no_line_of_a_list_of_verbs_is_cut(shown, group):
    assert "Commands:" in shown[group]
    assert not re.findall(r"^.*\.\.\.$", shown[group].split("Commands:")[1], re.MULTILINE)


def test_the_verbs_of_the_first_day_are_listed_first(shown):
    verbs = re.findall(r"^  (\S+)", shown[""].split("Commands:")[1], re.MULTILINE)
    assert verbs[:3] == ["run", "scenarios", "report"]
    assert len(verbs) == len(set(verbs)) > 20
