"""The example of the package's README runs as it stands."""

import re
from pathlib import Path

from synthetic_log import SyntheticRun

import rpod_analysis


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    SyntheticRun().write(tmp_path / "run.mcap")
    monkeypatch.chdir(tmp_path)
    text = (Path(rpod_analysis.__file__).parent / "README.md").read_text("utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102
    printed = capsys.readouterr().out
    assert "truth/odometry" in printed
    assert printed.count(" True\n") == 5
    assert printed.endswith("0.00 deg at worst\n")
