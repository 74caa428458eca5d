"""The examples in the package's README run as they stand."""

import re
from pathlib import Path

import numpy as np

import rpod_sim_sensor


def test_the_readmes_python_runs() -> None:
    text = (Path(rpod_sim_sensor.__file__).parent / "README.md").read_text("utf-8")
    namespace: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(block, namespace)  # noqa: S102 - the project's own text
    exposure = namespace["exposure"]
    assert np.isfinite(exposure.depth_m).sum() > 10_000  # type: ignore[attr-defined]
