import pytest

from rpod.command_campaign import campaign_command


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("lidar-magic", {}, "campaign: needs lidar-acquisition"),
        ("lidar-acquisition", {"ranges": "20,-3"}, "--ranges: "),
        ("lidar-acquisition", {"ranges": ""}, "--ranges: "),
        ("lidar-acquisition", {"steps": "1"}, "--steps: "),
        ("lidar-acquisition", {"trials": 0}, "--trials: "),
        ("lidar-acquisition", {"seed": -1}, "--seed: "),
        ("lidar-acquisition", {"eq4": "mine"}, "--eq4: "),
        ("lidar-acquisition", {"method": "magic"}, "--method: needs template-matching"),
        ("lidar-acquisition", {"target": "hubble"}, "--target: "),
        ("lidar-trajectory", {"ranges": "20"}, "--ranges: has no meaning for lidar-trajectory"),
        ("lidar-trajectory", {"trials": 242}, "--trials: lidar-trajectory has 241 at most"),
    ],
)
def test_a_wrong_value_is_one_line_that_names_the_option(name, options, says, tmp_path, capsys):
    assert campaign_command(name, options=options, jobs=1, out=tmp_path, as_json=True) == 2
    said = capsys.readouterr()
    assert not said.out
    (line,) = said.err.splitlines()
    assert line.startswith(f"rpod campaign: {says}")
    assert not list(tmp_path.iterdir())


def test_no_process_is_one_too_few(tmp_path, capsys):
    assert campaign_command("lidar-acquisition", options={}, jobs=0, out=tmp_path, as_json=True) == 2
    assert capsys.readouterr().err == "rpod campaign: --jobs: needs at least 1, not 0\n"
