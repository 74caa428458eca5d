"""A run in Rerun's viewer, which draws without a screen."""

import io
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from facility_process import until
from machine import rerun_program

from rpod_analysis import open_log
from rpod_runtime.bus.session import free_endpoint
from rpod_schemas.topics import AMPLITUDE, CHASER, DEPTH, ESTIMATE, TARGET, TARGET_ESTIMATE, optical_frame

pytestmark = pytest.mark.needs("rerun", "rerun_viewer")
PICTURES = {f"/{topic.of('pmd').name}" for topic in (DEPTH, AMPLITUDE)}


@pytest.fixture(scope="module")
def viewer(summary, tmp_path_factory) -> Iterator[Any]:
    """A viewer that has opened the run and shows the moment of its last estimate."""
    with open_log(summary.log) as log:
        last_ns = [logged.log_ns for logged in log.messages(ESTIMATE)][-1]
    with running(Path(summary.log), settings=tmp_path_factory.mktemp("rerun")) as viewer:
        until(lambda: has_loaded(viewer.get_state()))
        viewer.set_time("message_log_time", timestamp=np.datetime64(last_ns, "ns"), play_state="paused")
        yield viewer


def has_loaded(state: Any) -> bool:
    return not state.loading and {view.origin for view in state.views} > PICTURES


@contextmanager
def running(log: Path, *, settings: Path) -> Iterator[Any]:
    """Run the viewer on this machine alone, telling nobody of its use; it leaves no process behind."""
    from rerun.experimental import ViewerClient  # noqa: PLC0415 - it may not be there

    environment = os.environ | {"XDG_CONFIG_HOME": str(settings)}
    subprocess.run(
        [rerun_program(), "analytics", "disable"], env=environment, capture_output=True, check=True
    )
    port = free_endpoint().rpartition(":")[2]
    where = ["--bind", "127.0.0.1", "--port", port]
    process = subprocess.Popen(
        [rerun_program(), "--headless", *where, log],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def connected() -> Any:
        assert process.poll() is None, "the viewer has ended"
        try:
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        except ConnectionError:
            return None

    try:
        until(connected)
        yield connected()
    finally:
        os.killpg(
            process.pid, signal.SIGKILL
        )  # the command is a wrapper, which would leave the viewer behind
        process.wait()


def colours(png: bytes) -> int:
    """Return how many colours there are in a picture; about 110 in that of a view without data."""
    from PIL import Image  # noqa: PLC0415 - Rerun brings it

    with Image.open(io.BytesIO(png)) as image:
        return len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0))


def test_it_finds_no_fault_with_the_log(viewer):
    assert [entry.message for entry in viewer.get_logs() if entry.level == "ERROR"] == []


def test_it_knows_where_target_estimate_and_camera_are(viewer):
    edges = viewer.get_transform_graph(frame_filter="named", edge_filter="all")["edges"]
    children = {edge["child"] for edge in edges if edge["parent"] == CHASER}
    assert children == {TARGET, TARGET_ESTIMATE, optical_frame("pmd")}


def test_every_view_is_drawn(viewer):
    views = viewer.get_state().views
    assert {view.view_class for view in views} == {"2D", "3D", "TextLog"}
    for view in views:
        assert colours(viewer.take_screenshot(view.view_id)) > 200, f"{view.name} is empty"
    assert [(view.name, view.reports) for view in viewer.get_state().views if view.reports] == []
